"""Colours of all pictures and pages: apart for colour-blind eyes and in grey print too."""

from __future__ import annotations

from typing import Any

import numpy as np

Array = np.ndarray
Colour = tuple[float, float, float]

BLUE, CREAM = (0.0, 0.447, 0.698), (0.965, 0.945, 0.875)
"""The two tiles: apart in lightness, so that no kind of colour blindness merges them."""
PLAIN = (0.80, 0.80, 0.82)
"""Surface out of reach of the map."""
ORANGE, BLACK = (0.835, 0.369, 0.0), (0.1, 0.1, 0.1)
"""Geodesics: the answer, and the reference beside it."""
WHITE = (1.0, 1.0, 1.0)
"""Rim of the source, which must be seen on dark values too."""
DOT = (0.35, 0.35, 0.4)
"""Marked points, such as the cloud that stands for a mesh."""

CHARTS: tuple[Colour, ...] = (
    (0.0, 0.447, 0.698),
    (0.902, 0.624, 0.0),
    (0.0, 0.620, 0.451),
    (0.800, 0.475, 0.655),
    (0.337, 0.706, 0.914),
    (0.835, 0.369, 0.0),
    (0.941, 0.894, 0.259),
)
"""Labels: the palette of Okabe and Ito without its black."""

MAP = ((0.27, 0.045, -0.135), (0.62, -0.2, 0.01), (0.91, -0.035, 0.17))
"""Control points of the colour map, a quadratic curve in OKLab: dark violet, green, light yellow.

Lightness grows all the way and nearly evenly, so the order of values survives every kind of colour
blindness and a grey printer.
"""
_TO_LMS = np.array(
    [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728],
     [1, -0.0894841775, -1.2914855480]]
)  # fmt: skip
_TO_RGB = np.array(
    [[4.0767416621, -3.3077115913, 0.2309699292], [-1.2684380046, 2.6097574011, -0.3413193965],
     [-0.0041960863, -0.7034186147, 1.7076147010]]
)  # fmt: skip


def colour_map(t: Any) -> Array:
    """Colours (..., 3) in [0, 1] of numbers t (...): dark violet at 0, light yellow at 1 (ours).

    Numbers outside [0, 1] get the colour of the nearer end.

    Example:
        >>> colour_map([0.0, 1.0]).round(2).tolist()
        [[0.16, 0.03, 0.4], [0.98, 0.89, 0.24]]
    """
    t = np.clip(np.asarray(t, float), 0, 1)[..., None]
    first, middle, last = np.array(MAP)
    lab = (1 - t) ** 2 * first + 2 * t * (1 - t) * middle + t**2 * last
    linear = np.clip((lab @ _TO_LMS.T) ** 3 @ _TO_RGB.T, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def label_colours(labels: Any) -> Array:
    """Colours (..., 3) of labels (...) 0, 1, 2, ...: Okabe and Ito's seven, then lighter rounds.

    Example:
        >>> colours = label_colours([0, 1, 7])
        >>> bool((colours[2] > colours[0]).all())
        True
    """
    labels = np.asarray(labels, np.int64)
    rounds = labels // len(CHARTS) % 3
    return 1 - (1 - np.array(CHARTS)[labels % len(CHARTS)]) * (0.6**rounds)[..., None]


def apart(centres: Any) -> Array:
    """Labels (C,) for `label_colours` such that centres (C, 3) near each other differ.

    Each takes the first colour that none of the six nearest before it has.

    Example:
        >>> apart([[0, 0, 0], [1, 0, 0], [2, 0, 0]]).tolist()
        [0, 1, 2]
    """
    centres = np.asarray(centres, float)
    labels: list[int] = []
    for i, centre in enumerate(centres):
        nearest = np.linalg.norm(centres[:i] - centre, axis=-1).argsort()[: len(CHARTS) - 1]
        taken = {labels[j] for j in nearest}
        labels.append(next(k for k in range(len(CHARTS)) if k not in taken))
    return np.array(labels, np.int64)
