"""Where one looks from, and the tangent plane one looks at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray

CONE = 0.87
"""What hides a source is looked for in this cone about the normal: cosine of its half angle."""


@dataclass(frozen=True, eq=False)
class View:
    """One camera for all pictures of a shape.

    Args:
        centre: (3,) middle of what is seen.
        extent: radius of the ball about the centre that holds the shape.
        direction: (3,) unit vector from the centre to the eye.
        up: (3,) unit vector, orthogonal to `direction`.
    """

    centre: Array
    extent: float
    direction: Array
    up: Array
    fit: float
    """Half the side of the square that holds the shape as seen from here."""

    @property
    def axes(self) -> Array:
        """(3, 3) rows: right, up, and from the centre to the eye."""
        return np.stack([np.cross(self.up, self.direction), self.up, self.direction])


def viewpoint(points: Any, normal: Any, tilt: float = 0.6, up: Any = (0.0, 1.0, 0.0)) -> View:
    """The camera that sees a source well: from above its tangent plane, a little from the side.

    Args:
        points: (N, 3) the whole shape.
        normal: (3,) normal at the source, pointing outward, see `outward`.
        tilt: how far the eye leans from the normal, as a tangent.
        up: (3,) what is up in the picture; for a source that is seen from there, what is behind it.

    Example:
        >>> view = viewpoint([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2]], [0, 0, 1], tilt=0)
        >>> view.direction.tolist(), view.fit
        ([0.0, 0.0, 1.0], 1.0)
    """
    points, normal, upward = to_numpy(points, float), to_numpy(normal, float), to_numpy(up, float)
    normal, upward = unit(normal), unit(upward)
    steep = abs(normal @ upward) >= 0.9
    vertical = -np.roll(upward, 1) if steep else upward
    right = unit(np.cross(vertical, normal))
    direction = unit(normal + tilt * (unit(np.cross(normal, right)) + 0.7 * right))
    right = unit(np.cross(vertical, direction))
    axes = np.stack([right, np.cross(direction, right), direction])
    seen = points @ axes.T
    centre = (seen.min(0) + seen.max(0)) / 2 @ axes
    extent = np.linalg.norm(points - centre, axis=1).max()
    return View(
        centre, float(extent), direction, axes[1], float(np.ptp(seen[:, :2], axis=0).max() / 2)
    )


def outward(points: Any, p: Any, normal: Any) -> Array:
    """The normal (3,) at p or its opposite: the one above which less of the shape hides p (ours).

    A cloud does not know its outside; what lies in a cone about the normal decides.

    Args:
        points: (N, 3) the whole shape.
        p: (3,) a point of it.
        normal: (3,) at p, of either sign.

    Example:
        >>> outward([[0, 0, -1], [0.1, 0, -1], [0, 0.1, -2]], [0, 0, 0], [0, 0, -1]) @ [0, 0, 1]
        np.float64(1.0)
    """
    points, normal = to_numpy(points, float), unit(to_numpy(normal, float))
    away = points - to_numpy(p, float)
    height, reach = away @ normal, np.linalg.norm(away, axis=1)
    above, below = (height > CONE * reach).sum(), (-height > CONE * reach).sum()
    if above == below:
        above, below = (height > 0).sum(), (height < 0).sum()
    return normal if above <= below else -normal


def tangent_frame(normal: Any) -> Array:
    """Two orthonormal axes (..., 2, 3) of the plane with this normal (..., 3).

    They depend on the normal alone.
    """
    normal = unit(to_numpy(normal, float))
    axis = np.eye(3)[np.abs(normal).argmin(-1)]
    first = unit(axis - (axis * normal).sum(-1, keepdims=True) * normal)
    return np.stack([first, np.cross(normal, first)], -2)


def tangent_coordinates(log: Any, normal: Any) -> Array:
    """Appendix A: ambient tangent vectors (N, 3) in the frame of the plane with this normal (3,).

    All methods get the same frame, so their maps can be laid side by side.

    Example:
        >>> tangent_coordinates([[3.0, 4.0, 0.0]], [0.0, 0.0, 1.0]).round(6)
        array([[3., 4.]])
    """
    return to_numpy(log, float) @ tangent_frame(normal).T


def to_numpy(x: Any, dtype: Any) -> Array:
    """A numpy array of a tensor (of any device, with or without a graph), an array or a list."""
    x = x.detach().cpu() if hasattr(x, "detach") else x
    return np.asarray(x, dtype=dtype)


def unit(x: Array) -> Array:
    """Vectors (..., 3) at length 1."""
    return x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-12)
