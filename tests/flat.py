"""A flat square as a mesh and as a cloud, on which every picture is known pixel by pixel."""

from __future__ import annotations

from typing import Any

import numpy as np

from riemlayer.viz import Canvas, Drawing, View, viewpoint


def grid(n: int = 21) -> tuple[np.ndarray, np.ndarray]:
    """A flat square of side 1 with its middle at the origin, and its triangles."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, n), np.linspace(-0.5, 0.5, n))
    points = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    i = np.arange(n * n).reshape(n, n)
    corner = [i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]]
    a, b, c, d = (k.reshape(-1) for k in corner)
    return points, np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])


def flat_canvas(mesh: bool, n: int = 21) -> Canvas:
    """The square, to be drawn."""
    points, faces = grid(n)
    return Canvas(points, faces if mesh else None)


def flat_drawing(mesh: bool, **extra: Any) -> Drawing:
    """The square with its own coordinates as the log map of its middle."""
    canvas = flat_canvas(mesh)
    content = {"log": canvas.points[:, :2], "p": [0, 0, 0], "radius": 0.3}
    return Drawing(canvas, **content | extra)


def from_above() -> View:
    """The camera straight above the square."""
    return viewpoint(grid(2)[0], [0, 0, 1], tilt=0)


def places(size: int) -> np.ndarray:
    """(size, size, 2) where on the square each pixel of a picture `from_above` looks."""
    x = (np.arange(size) + 0.5) / size * 1.25 - 0.625  # a picture is a quarter wider than the shape
    return np.stack(np.meshgrid(x, -x), -1)
