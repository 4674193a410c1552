"""The octree: occupied nodes of every level, with neighbours, parents and children; frozen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache

import torch
from torch import Tensor

from riemlayer.octree.keys import decode_key, encode_key, spread_bits

HALF_WIDTH = 1.0625
"""Half the side of the octree's cube: the data's cube [-1, 1]^3 and a margin for end points."""
DENSE_LIMIT = 1 << 25
"""Largest dense grid (int32 entries, 128 MB a level); larger levels search their sorted keys."""
NEIGHBOURS = torch.cartesian_prod(*[torch.arange(-1, 2)] * 3)
"""(27, 3) offsets; the mirror image of offset k is offset 26 - k."""
OCTANTS = torch.cartesian_prod(*[torch.arange(2)] * 3)
"""(8, 3) offsets to the corners of a cell."""


@dataclass(frozen=True)
class Level:
    """The n occupied nodes of one depth, in the order of their keys.

    In every index table n itself (one past the last node) means "no such node".
    """

    depth: int
    batch_size: int
    key: Tensor
    """(n,) int64, ascending."""
    grid: Tensor | None
    """(batch_size (2^depth + 2)^3,) int32: node of each cell, with a border of one empty cell
    around each shape; None where that is too large."""
    neighbours: Tensor
    """(n, 27) int64: nodes at offsets (-1, -1, -1), (-1, -1, 0) ... (1, 1, 1)."""
    children: Tensor | None
    """(n, 8) int64 into the next finer level; None at the finest."""
    parent: Tensor | None
    """(n,) int64 into the next coarser level; None at the coarsest."""

    def __len__(self) -> int:
        return len(self.key)

    @property
    def cell_size(self) -> float:
        """Side of a node."""
        return 2 * HALF_WIDTH / (1 << self.depth)

    def around(self, cell: Tensor, batch: Tensor, offsets: Tensor) -> Tensor:
        """Nodes (Q, k) at cells (Q, 3) + offsets (k, 3) of shapes (Q,), or n where there is none.

        Cells and offsets may reach one cell beyond the cube, not more.
        """
        return _around(self.key, self.grid, self.depth, cell, batch, offsets)

    def octants(self, cell: Tensor, batch: Tensor) -> Tensor:
        """Nodes (8, Q) at the columns of `cell` (3, Q) + `OCTANTS`, or n where there is none.

        What every look-up calls: one gather from the dense grid by int32 steps that are made once.
        """
        if self.grid is None:
            return self.around(cell.T.long(), batch, OCTANTS.to(cell.device)).T
        side = (1 << self.depth) + 2
        strides, corners = _octant_steps(side, cell.device)
        first = (cell.int() * strides).sum(0, dtype=torch.int32)  # (Q,)
        if self.batch_size > 1:
            first = first + batch.int() * side**3
        return self.grid.index_select(0, (first + corners).flatten()).view(8, -1)

    def centres(self) -> Tensor:
        """(n, 3) centres of the nodes."""
        cell, _ = decode_key(self.key, self.depth)
        return (cell + 0.5) * self.cell_size - HALF_WIDTH

    def batch(self) -> Tensor:
        """(n,) shape of each node."""
        return self.key >> 3 * self.depth

    def map(self, change: Callable[[Tensor], Tensor]) -> Level:
        """The same level with `change`, such as a move to another device, on its tensors."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(self, **{k: change(x) for k, x in values.items() if isinstance(x, Tensor)})


@dataclass(frozen=True)
class Octree:
    """Levels `coarsest` to `depth` of a packed batch of clouds in the cube.

    >>> tree = build_octree(torch.rand(100, 3), torch.zeros(100, dtype=torch.long), depth=4)
    >>> tree.level(4).neighbours.shape[1], tree.leaf.shape
    (27, torch.Size([100]))
    """

    levels: tuple[Level, ...]
    leaf: Tensor
    """(N,) node of the finest level that holds each point."""

    @property
    def depth(self) -> int:
        """Depth of the finest level."""
        return self.levels[-1].depth

    def level(self, depth: int) -> Level:
        """The level of that depth."""
        return self.levels[depth - self.levels[0].depth]

    def node(self, depth: int) -> Tensor:
        """(N,) node of the level of that depth that holds each point."""
        node = self.leaf
        for level in reversed(self.levels[depth - self.levels[0].depth + 1 :]):
            assert level.parent is not None  # only the coarsest level has none
            node = level.parent[node]
        return node

    def to(self, device: torch.device | str) -> Octree:
        """The same octree on another device."""
        levels = tuple(level.map(lambda x: x.to(device)) for level in self.levels)
        return Octree(levels, self.leaf.to(device))


def cell_of(points: Tensor, depth: int) -> Tensor:
    """Cell coordinates (N, 3) of points in the cube."""
    return ((points + HALF_WIDTH) * ((1 << depth) / (2 * HALF_WIDTH))).floor().long()


@torch.no_grad()
def build_octree(points: Tensor, batch: Tensor, depth: int, coarsest: int = 0) -> Octree:
    """Octree of packed clouds (N, 3) in [-HALF_WIDTH, HALF_WIDTH]^3 (Sec. 3.1).

    Args:
        points: (N, 3) in the normalised cube.
        batch: (N,) int64, shape of each point.
        depth: depth of the finest level; `coarsest` that of the coarsest.

    Raises:
        ValueError: a point outside the cube, or a limit of the keys exceeded.
    """
    key = encode_key(cell_of(points, depth), batch, depth)
    batch_size = int(batch.max()) + 1
    key, leaf = torch.unique(key, return_inverse=True)
    keys, parents = [key], [None]
    for _ in range(depth - coarsest):
        coarse, parent = torch.unique_consecutive(keys[0] >> 3, return_inverse=True)
        parents[0] = parent
        keys.insert(0, coarse)
        parents.insert(0, None)
    levels = []
    for i, (key, parent) in enumerate(zip(keys, parents, strict=True)):
        d = coarsest + i
        grid = _dense_grid(key, batch_size, d)
        children = None if i + 1 == len(keys) else _children(keys[i + 1], parents[i + 1], len(key))
        neighbours = _around(key, grid, d, *decode_key(key, d), NEIGHBOURS.to(key.device))
        levels.append(Level(d, batch_size, key, grid, neighbours, children, parent))
    return Octree(tuple(levels), leaf)


def _dense_grid(key: Tensor, batch_size: int, depth: int) -> Tensor | None:
    side = (1 << depth) + 2
    if batch_size * side**3 > DENSE_LIMIT:
        return None
    grid = torch.full((batch_size * side**3,), len(key), dtype=torch.int32, device=key.device)
    grid[_linear(*decode_key(key, depth), side)] = torch.arange(
        len(key), dtype=torch.int32, device=key.device
    )
    return grid


@cache
@torch.inference_mode(False)
def _octant_steps(side: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Strides (3, 1) of a dense grid of that side, steps (8, 1) to a cell's corners; int32."""
    strides = torch.tensor([side * side, side, 1])
    corners = (OCTANTS + 1) @ strides  # the grid has a border of one cell
    return strides.int()[:, None].to(device), corners.int()[:, None].to(device)


def _linear(cell: Tensor, batch: Tensor, side: int) -> Tensor:
    x, y, z = (cell + 1).unbind(-1)
    return ((batch * side + x) * side + y) * side + z


def _around(
    key: Tensor, grid: Tensor | None, depth: int, cell: Tensor, batch: Tensor, offsets: Tensor
) -> Tensor:
    if grid is not None:
        side = (1 << depth) + 2
        steps = offsets @ offsets.new_tensor([side * side, side, 1])
        return grid[_linear(cell, batch, side)[:, None] + steps].long()  # (Q, k)
    cell = cell[:, None] + offsets  # (Q, k, 3)
    inside = ((cell >= 0) & (cell < 1 << depth)).all(-1)
    x, y, z = (spread_bits(c) for c in cell.clamp(0, (1 << depth) - 1).unbind(-1))
    query = batch[:, None] << 3 * depth | x << 2 | y << 1 | z
    at = torch.searchsorted(key, query.contiguous()).clamp_max(len(key) - 1)
    return torch.where(inside & (key[at] == query), at, len(key))


def _children(fine_key: Tensor, parent: Tensor | None, n: int) -> Tensor:
    children = torch.full((n, 8), len(fine_key), device=fine_key.device)
    children[parent, fine_key & 7] = torch.arange(len(fine_key), device=fine_key.device)
    return children
