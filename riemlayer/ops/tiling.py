"""Scenes larger than the cube: overlapping tiles, of which the nearest answers (ours)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple, overload

import torch
from torch import Tensor

from riemlayer import checks
from riemlayer.calculus import Calculus
from riemlayer.heads import Embedding
from riemlayer.octree import HALF_WIDTH
from riemlayer.ops.packing import packed
from riemlayer.surface import CHUNK, EncodedSurface, MapInfo

if TYPE_CHECKING:
    from riemlayer.field import ExpLogField

REACH = 1.0
"""Half the side of what a tile sees, in the cube."""
MOST = 1 << 20
"""Tiles along an axis that whole numbers can tell apart."""
GROUP = 1 << 17
"""Points encoded at once."""


@dataclass(frozen=True)
class TiledSurface(Calculus):
    """A scene of any size as one surface: every base point is answered by the tile around it.

    Made by `encode_tiled`. Exp, Log and all that follows from them are asked as of an
    `EncodedSurface`, and long geodesics (`shoot`), stitched charts and means go on from tile to
    tile. A single answer reaches as far as its tile. There is one shape, so `shape` is ignored.
    """

    tiles: EncodedSurface
    """A packed batch, a cloud for each tile: the points of the scene that it answers for."""
    step: float
    """Distance of the tiles' centres, user's units."""
    points: Tensor
    """(N, 3) of the scene, user's units and order."""

    def __len__(self) -> int:
        """Number of tiles."""
        return len(self.tiles)

    @property
    def radius(self) -> Tensor:
        """Trained tangent radius, user's units."""
        return self.tiles.radius.max()

    @property
    def like(self) -> Tensor:
        """What every argument must have the dtype and the device of."""
        return self.points

    def tile(self, p: Tensor) -> Tensor:
        """(...) int64, the tile that answers for each base point: the one it is most central in."""
        lattice = self._lattice(self.tiles.centre)
        low, high = lattice.amin(0), lattice.amax(0)
        wanted = self._lattice(p.detach().reshape(-1, 3)).clamp(low, high)
        size = high - low + 1
        keys = _linear(lattice - low, size)  # ascending: tiles are made in this order
        key = _linear(wanted - low, size)
        at = torch.searchsorted(keys, key).clamp_max(len(keys) - 1)
        lost = (keys[at] != key).nonzero().squeeze(-1)
        for rows in lost.split(max(1, (1 << 22) // len(keys))):
            apart = p.detach().reshape(-1, 3)[rows, None] - self.tiles.centre
            at[rows] = apart.abs().amax(-1).argmin(-1)
        return at.view(p.shape[:-1])

    @overload
    def exp(
        self, p: Tensor, v: Tensor, *, chunk_size: int = ..., return_info: Literal[False] = ...
    ) -> Tensor: ...
    @overload
    def exp(
        self, p: Tensor, v: Tensor, *, chunk_size: int = ..., return_info: Literal[True]
    ) -> tuple[Tensor, MapInfo]: ...
    def exp(
        self, p: Tensor, v: Tensor, *, chunk_size: int = CHUNK, return_info: bool = False
    ) -> Tensor | tuple[Tensor, MapInfo]:
        """Exponential map q = Exp_p(v) (Sec. 3), arguments and errors as for `EncodedSurface`."""
        self.check(p=p, v=v)
        how = {"shape": self.tile(p), "chunk_size": chunk_size}
        return self.tiles.exp(p, v, return_info=return_info, **how)  # pyright: ignore

    @overload
    def log(
        self, p: Tensor, q: Tensor, *, chunk_size: int = ..., return_info: Literal[False] = ...
    ) -> Tensor: ...
    @overload
    def log(
        self, p: Tensor, q: Tensor, *, chunk_size: int = ..., return_info: Literal[True]
    ) -> tuple[Tensor, MapInfo]: ...
    def log(
        self, p: Tensor, q: Tensor, *, chunk_size: int = CHUNK, return_info: bool = False
    ) -> Tensor | tuple[Tensor, MapInfo]:
        """Logarithmic map v = Log_p(q) (Sec. 3), arguments and errors as for `EncodedSurface`."""
        self.check(p=p, q=q)
        how = {"shape": self.tile(p), "chunk_size": chunk_size}
        return self.tiles.log(p, q, return_info=return_info, **how)  # pyright: ignore

    def decode_exp(
        self, p: Tensor, v: Tensor, shape: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Exp_p(v) (..., 3) and validity logits (...), without checks."""
        return self.tiles.decode_exp(p, v, self.tile(p))

    def decode_log(
        self, p: Tensor, q: Tensor, shape: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Log_p(q) (..., 3) and validity logits (...), without checks."""
        return self.tiles.decode_log(p, q, self.tile(p))

    def normal(self, p: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Unit normals (..., 3) of the tangent planes of `log`, of no certain sign (ours)."""
        return self.tiles.normal(p, shape=self.tile(p))

    def snap(self, p: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Points (..., 3) dropped onto the cloud's blended planes (ours)."""
        return self.tiles.snap(p, shape=self.tile(p))

    def in_support(self, p: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """(...) bool: p lies in or beside an occupied cell of its tile."""
        return self.tiles.in_support(p, shape=self.tile(p))

    def radius_at(self, p: Tensor, shape: Tensor | None = None) -> Tensor:
        """Trained radius (...), the same everywhere."""
        return self.radius.expand(p.shape[:-1])

    def at(self, index: Tensor) -> TiledSurface:
        """The same surface with fewer points of its own: those of `index` (M,)."""
        return replace(self, points=self.points[index])

    def to(self, device: torch.device | str) -> TiledSurface:
        """The same surface on another device; move `field` there first."""
        return replace(self, tiles=self.tiles.to(device), points=self.points.to(device))

    def _lattice(self, x: Tensor) -> Tensor:
        """Whole coordinates (Q, 3) of the nearest place for a tile."""
        return ((x - self.tiles.centre[0]) / self.step).round().long()


class Lattice(NamedTuple):
    """Where tiles may lie: centres at origin + step * (whole numbers)."""

    origin: Tensor
    step: float
    scale: float
    """Half the side of a tile's cube, user's units."""


@torch.no_grad()
def encode_tiled(
    field: ExpLogField,
    points: Tensor,
    radius: float,
    *,
    overlap: float = 0.7,
    origin: Tensor | None = None,
) -> TiledSurface:
    """Encode a scene of any size in overlapping tiles of one scale (ours).

    Tiles lie whole coarsest cells of the octree apart, so that the network finds the same points in
    the same cells wherever two of them overlap; what differs is only what lies beyond a tile's
    edge. Every base point is answered by the tile it is most central in.

    Args:
        field: with its weights.
        points: (N, 3) in the user's units.
        radius: trained tangent radius to be had, in the user's units: it sets the resolution. A
            tile is `2 / field.config.radius` (4 for `base`) radii wide; a cloud of half-width h
            that `field.encode` takes whole has radius `h * field.config.radius`. Tiles keep that
            scale where points are sparse, too.
        overlap: least share of a tile's width that it shares with its neighbour along an axis,
            from 0 to below 1. Rounded up to whole coarsest cells. More of it costs more tiles.
        origin: (3,) a centre of a tile; by default that of the scene's bounding box.

    Returns:
        A `TiledSurface`, without a graph.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.

    >>> from riemlayer import ExpLogField
    >>> across = torch.cartesian_prod(torch.linspace(0, 20, 400), torch.linspace(0, 2, 40))
    >>> street = torch.nn.functional.pad(across, (0, 1))
    >>> surface = encode_tiled(ExpLogField.from_preset("tiny"), street, radius=0.5)
    >>> len(surface), surface.exp(street[:5], torch.zeros(5, 3)).shape
    (195, torch.Size([5, 3]))
    """
    checks.check_tensor("points", points)
    checks.check_same_kind("points", points, like=field.backbone.head.weight)
    checks.check_points(points)
    if not (isinstance(radius, int | float) and 0 < radius < torch.inf):
        raise ValueError(f"`radius` must be a positive length in the points' unit, got {radius}")
    if not 0 <= overlap < 1:
        raise ValueError(f"`overlap` must lie in [0, 1), got {overlap}; 0.7 is usual")
    if origin is None:
        origin = (points.amin(0) + points.amax(0)) / 2
    else:
        checks.check_vectors("origin", origin, like=points)
    scale = radius / field.config.radius
    backbone = field.config.backbone
    cell = 2 * HALF_WIDTH / 2 ** (backbone.depth - len(backbone.encoder) + 1)
    cells = max(1, int((1 - overlap) * 2 * REACH / cell + 1e-6))
    lattice = Lattice(origin, cells * cell * scale, scale)
    extent = float((points.amax(0) - points.amin(0)).max())
    if not extent < MOST * lattice.step:
        raise ValueError(f"`radius` must be larger than {radius:g} for a scene {extent:g} wide")
    core, owner = _cores(points, lattice)
    centre = origin + lattice.step * core.to(points)
    embedding = _embed(field, points, centre, lattice)
    order = owner.argsort(stable=True)
    scales = points.new_full((len(core),), scale)
    tiles = EncodedSurface(field, embedding, centre, scales, scales, points[order], owner[order])
    return TiledSurface(tiles, lattice.step, points)


def _linear(x: Tensor, size: Tensor) -> Tensor:
    return (x[:, 0] * size[1] + x[:, 1]) * size[2] + x[:, 2]


def _cores(points: Tensor, lattice: Lattice) -> tuple[Tensor, Tensor]:
    """Whole coordinates (T, 3) of the tiles that hold a point most centrally, and whose (N,)."""
    x = ((points - lattice.origin) / lattice.step).round().long()
    low = x.amin(0)
    size = x.amax(0) - low + 1
    key, owner = torch.unique(_linear(x - low, size), return_inverse=True)
    rest = key % (size[1] * size[2])
    core = torch.stack((key // (size[1] * size[2]), rest // size[2], rest % size[2]), -1)
    return core + low, owner


def _embed(field: ExpLogField, points: Tensor, centre: Tensor, lattice: Lattice) -> Embedding:
    """Embedding of all tiles as one packed batch; so many are encoded at once as memory allows."""
    parts: list[tuple[Embedding, int]] = []
    first, held, size = 0, [], 0
    for t, x in enumerate(_views(points, centre, lattice)):
        held.append(x)
        size += len(x)
        if size >= GROUP or t + 1 == len(centre):
            counts = torch.tensor([len(x) for x in held], device=points.device)
            batch = torch.arange(len(held), device=points.device).repeat_interleave(counts)
            parts.append((field.embed(torch.cat(held), batch), first))
            first, held, size = t + 1, [], 0
    return packed(parts)


def _views(points: Tensor, centre: Tensor, lattice: Lattice) -> Iterator[Tensor]:
    """What each tile sees: the points (n, 3) within its reach, in its cube."""
    core, owner = _cores(points, lattice)
    order = owner.argsort(stable=True)
    end = owner.bincount(minlength=len(core)).cumsum(0).tolist()
    start = [0, *end[:-1]]
    reach = REACH * lattice.scale / lattice.step + 0.5  # in cores, from centre to centre
    for k, c in zip(core, centre, strict=True):
        near = ((core - k).abs() <= reach).all(-1).nonzero().squeeze(-1).tolist()
        x = points[torch.cat([order[start[i] : end[i]] for i in near])]
        x = (x - c) / lattice.scale
        yield x[(x.abs() <= REACH).all(-1)]
