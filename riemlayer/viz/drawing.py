"""What is drawn: a shape, a log map on it, geodesics, and where one looks from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from riemlayer.viz.cloud import neighbourhoods, pca_normals, slopes

Array = np.ndarray

BLUE, CREAM = (0.0, 0.447, 0.698), (0.965, 0.945, 0.875)
"""The two tiles: apart in lightness, so that no kind of colour blindness merges them."""
PLAIN = (0.80, 0.80, 0.82)
"""Surface out of reach of the map."""
ORANGE, BLACK = (0.835, 0.369, 0.0), (0.1, 0.1, 0.1)
"""Geodesics: the answer, and the reference beside it."""
DOT = (0.35, 0.35, 0.4)


@dataclass(frozen=True, eq=False)
class Drawing:
    """One shape with what was calculated on it; tensors and arrays are both welcome.

    Args:
        points: (N, 3) vertices of a mesh, or a cloud (drawn as small discs).
        faces: (M, 3) triangles, or None for a cloud.
        log: (N, 2) tangent coordinates of every point (`tangent_coordinates`), drawn as tiles.
        p: (3,) source, drawn as a ball.
        dots: (D, 3) points to mark, such as the cloud that stands for the mesh.
        paths: (K, T, 3) polylines such as geodesics from `p`.
        reference: polylines to hold `paths` against, drawn thinner and in black.
        title: a few words above the picture.
        radius: the checkerboard ends at |log| = radius.
        period: side of a tile, in the unit of `log`.
        colours: (N, 3) in [0, 1], a colour for every point instead of tiles; pictures only.
    """

    points: Any
    faces: Any = None
    log: Any = None
    p: Any = None
    dots: Any = None
    paths: Sequence[Any] = ()
    reference: Sequence[Any] = ()
    title: str = ""
    radius: float = 0.5
    period: float = 0.1
    colours: Any = None
    normals: Array = field(init=False)
    """(N, 3) unit normals for shading; their sign has no meaning on a cloud."""
    spacing: float = field(init=False)
    """Typical distance of neighbouring points."""
    slope: Array | None = field(init=False, default=None)
    """(N, 2, 3) derivative of `log` along the surface, for the discs of a cloud."""

    def __post_init__(self) -> None:
        points = to_numpy(self.points, float)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
            raise ValueError(f"`points` must have shape (N, 3) with N >= 4, got {points.shape}")
        if self.log is not None and np.shape(self.log) != (len(points), 2):
            raise ValueError(
                f"`log` must have shape ({len(points)}, 2), got {np.shape(self.log)}; "
                "flatten vectors with tangent_coordinates(log, normal)"
            )
        if self.colours is not None and np.shape(self.colours) != points.shape:
            raise ValueError(
                f"`colours` must have shape {points.shape}, got {np.shape(self.colours)}"
            )
        put: dict[str, Any] = {"points": points}
        kinds = {"faces": np.int64, "log": float, "p": float, "dots": float, "colours": float}
        for name, dtype in kinds.items():
            value = getattr(self, name)
            put[name] = None if value is None else to_numpy(value, dtype)
        for name in ("paths", "reference"):
            put[name] = tuple(to_numpy(path, float) for path in getattr(self, name))
        if put["faces"] is None:
            neighbours, put["spacing"] = neighbourhoods(points)
            put["normals"] = pca_normals(points, neighbours)
            if put["log"] is not None:
                put["slope"] = slopes(points, put["log"], neighbours)
        else:
            put["normals"], put["spacing"] = _mesh_normals(points, put["faces"])
        for name, value in put.items():
            object.__setattr__(self, name, value)


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


def viewpoint(points: Any, normal: Any, tilt: float = 0.6) -> View:
    """The camera that sees a source well: from above its tangent plane, a little from the side.

    Args:
        points: (N, 3) the whole shape.
        normal: (3,) normal at the source, pointing outward.
        tilt: how far the eye leans from the normal, as a tangent.
    """
    points, normal = to_numpy(points, float), _unit(to_numpy(normal, float))
    vertical = np.array([0.0, 1.0, 0.0]) if abs(normal[1]) < 0.9 else np.array([0.0, 0.0, -1.0])
    right = _unit(np.cross(vertical, normal))
    direction = _unit(normal + tilt * (_unit(np.cross(normal, right)) + 0.7 * right))
    right = _unit(np.cross(vertical, direction))
    axes = np.stack([right, np.cross(direction, right), direction])
    seen = points @ axes.T
    centre = (seen.min(0) + seen.max(0)) / 2 @ axes
    extent = np.linalg.norm(points - centre, axis=1).max()
    return View(
        centre, float(extent), direction, axes[1], float(np.ptp(seen[:, :2], axis=0).max() / 2)
    )


def tangent_frame(normal: Any) -> Array:
    """Two orthonormal axes (2, 3) of the plane with this normal (3,); they depend on it alone."""
    normal = _unit(to_numpy(normal, float))
    axis = np.eye(3)[np.abs(normal).argmin()]
    first = _unit(axis - (axis @ normal) * normal)
    return np.stack([first, np.cross(normal, first)])


def tangent_coordinates(log: Any, normal: Any) -> Array:
    """Appendix A: ambient tangent vectors (N, 3) in the frame of the plane with this normal (3,).

    All methods get the same frame, so their maps can be laid side by side.

    Example:
        >>> tangent_coordinates([[3.0, 4.0, 0.0]], [0.0, 0.0, 1.0]).round(6)
        array([[3., 4.]])
    """
    return to_numpy(log, float) @ tangent_frame(normal).T


def checkerboard(log: Any, period: float = 0.1, radius: float = 0.5) -> Array:
    """Colours (N, 3) in [0, 1] of tangent coordinates (N, 2): tiles up to `radius`.

    Example:
        >>> colours = checkerboard([[0.05, 0.05], [0.05, 0.15], [9.0, 0.0]])
        >>> colours.round(1).tolist()
        [[0.0, 0.4, 0.7], [1.0, 0.9, 0.9], [0.8, 0.8, 0.8]]
    """
    log = to_numpy(log, float)
    odd = np.floor(log / period).sum(-1) % 2 == 1
    colours = np.where(odd[:, None], CREAM, BLUE)
    return np.where((np.linalg.norm(log, axis=-1) <= radius)[:, None], colours, PLAIN)


def to_numpy(x: Any, dtype: Any) -> Array:
    """A numpy array of a tensor (of any device, with or without a graph), an array or a list."""
    x = x.detach().cpu() if hasattr(x, "detach") else x
    return np.asarray(x, dtype=dtype)


def _unit(x: Array) -> Array:
    return x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-12)


def _mesh_normals(points: Array, faces: Array) -> tuple[Array, float]:
    """Area-weighted vertex normals and the mean edge length."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    face_normals = np.cross(b - a, c - a)
    normals = np.zeros_like(points)
    for i in range(3):
        np.add.at(normals, faces[:, i], face_normals)
    return _unit(normals), float(np.linalg.norm(b - a, axis=-1).mean())
