"""Averages on a surface: Fréchet mean, principal directions, geodesic k-means."""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from torch import Tensor

from riemlayer.calculus import Calculus
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
        ValueError: there is no point, the weights are negative or sum to 0, or `gradient` is
            another word.
    """
    if points.dim() < 2 or points.shape[-2] == 0:
        raise ValueError(f"points must be (..., K, 3) with K >= 1, got {tuple(points.shape)}")
    if gradient not in ("unrolled", "implicit"):
        raise ValueError(f"gradient must be 'unrolled' or 'implicit', got {gradient!r}")
    w = torch.ones_like(points[..., 0]) if weights is None else weights.expand(points.shape[:-1])
    if bool((w < 0).any()) or bool((w.sum(-1) <= 0).any()):
        raise ValueError("weights must be at least 0 and not all 0")
    w = w / w.sum(-1, keepdim=True)
    with torch.set_grad_enabled(torch.is_grad_enabled() and gradient == "unrolled"):
        x = _start(points, w)
        for _ in range(steps):
            v = _mean_log(surface, x, points, w, shape)
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
    """sum_i w_i Log_x(q_i) (..., 3), tangent, no longer than a step may be."""
    wide = None if shape is None else shape[..., None]
    log = surface.decode_log(x[..., None, :], points, wide)[0]
    v = surface.project(x, (w[..., None] * log).sum(-2), shape=shape)
    longest = LONGEST * surface.radius_at(x, shape)
    return v * (longest / surface.norm(x, v).clamp_min(1e-12)).clamp_max(1)[..., None]


def _implicit(
    surface: Calculus, x: Tensor, points: Tensor, w: Tensor, shape: Tensor | None
) -> Tensor:
    """One Newton step on F(x) = sum_i w_i Log_x(q_i) whose slope in x is held fixed.

    Its derivative in points and weights is that of the implicit function, -F_x^-1 dF.
    """
    axes = surface.frame(x, shape=shape)[..., :2].detach()
    x = x.detach()

    def condition(y: Tensor) -> Tensor:
        return _mean_log(surface, y, points, w, shape)

    with torch.no_grad():
        _, slope = value_and_jacobian(condition, x)
        slope = axes.mT @ slope @ axes
    step = torch.linalg.solve(slope, axes.mT @ condition(x)[..., None])
    return x - (axes @ step).squeeze(-1)


def tangent_pca(
    surface: Calculus,
    points: Tensor,
    weights: Tensor | None = None,
    *,
    shape: Tensor | None = None,
) -> Principal:
    """Principal directions of points around their Fréchet mean, in its tangent plane (ours).

    Args: as for `frechet_mean`.
    """
    mean = frechet_mean(surface, points, weights, shape=shape)
    w = torch.ones_like(points[..., 0]) if weights is None else weights.expand(points.shape[:-1])
    w = w / w.sum(-1, keepdim=True)
    wide = None if shape is None else shape[..., None]
    log = surface.decode_log(mean[..., None, :], points, wide)[0]
    axes = surface.frame(mean, shape=shape)[..., :2]
    x = log @ axes  # (..., K, 2)
    variances, vectors = torch.linalg.eigh(x.mT @ (w[..., None] * x))
    return Principal(mean, variances.flip(-1), axes @ vectors.flip(-1))


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
        ValueError: k is not in [1, N].
    """
    if not 1 <= k <= len(points):
        raise ValueError(f"k must lie in [1, {len(points)}] (the points), got {k}")
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

    Args: as for `kmeans`.
    """
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
