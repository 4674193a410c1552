"""A cloud as a surface of small discs: how large they are and what varies across each."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from riemlayer.viz.view import tangent_frame, unit

Array = np.ndarray

NEAR = 24
"""Neighbours that a disc is fitted to."""
RIM = 8
"""A disc reaches `OVERLAP` times as far as this neighbour: random samples leave no holes then."""
OVERLAP = 1.1
LONE = 1.15
"""A disc is at most that much larger than its neighbours: those at corners are."""
STIFFNESS = np.diag([0.0, 0.0, 0.0, 0.003, 0.003, 0.003]) + 1e-6 * np.eye(6)
"""Keeps the fit of few or noisy neighbours from bending wildly."""
SHEET = 4.0
"""A neighbour that is that many times as high above the disc as usual lies on another sheet."""
SMOOTH, LEAST = 0.1, 0.4
"""Where the root mean square distance of the neighbours to the fitted surface is above `SMOOTH` of
its size, a disc shrinks, at most to `LEAST`: at sharp edges."""
GAP = 2.6
"""Angle (radians) without neighbours from which on a point lies at the border of the surface."""
BORDER = 0.3
"""A disc at the border ends there on the outer side, in distances to neighbour `RIM`."""


class Discs(NamedTuple):
    """One tangent disc a point, in the order of the cloud."""

    neighbours: Array
    """(N, k) indices of points of the same sheet; the point itself where there are fewer."""
    normals: Array
    """(N, 3) unit; their sign has no meaning unless it was given."""
    size: Array
    """(N,) radius."""
    bend: Array
    """(N, 3, 3) derivative of the normal along the surface: discs shaded with it look smooth."""
    rim: Array
    """(N, 3) a disc at the border of the surface ends where offset . rim = 1; 0 elsewhere."""
    spacing: float
    """Median distance to the third neighbour."""


def fit_discs(points: Array, normals: Array | None = None) -> Discs:
    """Discs that cover a raw cloud (N, 3), from its nearest neighbours (ours).

    Args:
        points: (N, 3)
        normals: (N, 3) where they are known; a fit to the neighbours otherwise.
    """
    near, distance = neighbourhoods(points, NEAR)
    spacing = float(np.median(distance[:, min(3, distance.shape[1] - 1)]))
    itself = np.arange(len(points))
    axis = plane_normals(points, near, distance) if normals is None else normals
    own = same_sheet(points, axis, near)
    if normals is None:  # the plane of two sheets together leans
        axis = fit_normals(points, axis, np.where(own, near, itself[:, None]))[0]
        own = same_sheet(points, axis, near)
    neighbours = np.where(own, near, itself[:, None])
    last = (own.cumsum(1) > RIM).argmax(1)  # 0 where the sheet has no more neighbours than that
    reach = distance[itself, np.where(last > 0, last, -1)]
    reach = np.minimum(reach, LONE * np.median(reach[neighbours], axis=1))
    if normals is None:
        normals, bend, misfit = fit_normals(points, axis, neighbours)
        normals = agreed_normals(points, normals, bend, neighbours)
        reach = reach * (SMOOTH * reach / misfit.clip(1e-300)).clip(LEAST, 1)
    else:
        bend = bends(points, normals, neighbours)
    rim, share = borders(points, normals, neighbours, reach)
    return Discs(neighbours, normals, OVERLAP * share * reach, bend, rim, spacing)


def neighbourhoods(points: Array, k: int) -> tuple[Array, Array]:
    """Indices and distances (N, k) of the nearest points, nearest first."""
    import torch

    from riemlayer.field import bounding_cubes
    from riemlayer.octree import build_octree
    from riemlayer.octree.search import knn

    x, batch = torch.from_numpy(points).float(), torch.zeros(len(points), dtype=torch.long)
    centre, scale = bounding_cubes(x, batch)
    scale = scale.clamp_min(1e-30)
    x = ((x - centre) / scale[:, None]).clamp(-1, 1)
    depth = min(max(round(math.log(len(x) / 4, 4)), 1), 8)
    index, distance = knn(build_octree(x, batch, depth), x, x, min(k, len(x)))
    return index.numpy(), distance.double().numpy() * float(scale[0])


def plane_normals(points: Array, neighbours: Array, distance: Array) -> Array:
    """Unit normals (N, 3): the direction in which the neighbours (N, k) spread least."""
    weight = (1.01 - (distance / distance[:, -1:].clip(1e-300)) ** 2)[..., None]
    mean = (weight * points[neighbours]).sum(1, keepdims=True) / weight.sum(1, keepdims=True)
    offset = points[neighbours] - mean
    return np.linalg.eigh(offset.transpose(0, 2, 1) @ (weight * offset))[1][..., 0]


def same_sheet(points: Array, normals: Array, neighbours: Array) -> Array:
    """(N, k) bool: the neighbour is about as high over the plane at the point as a third of all."""
    offset = points[neighbours] - points[:, None]
    height = np.abs((offset * normals[:, None]).sum(-1))
    third = neighbours.shape[1] // 3
    usual = np.partition(height, third, axis=1)[:, third, None]
    return height <= SHEET * usual + 1e-3 * np.linalg.norm(offset[:, -1:], axis=-1)


def fit_normals(points: Array, axis: Array, neighbours: Array) -> tuple[Array, Array, Array]:
    """Unit normals (N, 3), their derivatives along the surface (N, 3, 3), and the misfit (N,).

    A quadratic height along the axis (N, 3) is fitted to the neighbours (N, k), near ones counting
    more: a plane alone leans wherever samples of a curved surface are uneven.
    """
    offset = points[neighbours] - points[:, None]
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    scale = distance.max(1, keepdims=True).clip(1e-300)
    weight, offset = 1.01 - (distance / scale) ** 2, offset / scale
    plane = tangent_frame(axis)  # (N, 2, 3)
    x, y = (offset @ plane.transpose(0, 2, 1)).transpose(2, 0, 1)
    height = (offset * axis[:, None]).sum(-1, keepdims=True)
    terms = np.stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2], -1)
    moment = terms.transpose(0, 2, 1) @ (weight * terms) + STIFFNESS
    c = np.linalg.solve(moment, terms.transpose(0, 2, 1) @ (weight * height))
    misfit = (weight * (height - terms @ c) ** 2).sum((1, 2)) / weight.sum((1, 2))
    normals = unit(axis - (c[:, 1:3] * plane).sum(1))
    hessian = c[:, [3, 4, 4, 5], 0].reshape(-1, 2, 2)
    bend = -plane.transpose(0, 2, 1) @ hessian @ plane / scale
    return normals, bend, np.sqrt(misfit) * scale[:, 0, 0]


def agreed_normals(points: Array, normals: Array, bend: Array, neighbours: Array) -> Array:
    """Unit normals (N, 3): the mean of what the neighbours expect, those that disagree left out."""
    step = points[:, None] - points[neighbours]
    expected = normals[neighbours] + (bend[neighbours] @ step[..., None])[..., 0]
    alike = (unit(expected) * normals[:, None]).sum(-1, keepdims=True)
    return unit((alike**9 * expected).sum(1))


def borders(points: Array, normals: Array, neighbours: Array, reach: Array) -> tuple[Array, Array]:
    """Where discs end short: a wide angle without neighbours is outside.

    Args:
        points, normals, neighbours: (N, 3), (N, 3) and (N, k).
        reach: (N,) distance to neighbour `RIM`.

    Returns:
        (N, 3) `Discs.rim`, and what share (N,) of the size is left: less than 1 at corners.
    """
    axes = tangent_frame(normals)
    x, y = ((points[neighbours] - points[:, None]) @ axes.transpose(0, 2, 1)).T  # (k, N)
    alone = np.equal(neighbours.T, np.arange(len(points)))
    angle = np.where(alone, -np.inf, np.arctan2(y, x))
    angle = np.sort(np.where(np.isfinite(angle), angle, angle.max(0).clip(-np.pi)), axis=0)
    gap = np.diff(angle, axis=0, append=angle[:1] + 2 * np.pi)
    widest = gap.argmax(0)[None]
    gap, start = (np.take_along_axis(z, widest, 0)[0] for z in (gap, angle))
    middle = start + gap / 2
    out = np.cos(middle)[:, None] * axes[:, 0] + np.sin(middle)[:, None] * axes[:, 1]
    rim = np.where((gap > GAP)[:, None], out / (BORDER * reach.clip(1e-300))[:, None], 0.0)
    return rim, (2 - gap / np.pi).clip(0.3, 1)


def slopes(points: Array, x: Array, neighbours: Array) -> Array:
    """Least-squares derivative (N, m, 3) of a map (N, m) along the surface."""
    return _derivative(points, neighbours, x[neighbours] - x[:, None])


def bends(points: Array, normals: Array, neighbours: Array) -> Array:
    """Least-squares derivative (N, 3, 3) of the normals (N, 3), whatever their signs."""
    around = normals[neighbours]
    sign = np.where((around * normals[:, None]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    return _derivative(points, neighbours, sign * around - normals[:, None])


def _derivative(points: Array, neighbours: Array, dy: Array) -> Array:
    """(N, m, 3) the slope that explains differences (N, k, m) to the neighbours best."""
    dx = points[neighbours] - points[:, None]
    moment = dx.transpose(0, 2, 1) @ dx
    trace = np.trace(moment, axis1=1, axis2=2).clip(1e-300)
    moment += 1e-2 * trace[:, None, None] * np.eye(3)
    return np.linalg.solve(moment, dx.transpose(0, 2, 1) @ dy).transpose(0, 2, 1)
