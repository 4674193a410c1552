"""Tangent-vector features: carried along edges, and averaged."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from riemlayer.nn.arguments import check_coordinates
from riemlayer.nn.sums import Sums
from riemlayer.ops import LocalGeometry


class ParallelTransport(nn.Module):
    """Tangent vectors of the neighbours at their receivers, e^{i t_ij} x_j (ours).

    Parallel transport along each edge, in coordinates. Lengths and angles are kept. Turning the
    frames turns the answers by -alpha of the receiver, as it does vectors that stay there.

    Shapes: x (N, C, 2) -> (E, C, 2).

    Raises:
        TypeError, ValueError: `x` has another shape or is not real.

    >>> from riemlayer import ExpLogField
    >>> from riemlayer.ops import local_geometry
    >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
    >>> geometry = local_geometry(ExpLogField.from_preset("tiny").encode(points), k=8)
    >>> ParallelTransport()(torch.randn(300, 5, 2), geometry).shape
    torch.Size([2400, 5, 2])
    """

    def forward(self, x: Tensor, geometry: LocalGeometry) -> Tensor:
        check_coordinates(x, geometry)
        a, b = x[geometry.edge_index[0]].unbind(-1)  # (E, C)
        c, s = geometry.transport.cos()[:, None], geometry.transport.sin()[:, None]
        return torch.stack((c * a - s * b, s * a + c * b), -1)


class VectorPool(nn.Module):
    """Mean of tangent vectors over a neighbourhood, after transport to the receiver (ours).

        y_i = (x_i + sum_j w_ij e^{i t_ij} x_j) / (1 + sum_j w_ij)

    with w of Eq. (9): half the receiver, half its neighbours. A receiver without valid edges keeps
    x_i. A parallel field stays what it is. Turning the frames turns the answers with them.

    Shapes: x (N, C, 2) -> (N, C, 2).

    Raises:
        TypeError, ValueError: `x` has another shape or is not real.

    >>> from riemlayer import ExpLogField
    >>> from riemlayer.ops import local_geometry
    >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
    >>> geometry = local_geometry(ExpLogField.from_preset("tiny").encode(points), k=8)
    >>> VectorPool()(torch.randn(300, 5, 2), geometry).shape
    torch.Size([300, 5, 2])
    """

    def forward(self, x: Tensor, geometry: LocalGeometry) -> Tensor:
        check_coordinates(x, geometry)
        sender, receiver = geometry.edge_index
        sums = Sums.of(sender, receiver, geometry.points)
        z = torch.view_as_complex(x.contiguous())
        mean = sums.weighted_complex(z, geometry.weight, geometry.transport)
        total = sums.weighted(x.new_ones(len(x), 1), geometry.weight)
        return torch.view_as_real((z + mean) / (1 + total))
