"""Clouds on the zero level of a function: signed distances and occupancies (appendix C)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from riemlayer.checks import check_finite

Function = Callable[[Tensor], Tensor]
"""Points (Q, 3) to values (Q,) or (Q, 1): a function, a module, a closure over a network."""
Bounds = Tensor | Sequence[Any]

CHUNK = 1 << 16
"""Points that the function is given at once, by default."""
BATCH = 1 << 12
"""Fewest random queries drawn at once; otherwise two for each point asked for."""
EFFORT = 40
"""Batches after which the search ends."""
TOLERANCE = 1e-3
"""Largest estimated distance to the level, in diagonals of the bounds, of a point that is kept."""
STRIDE = 0.5
"""Longest step of a projection, in diagonals of the bounds."""


class LevelSamples(NamedTuple):
    """Points on the zero level of a function."""

    points: Tensor
    """(n, 3)"""
    normals: Tensor
    """(n, 3) unit gradients: outward where the function grows outward."""
    residual: Tensor
    """(n,) |f| at the points."""


class Crossings(NamedTuple):
    """Points where an occupancy changes."""

    points: Tensor
    """(n, 3) middles of the last brackets."""
    width: Tensor
    """(n,) lengths of the brackets: twice the largest distance to the change."""


def sample_sdf(
    f: Function,
    n: int,
    bounds: Bounds,
    *,
    iterations: int = 5,
    seed: int = 0,
    chunk_size: int = CHUNK,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> LevelSamples:
    """n points of the zero level of f, by projecting random queries onto it (Eq. (7)).

    x <- x - f(x) grad f(x) / |grad f(x)|^2, which is Eq. (7) for a distance, whose gradient has
    length 1; the square makes it Newton's step for other functions (ours). Queries that do not
    arrive, or leave the bounds, are replaced by new ones. Points are dense where many queries
    arrive, so they are not uniform by area.

    Args:
        f: any torch function or module; its gradient is taken by autograd. The sign has no meaning,
            and need not change: an unsigned distance will do.
        n: points.
        bounds: lowest and highest corner (2, 3), or two numbers for a cube.
        iterations: of Eq. (7).
        seed: of the queries; the same on every device.
        chunk_size: points that f is given at once.
        device, dtype: of the points; by default those of a module's parameters, or float32.

    Raises:
        TypeError, ValueError: a wrong argument, f of another shape or not differentiable, or fewer
            than n points found, as where f is nowhere 0.

    >>> sphere = sample_sdf(lambda x: x.norm(dim=-1) - 0.5, 100, bounds=(-1, 1))
    >>> bool((sphere.points.norm(dim=-1) - 0.5).abs().max() < 1e-6), sphere.normals.shape
    (True, torch.Size([100, 3]))
    """
    _check_counts(n=n, iterations=iterations, chunk_size=chunk_size)
    low, high = _corners(bounds, f, device, dtype)
    diagonal = float((high - low).norm())
    parts, found = [], 0
    for queries in _queries(low, high, n, seed):
        for x in queries.split(chunk_size):
            for _ in range(iterations):
                value, gradient = _value_and_gradient(f, x)
                step = value / gradient.square().sum(-1).clamp_min(torch.finfo(x.dtype).tiny)
                step = (step[:, None] * gradient).nan_to_num(0, 0, 0)
                length = step.norm(dim=-1, keepdim=True)
                x = x - step * (STRIDE * diagonal / length.clamp_min(STRIDE * diagonal))
            value, gradient = _value_and_gradient(f, x)
            slope = gradient.norm(dim=-1)
            near = (value.abs() <= TOLERANCE * diagonal * slope) & (slope > 0)
            near &= ((x >= low) & (x <= high)).all(-1) & slope.isfinite()
            normals = gradient[near] / slope[near, None]
            parts.append(LevelSamples(x[near], normals, value[near].abs()))
            found += len(parts[-1].points)
        if found >= n:
            return LevelSamples(*(torch.cat(rows)[:n] for rows in zip(*parts, strict=True)))
    raise ValueError(
        f"`f` must be 0 on a surface within `bounds`, found {found} of {n} points of it; check the "
        "bounds, or use sample_occupancy if f is a step"
    )


def sample_occupancy(
    g: Function,
    n: int,
    bounds: Bounds,
    *,
    level: float = 0.5,
    iterations: int = 20,
    seed: int = 0,
    chunk_size: int = CHUNK,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> Crossings:
    """n points where an occupancy changes, by bisection between points inside and outside (app. C).

    Args:
        g: any torch function or module: booleans, or numbers that are above `level` inside. No
            gradient is taken.
        n: points.
        bounds: lowest and highest corner (2, 3), or two numbers for a cube.
        level: 0.5 for probabilities, 0 for logits and for the signs of the paper.
        iterations: halvings of the segment between the two points of a pair.
        seed, chunk_size, device, dtype: as for `sample_sdf`.

    Raises:
        TypeError, ValueError: a wrong argument, g of another shape, or bounds without an inside or
            without an outside.

    >>> ball = sample_occupancy(lambda x: x.norm(dim=-1) < 0.5, 100, bounds=(-1, 1))
    >>> bool((ball.points.norm(dim=-1) - 0.5).abs().max() < 1e-5)
    True
    """
    _check_counts(n=n, iterations=iterations, chunk_size=chunk_size)
    low, high = _corners(bounds, g, device, dtype)

    def inside(x: Tensor) -> Tensor:
        return torch.cat([_values(g, y) > level for y in x.split(chunk_size)])

    with torch.no_grad():
        ends = [low.new_zeros(0, 3), low.new_zeros(0, 3)]
        for x in _queries(low, high, n, seed):
            is_in = inside(x)
            ends = [torch.cat((ends[0], x[is_in])), torch.cat((ends[1], x[~is_in]))]
            if min(map(len, ends)) >= min(n, BATCH // 4):
                break
        if min(map(len, ends)) == 0:
            kind = "above" if len(ends[0]) == 0 else "below"
            raise ValueError(
                f"`g` must be {kind} `level` = {level} somewhere within `bounds`, it is so at none "
                f"of {max(map(len, ends))} points; check the bounds and the level"
            )
        generator = torch.Generator().manual_seed(seed + 1)
        a, b = (x[_picks(n, len(x), generator).to(x.device)] for x in ends)
        for _ in range(iterations):
            middle = (a + b) / 2
            is_in = inside(middle)[:, None]
            a, b = torch.where(is_in, middle, a), torch.where(is_in, b, middle)
        return Crossings((a + b) / 2, (a - b).norm(dim=-1))


def _picks(n: int, size: int, generator: torch.Generator) -> Tensor:
    """n indices below `size`, each of them as often as any other, in random order."""
    index = torch.randperm(size, generator=generator).repeat(-(-n // size))[:n]
    return index[torch.randperm(n, generator=generator)]


def _queries(low: Tensor, high: Tensor, n: int, seed: int) -> Iterator[Tensor]:
    """Random points of the bounds, batch by batch; drawn on the CPU, so alike on every device."""
    generator = torch.Generator().manual_seed(seed)
    batch = max(BATCH, 2 * n)
    for _ in range(EFFORT):
        unit = torch.rand(batch, 3, generator=generator, dtype=torch.float64)
        yield low + (high - low) * unit.to(low)


def _corners(
    bounds: Bounds,
    f: Function,
    device: torch.device | str | None,
    dtype: torch.dtype | None,
) -> tuple[Tensor, Tensor]:
    own = next(f.parameters(), None) if isinstance(f, nn.Module) else None
    device = device or (torch.device("cpu") if own is None else own.device)
    dtype = dtype or (torch.float32 if own is None else own.dtype)
    corners = torch.as_tensor(bounds, dtype=dtype, device=device)
    if corners.shape not in ((2, 3), (2,)):
        raise ValueError(
            f"`bounds` must be the lowest and the highest corner (2, 3), got {tuple(corners.shape)}"
        )
    check_finite("bounds", corners)
    low, high = corners.reshape(2, -1).expand(2, 3)
    if not bool((high > low).all()):
        raise ValueError(f"`bounds` must grow from low to high, got {low.tolist()} {high.tolist()}")
    return low, high


def _check_counts(**counts: int) -> None:
    for name, count in counts.items():
        if not isinstance(count, int) or count < 1:
            raise ValueError(f"`{name}` must be a whole number of at least 1, got {count!r}")


def _values(f: Function, x: Tensor) -> Tensor:
    """f(x) as (Q,)."""
    value = f(x)
    if not isinstance(value, Tensor) or value.shape not in ((len(x),), (len(x), 1)):
        got = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
        raise ValueError(
            f"the function must answer ({len(x)},) or ({len(x)}, 1) for points ({len(x)}, 3), "
            f"got {got}"
        )
    return value.reshape(-1)


def _value_and_gradient(f: Function, x: Tensor) -> tuple[Tensor, Tensor]:
    """f(x) (Q,) and its gradient (Q, 3), without a graph; parameters gather no gradient."""
    with torch.inference_mode(False), torch.enable_grad():
        x = x.detach().clone().requires_grad_()
        value = _values(f, x)
        if not value.requires_grad:
            raise ValueError(
                "`f` must be differentiable by torch, its answer does not depend on its argument; "
                "leave out no_grad and detach, or use sample_occupancy"
            )
        (gradient,) = torch.autograd.grad(value.sum(), x)
    return value.detach(), gradient
