"""Log-map edges on the graphs of PyTorch Geometric, which itself is not needed."""

from __future__ import annotations

from copy import copy
from typing import Any

import torch

from riemlayer.field import ExpLogField
from riemlayer.nn.arguments import check_sizes
from riemlayer.numerics import safe_norm
from riemlayer.ops import LocalGeometry, local_geometry
from riemlayer.ops.local_geometry import angle_of


class LogMapEdges:
    """Transform that puts log-map edges on a graph: PyG's `KNNGraph`, along the surface (ours).

    Sets `edge_index` (2, E), from neighbour to receiver (PyG's "source_to_target"), `edge_attr`
    (E, 2) = Log_receiver(neighbour) in the receiver's frame, `transport` (E,), `weight` (E,),
    `valid` (E,), `frame` (N, 3, 3) and `radius` (N,), all as in `LocalGeometry`, without a graph of
    gradients. `geometry` is the way back, also from a batch that PyG's `DataLoader` has packed.

    Args:
        field: that encodes the cloud.
        k: nearest neighbours of each point.

    Shapes: anything with `pos` (N, 3), and `batch` (N,) where it is packed -> a shallow copy.

    Raises:
        ValueError: k is below 1, or `data` has no `pos`.

    >>> from types import SimpleNamespace
    >>> data = SimpleNamespace(pos=torch.nn.functional.normalize(torch.randn(300, 3), dim=-1))
    >>> data = LogMapEdges(ExpLogField.from_preset("tiny"), k=8)(data)
    >>> data.edge_index.shape, data.edge_attr.shape
    (torch.Size([2, 2400]), torch.Size([2400, 2]))
    """

    def __init__(self, field: ExpLogField, k: int = 16) -> None:
        check_sizes(k=k)
        self.field, self.k = field, k

    @torch.no_grad()
    def __call__(self, data: Any) -> Any:
        pos = getattr(data, "pos", None)
        if pos is None:
            raise ValueError(f"data must have an attribute `pos` (N, 3), got {data!r}")
        surface = self.field.encode(pos, getattr(data, "batch", None))
        geometry = local_geometry(surface, self.k)
        data = copy(data)
        data.edge_index, data.edge_attr = geometry.edge_index, geometry.log
        for name in ("transport", "weight", "valid", "frame", "radius"):
            setattr(data, name, getattr(geometry, name))
        return data

    @staticmethod
    def geometry(data: Any) -> LocalGeometry:
        """The `LocalGeometry` of a graph that has been through the transform."""
        batch = getattr(data, "batch", None)
        if batch is None:
            batch = torch.zeros(len(data.pos), dtype=torch.long, device=data.pos.device)
        return LocalGeometry(
            edge_index=data.edge_index,
            log=data.edge_attr,
            r=safe_norm(data.edge_attr).squeeze(-1),
            theta=angle_of(data.edge_attr),
            transport=data.transport,
            weight=data.weight,
            valid=data.valid,
            frame=data.frame,
            radius=data.radius,
            batch=batch,
        )

    def __repr__(self) -> str:
        return f"LogMapEdges(k={self.k})"
