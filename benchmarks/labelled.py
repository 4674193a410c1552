"""Closed meshes with labelled vertices, on which near in space and near on the surface differ.

Figures: bodies whose arms hang beside the torso and whose legs stand side by side; labels are head,
torso, arm, leg. Sheets: thin plates folded so that layer lies on layer; labels are the two sides,
each in two halves.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from riemlayer.data.meshes import is_watertight_manifold, normalise, remesh

Array = np.ndarray
Solid = Callable[[Array], tuple[Array, Array]]
"""Signed distances (n,), negative inside, and labels (n,) of points (n, 3)."""
CLASSES = 4
CELLS = 96
"""Of the longest side of the grid that a solid is sampled on."""


class Labelled(NamedTuple):
    """A manifold mesh in [-1, 1]^3."""

    vertices: Array
    """(n, 3)"""
    faces: Array
    """(m, 3)"""
    label: Array
    """(n,) in [0, 4)"""
    kind: str


def labelled(kind: str, seed: int, count: int = 2000) -> Labelled:
    """A random figure or sheet of about `count` isotropic vertices.

    Raises:
        ValueError: the kind is another.
    """
    if kind not in ("figure", "sheet"):
        raise ValueError(f"kind must be 'figure' or 'sheet', got {kind!r}")
    rng = np.random.default_rng([seed, len(kind)])
    while True:
        solid, low, high = figure(rng) if kind == "figure" else sheet(rng)
        vertices, faces = remesh(*surface_of(solid, low, high), count=count)
        if is_watertight_manifold(vertices, faces):
            return Labelled(normalise(vertices)[0], faces, solid(vertices)[1], kind)


def surface_of(solid: Solid, low: Array, high: Array) -> tuple[Array, Array]:
    """Marching cubes on a grid over a box."""
    from skimage.measure import marching_cubes

    step = (high - low).max() / CELLS
    axes = [np.arange(a - 2 * step, b + 3 * step, step) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    distance = np.concatenate([solid(plane.reshape(-1, 3))[0] for plane in grid])
    vertices, faces, _, _ = marching_cubes(distance.reshape(grid.shape[:3]), 0.0)
    return vertices * step + grid[0, 0, 0], faces[:, ::-1].astype(np.int64)


def figure(rng: np.random.Generator) -> tuple[Solid, Array, Array]:
    """A standing body, and the box that holds it."""
    rods: list[tuple[Array, Array, float, int]] = []

    def limb(label: int, start: Array, tilts: Array, lengths: Array, radius: float) -> None:
        """A chain of rods that go down, tilted sideways (x) and forward (y)."""
        for (x, y), length in zip(tilts, lengths, strict=True):
            down = np.array([np.sin(x), np.sin(y), -np.cos(x) * np.cos(y)])
            end = start + length * down / np.linalg.norm(down)
            rods.append((start, end, radius, label))
            start = end

    fat, arm, leg = rng.uniform(0.13, 0.2), rng.uniform(0.05, 0.08), rng.uniform(0.07, 0.1)
    right, _, up = np.eye(3)
    neck = rng.uniform(0.5, 0.65) * up
    rods.append((np.zeros(3), neck, fat, 1))
    rods.append((neck, neck + (fat + 0.1) * up, 0.08, 1))
    rods.append((neck + (fat + 0.12) * up, neck + (fat + 0.2) * up, rng.uniform(0.1, 0.15), 0))
    for side in (-1.0, 1.0):
        shoulder = neck + 0.02 * up + side * (fat + arm + rng.uniform(0.03, 0.07)) * right
        rods.append((neck, shoulder, arm, 2))
        out = side * rng.uniform(-0.02, 0.25)
        tilts = np.array([[out, rng.uniform(-0.3, 0.3)], [out / 2, rng.uniform(-0.2, 0.6)]])
        limb(2, shoulder, tilts, rng.uniform(0.28, 0.4, 2), arm)
        hip = side * (leg + rng.uniform(0.015, 0.05)) * right - 0.05 * up
        out = side * rng.uniform(0.0, 0.12)
        tilts = np.array([[out, rng.uniform(-0.3, 0.3)], [out, rng.uniform(-0.5, 0.1)]])
        limb(3, hip, tilts, rng.uniform(0.35, 0.5, 2), leg)
    a, b = np.array([r[0] for r in rods]), np.array([r[1] for r in rods])
    radius, part = np.array([r[2] for r in rods]), np.array([r[3] for r in rods])
    axis = b - a
    square = (axis**2).sum(-1)

    def solid(x: Array) -> tuple[Array, Array]:
        offset = x[:, None] - a
        foot = ((offset * axis).sum(-1) / square).clip(0, 1)
        distance = np.linalg.norm(offset - foot[..., None] * axis, axis=-1) - radius
        return distance.min(1), part[distance.argmin(1)]

    reach = radius[:, None]
    return solid, np.minimum(a, b).min(0) - reach.max(), np.maximum(a, b).max(0) + reach.max()


def sheet(rng: np.random.Generator) -> tuple[Solid, Array, Array]:
    """A plate along a path that turns back and forth, and the box that holds it."""
    layers, pitch = int(rng.integers(2, 5)), rng.uniform(0.16, 0.26)
    half, width = pitch * rng.uniform(0.17, 0.25), rng.uniform(0.25, 0.4)
    path = [np.zeros(2)]
    for i in range(layers):
        way = 1.0 if i % 2 == 0 else -1.0
        path.append(path[-1] + [way * rng.uniform(0.7, 1.2), rng.uniform(-0.05, 0.05)])
        if i < layers - 1:
            turn = np.linspace(-np.pi / 2, np.pi / 2, 9)[1:]
            bend = np.c_[way * np.cos(turn), np.sin(turn) + 1] * pitch / 2
            path.extend(path[-1] + bend)
    a, b = np.array(path[:-1]), np.array(path[1:])
    axis = b - a
    square = (axis**2).sum(-1)
    before = np.r_[0, np.sqrt(square).cumsum()]

    def solid(x: Array) -> tuple[Array, Array]:
        offset = x[:, None, [0, 2]] - a
        foot = ((offset * axis).sum(-1) / square).clip(0, 1)
        away = offset - foot[..., None] * axis
        distance = np.linalg.norm(away, axis=-1)
        nearest = distance.argmin(1)[:, None]
        cross = axis[:, 0] * away[..., 1] - axis[:, 1] * away[..., 0]
        along = before[:-1] + foot * np.sqrt(square)
        side = np.take_along_axis(cross, nearest, 1)[:, 0] > 0
        late = np.take_along_axis(along, nearest, 1)[:, 0] > before[-1] / 2
        rim = np.abs(x[:, 1]) - width
        return np.maximum(distance.min(1) - half, rim), 2 * side + late

    flat = np.array(path)
    low, high = flat.min(0) - half, flat.max(0) + half
    return solid, np.array([low[0], -width, low[1]]), np.array([high[0], width, high[1]])
