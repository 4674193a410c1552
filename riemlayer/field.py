"""`ExpLogField`: a raw point cloud in, a surface with Exp and Log out (Fig. 1 and Fig. 2).

Names, here and everywhere below:

    p  source point on M           (S, 3)       z  embedding at p               (S, C)
    v  tangent vector at p         (S, K, 3)    J  Jacobian of a map            (S, K, 3, 3)
    q  point reached, q = Exp_p v  (S, K, 3)    S sources, K queries a source, C channels

Inside, all geometry is in the normalised cube [-1, 1]^3; v and q - p are in the same length unit.
"""

from __future__ import annotations

import contextlib
from typing import NamedTuple, Self

import torch
from torch import Tensor, nn

from riemlayer import checks
from riemlayer.backbone import make_backbone
from riemlayer.config import SCALES, FieldConfig
from riemlayer.geometry import Points, planes_at_scales
from riemlayer.heads import Embedding, ExpHead, LogHead
from riemlayer.octree import build_octree
from riemlayer.storage import Pretrained
from riemlayer.surface import EncodedSurface

GRID = 16
"""Cells along each side of the cube by which it is told how far the points of a cloud are apart."""
APART = 0.8
"""Distance from point to point, in leaves, from which on a cloud is made smaller."""
SMALLEST = 0.5
"""Half the longest side in the cube that a cloud is given at least."""
STEPS = 32
"""Sizes that it may have, up to the whole cube."""


class FieldOutput(NamedTuple):
    """What `ExpLogField.forward` answers; None where the query was not given."""

    exp: Tensor | None
    log: Tensor | None


class ExpLogField(Pretrained, nn.Module):
    """Geometric embedding field with hyper-modulated Exp and Log (Sec. 3).

    `encode` runs the backbone once on a cloud; the surface it returns answers Exp and Log from any
    source. Differentiable in the weights, p, v, q and, through the features, in the points.

    Args:
        config: widths and depth; `FieldConfig.base()` by default.

    Shapes: points (N, 3), p (..., 3), v (..., 3) -> q (..., 3).

    >>> field = ExpLogField.from_preset("tiny")
    >>> points = torch.nn.functional.normalize(torch.randn(400, 3), dim=-1)
    >>> p, q = points[:1], points[1:4]
    >>> bool((field.encode(points).log(p, p) == 0).all())
    True
    """

    def __init__(self, config: FieldConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or FieldConfig.base()
        c = config.backbone.embedding
        self.backbone = make_backbone(config.backbone)
        self.narrow = nn.Linear(c, config.head.narrow) if config.head.narrow else None
        self.exp_head = ExpHead(c, config.radius, config.head)
        self.log_head = LogHead(c, config.radius, config.head)

    @classmethod
    def from_preset(cls, name: str) -> Self:
        """Untrained field of the preset `base`, `paper` or `tiny`."""
        return cls(FieldConfig.preset(name))

    def encode(
        self, points: Tensor, batch: Tensor | None = None, normals: Tensor | None = None
    ) -> EncodedSurface:
        """Encode raw clouds once (Sec. 3.1).

        Each cloud is centred and scaled by its own bounding box to the cube [-1, 1]^3; a cloud
        gives the same surface alone or in a batch, and the order of its points does not matter.
        Always eager: the octree's sizes depend on the points. `riemlayer.deploy` exports the rest.

        Args:
            points: (N, 3) of one cloud, or of several packed one after the other; any unit.
            batch: (N,) int64, sorted: cloud of each point of a packed batch.
            normals: (N, 3) unit normals that all point to the same side of the surface, where they
                are known (ours): walks then do not see the other side of a thin sheet. A field with
                `config.backbone.normals` needs them.

        Returns:
            An `EncodedSurface`.

        Raises:
            TypeError, ValueError: naming the argument, what was expected and what came.
            RuntimeError: `torch.export` or the ONNX exporter is tracing.
        """
        if _exporting():
            raise RuntimeError(
                "encode stays eager, because the octree's sizes depend on the points, and cannot "
                "be exported; export the decoders: riemlayer.deploy.export(field, 'exp' or 'log')"
            )
        checks.check_tensor("points", points)
        checks.check_same_kind("points", points, like=self.backbone.head.weight)
        checks.check_points(points, batch)
        if normals is not None:
            checks.check_normals(normals, points)
        if batch is None:
            batch = torch.zeros(len(points), dtype=torch.long, device=points.device)
        centre, half = bounding_cubes(points, batch)
        x = (points - centre[batch]) / half[batch][:, None]
        scale = half / size_in_cube(x, batch, APART * 2 / 2**self.config.backbone.depth)
        x = (points - centre[batch]) / scale[batch][:, None]
        embedding = self.embed(x.clamp(-1, 1), batch, normals)
        return EncodedSurface(self, embedding, centre, scale, half, points, batch)

    def encode_in_cube(
        self, points: Tensor, batch: Tensor, normals: Tensor | None = None
    ) -> EncodedSurface:
        """Encode packed clouds that already lie in the cube, at the size they have there.

        What training calls: clouds smaller than the cube stay smaller.
        """
        size = int(batch[-1]) + 1
        centre, scale = points.new_zeros(size, 3), points.new_ones(size)
        embedding = self.embed(points, batch, normals)
        return EncodedSurface(self, embedding, centre, scale, scale, points, batch)

    def embed(self, points: Tensor, batch: Tensor, normals: Tensor | None = None) -> Embedding:
        """Embedding field of packed clouds (N, 3) that already lie in the cube."""
        backbone = self.config.backbone
        if backbone.normals and normals is None:
            raise ValueError(
                "`normals` must be given: this field was made for clouds with oriented normals; "
                "the packaged `base` is for clouds without"
            )
        walks = self.config.head.walks
        finer, wider = min(max(0, walks - 1), 1), int(walks >= SCALES)
        octree = build_octree(
            points,
            batch,
            backbone.depth + 1 + finer,
            coarsest=backbone.depth - max(len(backbone.encoder) - 1, 1 + wider),
        )
        with self.half_precision():
            above = (finer, 0, 2)[: 1 + finer + wider]
            planes = planes_at_scales(points, octree, above, normals, rims=1 + wider)
            told = (normals,) if backbone.normals else ()
            z = self.backbone(points, octree, planes, *told)
            narrow = None if self.narrow is None else self.narrow(z).to(points.dtype)
        level = octree.level(backbone.depth)
        near = Points.of(points, octree, planes.scales[0].coarse)
        return Embedding(z.to(points.dtype), narrow, level, planes, near)

    def forward(
        self,
        points: Tensor,
        p: Tensor,
        v: Tensor | None = None,
        q: Tensor | None = None,
        batch: Tensor | None = None,
        shape: Tensor | None = None,
    ) -> FieldOutput:
        """Encode, then Exp_p(v) and Log_p(q): all of Fig. 2 in one call, for DDP and compile."""
        surface = self.encode(points, batch)
        exp = None if v is None else surface.exp(p, v, shape=shape)
        log = None if q is None else surface.log(p, q, shape=shape)
        return FieldOutput(exp, log)

    def half_precision(self) -> contextlib.AbstractContextManager:
        """bfloat16 matrix products where weights are float32 and the processor has them."""
        weight = self.backbone.head.weight
        device = weight.device.type
        if weight.dtype != torch.float32 or torch.is_autocast_enabled(device):
            return contextlib.nullcontext()
        return torch.autocast(device, torch.bfloat16, enabled=_has_bfloat16(device))


def bounding_cubes(points: Tensor, batch: Tensor) -> tuple[Tensor, Tensor]:
    """Centre (B, 3) of each cloud's bounding box and half its longest side (B,)."""
    index = batch[:, None].expand_as(points)
    empty = points.new_zeros(int(batch[-1]) + 1, 3)
    low = empty.scatter_reduce(0, index, points, "amin", include_self=False)
    high = empty.scatter_reduce(0, index, points, "amax", include_self=False)
    return (low + high) / 2, (high - low).amax(-1) / 2


@torch.no_grad()
def size_in_cube(x: Tensor, batch: Tensor, apart: float) -> Tensor:
    """Half the longest side (B,) that clouds (N, 3), which fill the cube, are given in it (ours).

    1, unless their points are further than `apart` from each other: then less, down to `SMALLEST`,
    so that they are not. How far they are, up to a cell of a grid, is told by the number of its
    cells that they lie in, each taken for a square of a sheet. In steps of 1 / `STEPS`, so that it
    does not hang on the last digits.
    """
    clouds, count = int(batch[-1]) + 1, batch.bincount().clamp_min(1)
    cell = ((x + 1) * (GRID / 2)).long().clamp(0, GRID - 1)
    index = ((batch * GRID + cell[:, 0]) * GRID + cell[:, 1]) * GRID + cell[:, 2]
    occupied = torch.zeros(clouds * GRID**3, dtype=torch.bool, device=x.device)
    occupied[index] = True
    area = (2 / GRID) ** 2 * occupied.view(clouds, -1).sum(-1).to(x.dtype)
    size = apart / (area / count).sqrt()
    return ((STEPS * size).round() / STEPS).clamp(SMALLEST, 1)


def _has_bfloat16(device: str) -> bool:
    if device == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return device == "cpu" and torch.cpu._is_avx512_bf16_supported()


def _exporting() -> bool:
    return getattr(torch.compiler, "is_exporting", bool)()  # torch 2.6 has none
