"""`Canvas`: a shape made ready to be drawn, once for any number of drawings."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from riemlayer.viz.cloud import Discs, fit_discs, slopes
from riemlayer.viz.mesh import crease, subdivide
from riemlayer.viz.view import to_numpy, unit

Array = np.ndarray

STEEPEST = 3.0
"""A log map that changes faster than this along the surface is torn there (cut locus)."""


class Canvas:
    """A mesh with normals that respect its sharp edges, or a cloud as small discs.

    Args:
        points: (N, 3) vertices of a mesh, or a cloud.
        faces: (M, 3) triangles, or None for a cloud.
        normals: (N, 3) of a cloud, where they are known; of either sign.
        longest: edges of a mesh are halved down to this length, so that `points` is enough of the
            surface to sample a map on; None leaves the mesh as it is.

    Raises:
        ValueError: a shape is wrong, or a face names a vertex that is not there.

    Example:
        >>> canvas = Canvas([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
        >>> canvas.normals.tolist()[0], canvas.corner.tolist()
        ([0.0, 0.0, 1.0], [0, 1, 2, 3])
    """

    points: Array
    """(N, 3)"""
    faces: Array | None
    """(M, 3) triangles of `points`."""
    corner: Array
    """(n,) the point that each drawn vertex shows: a sharp edge shows its points twice."""
    normals: Array
    """(n, 3) unit, of the drawn vertices; their sign has no meaning on a cloud."""
    triangles: Array | None
    """(M, 3) triangles of the drawn vertices."""
    discs: Discs | None
    """Of a cloud."""
    spacing: float
    """Typical distance of neighbouring points."""

    def __init__(
        self, points: Any, faces: Any = None, normals: Any = None, longest: float | None = None
    ) -> None:
        points = to_numpy(points, float)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
            raise ValueError(f"`points` must have shape (N, 3) with N >= 4, got {points.shape}")
        if not np.isfinite(points).all():
            bad = int((~np.isfinite(points)).any(1).sum())
            raise ValueError(f"`points` must be finite, {bad} of {len(points)} are not")
        if faces is None:
            self._cloud(points, normals)
        else:
            self._mesh(points, to_numpy(faces, np.int64), longest)

    def _cloud(self, points: Array, normals: Any) -> None:
        if normals is not None and np.shape(normals) != points.shape:
            raise ValueError(f"`normals` must have shape {points.shape}, got {np.shape(normals)}")
        given = None if normals is None else unit(to_numpy(normals, float))
        self.points, self.faces, self.triangles = points, None, None
        self.discs = fit_discs(points, given)
        self.corner, self.normals = np.arange(len(points)), self.discs.normals
        self.spacing = self.discs.spacing

    def _mesh(self, points: Array, faces: Array, longest: float | None) -> None:
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
            raise ValueError(f"`faces` must have shape (M, 3) with M >= 1, got {faces.shape}")
        if faces.min() < 0 or faces.max() >= len(points):
            raise ValueError(
                f"`faces` must index the {len(points)} points, got {faces.min()} to {faces.max()}"
            )
        if longest is not None:
            points, faces = subdivide(points, faces, longest)
        self.points, self.faces, self.discs = points, faces, None
        self.corner, self.normals, self.triangles = crease(points, faces)
        edges = points[faces[:, 1]] - points[faces[:, 0]]
        self.spacing = float(np.linalg.norm(edges, axis=-1).mean())

    def slope(self, x: Array, drawn: Array | None = None) -> Array | None:
        """(N, m, 3) derivative of x (N, m) along a cloud, for its discs; None for a mesh.

        Args:
            x: (N, m) numbers for every point.
            drawn: (N,) bool: only these points count.
        """
        if self.discs is None:
            return None
        neighbours = self.discs.neighbours
        if drawn is not None:
            neighbours = np.where(drawn[neighbours], neighbours, np.arange(len(x))[:, None])
        return slopes(self.points, x, neighbours)

    def log_slope(self, log: Array, drawn: Array | None = None) -> Array | None:
        """(N, 2, 3) derivative of a log map (N, 2) along a cloud, 0 where it is torn."""
        slope = self.slope(log, drawn)
        if slope is None:
            return None
        return slope * (np.linalg.norm(slope, axis=(1, 2)) < STEEPEST)[:, None, None]

    @cached_property
    def size(self) -> float:
        """Longest side of the bounding box."""
        return float(np.ptp(self.points, axis=0).max())

    def normal_at(self, p: Any) -> Array:
        """Unit normal (3,) of the drawn vertex nearest to p (3,)."""
        distance = np.linalg.norm(self.points[self.corner] - to_numpy(p, float), axis=1)
        return self.normals[distance.argmin()]
