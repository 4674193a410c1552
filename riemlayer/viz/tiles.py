"""Patterns in the tangent plane, in closed form; `surface.glsl` says the same to the card."""

from __future__ import annotations

from typing import Any

import numpy as np

from riemlayer.viz.palette import BLUE, CREAM, PLAIN
from riemlayer.viz.view import to_numpy

Array = np.ndarray

SECTORS = 16
"""Of the polar grid; even, so that its colours alternate all the way round."""


def checkerboard(log: Any, period: float = 0.1, radius: float = 0.5) -> Array:
    """Colours (N, 3) in [0, 1] of tangent coordinates (N, 2): square tiles up to `radius`.

    Example:
        >>> colours = checkerboard([[0.05, 0.05], [0.05, 0.15], [9.0, 0.0]])
        >>> colours.round(1).tolist()
        [[0.0, 0.4, 0.7], [1.0, 0.9, 0.9], [0.8, 0.8, 0.8]]
    """
    log = to_numpy(log, float)
    return _two_colours(np.floor(log / period).sum(-1), log, radius)


def polar_grid(log: Any, period: float = 0.1, radius: float = 0.5) -> Array:
    """Colours (N, 3) in [0, 1] of tangent coordinates (N, 2): rings of width `period`, 16 sectors.

    Rings are lines of equal distance from the source, borders of sectors are geodesics from it.

    Example:
        >>> colours = polar_grid([[0.05, 0.01], [0.15, 0.01], [9.0, 0.0]])
        >>> colours.round(1).tolist()
        [[0.0, 0.4, 0.7], [1.0, 0.9, 0.9], [0.8, 0.8, 0.8]]
    """
    log = to_numpy(log, float)
    ring = np.floor(np.linalg.norm(log, axis=-1) / period)
    sector = np.floor(np.arctan2(log[..., 1], log[..., 0]) * SECTORS / (2 * np.pi))
    return _two_colours(ring + sector, log, radius)


def _two_colours(tile: Array, log: Array, radius: float) -> Array:
    colours = np.where(tile[..., None] % 2 == 1, CREAM, BLUE)
    return np.where((np.linalg.norm(log, axis=-1) <= radius)[..., None], colours, PLAIN)
