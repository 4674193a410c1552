"""Averages on a surface: Fréchet mean, principal directions, geodesic k-means."""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from torch import Tensor

from riemlayer.calculus import Calculus
from riemlayer.geometry import angle_of
from riemlayer.numerics import product, safe_norm
from riemlayer.ops.arguments import check_cloud, shares
from riemlayer.queries import value_and_jacobian

LONGEST = 0.5
"""Longest step of a mean, in trained radii: beyond it Exp and Log are not to be relied on."""

CANDIDATES = 6
"""Centres that a point chooses from in `kmeans`."""


class Principal(NamedTuple):
    """What `tangent_pca` answers."""

    mean: Tensor
    """(..., 3)"""
    variances: Tensor
    """(..., 2), descending."""
    directions: Tensor
    """(..., 3, 2) unit tangent vectors at the mean, as columns."""


class Clusters(NamedTuple):
    """What `kmeans` answers."""

    centres: Tensor
    """(k, 3)"""
    label: Tensor
    """(N,) int64, the nearest centre of each point."""
    distance: Tensor
    """(N,) geodesic distance to it."""


def frechet_mean(
    surface: Calculus,
    points: Tensor,
    weights: Tensor | None = None,
    *,
    steps: int = 8,
    gradient: Literal["unrolled", "implicit"] = "implicit",
    shape: Tensor | None = None,
) -> Tensor:
    """Weighted Fréchet mean: argmin_x sum_i w_i d(x, q_i)^2, where sum_i w_i Log_x(q_i) = 0 (ours).

    Fixed-point steps x <- Exp_x(sum_i w_i Log_x(q_i)) from the point nearest to the Euclidean mean.
    The mean is unique for points within a convex ball; elsewhere the answer is a local one.

    Args:
        surface: an encoded surface.
        points: (..., K, 3) on it.
        weights: (..., K), not negative; equal ones by default. They are divided by their sum.
        steps: fixed-point steps.
        gradient: "implicit" differentiates the condition at the answer, at the cost of one step and
            to rounding where the steps have converged; "unrolled" differentiates every step.
        shape: (...) int64, cloud of each set; only for a packed batch.

    Shapes: -> (..., 3).

    Raises:
        TypeError, ValueError: there is no point, one is not finite or of another dtype, the weights
            are negative or sum to 0, or `gradient` is another word.
    """
    surface.check(points=points)
    if points.dim() < 2 or points.shape[-2] == 0:
        raise ValueError(f"points must be (..., K, 3) with K >= 1, got {tuple(points.shape)}")
    if gradient not in ("unrolled", "implicit"):
        raise ValueError(f"gradient must be 'unrolled' or 'implicit', got {gradient!r}")
    w = shares(points, weights)
    with torch.set_grad_enabled(torch.is_grad_enabled() and gradient == "unrolled"):
        x = surface.snap(_start(points, w), shape=shape)
        for _ in range(steps):
            v = _short(surface, x, _mean_log(surface, x, points, w, shape), shape)
            x = surface.snap(surface.decode_exp(x, v, shape)[0], shape=shape)
    return _implicit(surface, x, points, w, shape) if gradient == "implicit" else x


def _start(points: Tensor, w: Tensor) -> Tensor:
    """The point (..., 3) nearest to the Euclidean mean."""
    mean = (w[..., None] * points).sum(-2, keepdim=True)
    nearest = (points - mean).square().sum(-1).argmin(-1)[..., None, None]
    return points.gather(-2, nearest.expand(*nearest.shape[:-1], 3)).squeeze(-2)


def _mean_log(
    surface: Calculus, x: Tensor, points: Tensor, w: Tensor, shape: Tensor | None
) -> Tensor:
    """sum_i w_i Log_x(q_i) (..., 3), tangent."""
    wide = None if shape is None else shape[..., None]
    log = surface.decode_log(x[..., None, :], points, wide)[0]
    return surface.project(x, (w[..., None] * log).sum(-2), shape=shape)


def _short(surface: Calculus, x: Tensor, v: Tensor, shape: Tensor | None) -> Tensor:
    """Steps v (..., 3) from x, no longer than a step may be."""
    longest = LONGEST * surface.radius_at(x, shape)[..., None]
    return v * (longest / safe_norm(v)).clamp_max(1)


def _implicit(
    surface: Calculus, x: Tensor, points: Tensor, w: Tensor, shape: Tensor | None
) -> Tensor:
    """One Newton step on F(x) = sum_i w_i Log_x(q_i) whose slope in x is held fixed.

    Its derivative in points and weights is that of the implicit function, -F_x^-1 dF. Where the
    slope is singular, as between points that are too far apart to have one mean, the step is the
    least-squares one.
    """
    axes = surface.frame(x, shape=shape)[..., :2].detach()
    x = x.detach()

    def condition(y: Tensor) -> Tensor:
        return _mean_log(surface, y, points, w, shape)

    with torch.no_grad():
        _, slope = value_and_jacobian(condition, x)
        slope = product(axes.mT, slope, axes)
        eye = torch.finfo(x.dtype).eps * torch.eye(2, dtype=x.dtype, device=x.device)
        inverse = torch.linalg.solve(product(slope.mT, slope) + eye, slope.mT)
    step = product(axes, inverse, axes.mT, condition(x)[..., None]).squeeze(-1)
    return x - _short(surface, x, step, shape)


def tangent_pca(
    surface: Calculus,
    points: Tensor,
    weights: Tensor | None = None,
    *,
    shape: Tensor | None = None,
) -> Principal:
    """Principal directions of points around their Fréchet mean, in its tangent plane (ours).

    Gradients are finite where no direction stands out, as of coincident points.

    Args, Raises: as for `frechet_mean`.
    """
    mean = frechet_mean(surface, points, weights, shape=shape)
    w = shares(points, weights)
    wide = None if shape is None else shape[..., None]
    log = surface.decode_log(mean[..., None, :], points, wide)[0]
    axes = surface.frame(mean, shape=shape)[..., :2]
    x = product(log, axes)  # (..., K, 2)
    variances, first = _principal(product(x.mT, w[..., None] * x).flatten(-2))
    second = torch.stack((-first[..., 1], first[..., 0]), -1)
    return Principal(mean, variances, product(axes, torch.stack((first, second), -1)))


def _principal(m: Tensor) -> tuple[Tensor, Tensor]:
    """Eigenvalues (..., 2), descending, of symmetric matrices (..., 4) and first eigenvectors.

    In closed form, as the gradient of `eigh` is not finite where eigenvalues coincide.
    """
    a, b, _, c = m.unbind(-1)
    apart = torch.stack(((a - c) / 2, b), -1)  # twice the angle of the first axis
    size = safe_norm(apart).squeeze(-1)
    half = angle_of(apart) / 2
    middle = (a + c) / 2
    first = torch.stack((half.cos(), half.sin()), -1)
    return torch.stack((middle + size, (middle - size).clamp_min(0)), -1), first


@torch.no_grad()
def kmeans(
    surface: Calculus, points: Tensor, k: int, *, steps: int = 10, seed: int = 0
) -> Clusters:
    """Geodesic k-means of points of one surface: Lloyd's steps with Fréchet means (ours).

    Of all points of a cloud it is a centroidal Voronoi tessellation. Centres start far apart, each
    the farthest point from those before it. Ones with empty cells stay where they are.

    Args:
        surface: an encoded surface of one shape.
        points: (N, 3) on it.
        k: clusters. Distances are reliable where cells are within the trained radius.
        steps: Lloyd's steps.
        seed: of the first centre.

    Raises:
        TypeError, ValueError: k is not in [1, N], or points are not (N, 3), finite and of the
            surface's dtype.
    """
    centres = points[farthest_points(surface, points, k, seed)]
    label, distance = _nearest(surface, centres, points)
    for _ in range(steps):
        for i in label.unique().tolist():
            own = points[label == i]
            start = surface.decode_log(centres[i], own)[0].mean(0)
            moved = surface.project(centres[i], start)
            centres[i] = surface.snap(surface.decode_exp(centres[i], moved)[0])
        old, (label, distance) = label, _nearest(surface, centres, points)
        if torch.equal(old, label):
            break
    return Clusters(centres, label, distance)


@torch.no_grad()
def farthest_points(surface: Calculus, points: Tensor, k: int, seed: int = 0) -> Tensor:
    """Indices (k,) of points, each geodesically farthest from those before it (ours).

    Args, Raises: as for `kmeans`.
    """
    check_cloud(surface, points)
    if not 1 <= k <= len(points):
        raise ValueError(f"k must lie in [1, {len(points)}] (the points), got {k}")
    generator = torch.Generator().manual_seed(seed)
    chosen = [int(torch.randint(len(points), (), generator=generator))]
    distance = surface.dist(points[chosen[0]], points)
    for _ in range(k - 1):
        chosen.append(int(distance.argmax()))
        distance = torch.minimum(distance, surface.dist(points[chosen[-1]], points))
    return torch.tensor(chosen, device=points.device)


def _nearest(surface: Calculus, centres: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Nearest centre (N,) of each point and the distance (N,) to it.

    Asked of the centres that are nearest along the chord alone: the others are farther away than
    Log is to be relied on.
    """
    chord = torch.cdist(points, centres)
    tried = chord.topk(min(CANDIDATES, len(centres)), largest=False)[1]
    distance = torch.full_like(chord, torch.inf)
    for i, centre in enumerate(centres):
        asked = (tried == i).any(-1).nonzero().squeeze(-1)
        distance[asked, i] = surface.dist(centre, points[asked])
    nearest, label = distance.min(-1)
    return label, nearest
