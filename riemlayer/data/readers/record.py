"""`RawShape`, what a file holds, and what is asked of every file's content."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from riemlayer.data.sampling import sample_poisson

MIN_POINTS = 4
LARGEST = 1e100
"""Largest coordinate: squares and products of two such numbers are finite."""


@dataclass(frozen=True)
class RawShape:
    """The content of a file, in its own units and order: a cloud, a mesh, or a mesh with a cloud.

    Colours, normals and texture coordinates belong to `points` where there are any and to
    `vertices` otherwise.
    """

    points: NDArray[np.float64] | None = None
    """(N, 3) of a cloud; None where the file holds a mesh alone."""
    vertices: NDArray[np.float64] | None = None
    """(n, 3) of a mesh, in the order of the file; None of a cloud."""
    faces: NDArray[np.int64] | None = None
    """(m, 3); polygons with more corners come as fans of triangles."""
    normals: NDArray[np.float64] | None = None
    """(N or n, 3) of unit length, 0 where the file has none."""
    colours: NDArray[np.uint8] | None = None
    """(N or n, 3) red, green, blue."""
    uv: NDArray[np.float64] | None = None
    """(n, 2) texture coordinates, where every vertex has one alone."""
    unit: str | None = None
    """Length unit that the file states, as "m"; None where it states none."""
    missing: int = 0
    """Rows of an organised cloud (.pcd) that hold no measurement (NaN) and were left out."""

    @property
    def positions(self) -> NDArray[np.float64]:
        """(N, 3) the points of a cloud, or the (n, 3) vertices of a mesh: what indices mean."""
        positions = self.vertices if self.points is None else self.points
        assert positions is not None  # `checked` lets no empty shape through
        return positions

    def cloud(self, n: int = 10_000, seed: int = 0) -> NDArray[np.float64]:
        """The cloud to encode (N, 3): the file's points, or n blue-noise samples of its mesh.

        Args:
            n: samples of a mesh; the points of a cloud come as they are, all of them.
            seed: of the samples.
        """
        if self.points is not None:
            return self.points
        assert self.vertices is not None and self.faces is not None
        return sample_poisson(self.vertices, self.faces, n, seed)


def checked(shape: RawShape) -> RawShape:
    """The shape, if one can encode it (ours).

    Raises:
        ValueError: it holds nothing, too few points, numbers that are not finite or too large,
            points that are all equal, faces that name no vertex, or faces without any area.
    """
    if shape.points is None and shape.vertices is None:
        raise ValueError("must hold points or a mesh, it holds neither; is it the right file?")
    for name, x in (("points", shape.points), ("vertices", shape.vertices)):
        if x is not None:
            check_positions(name, x)
    if shape.vertices is not None and shape.faces is not None:
        _check_faces(shape.vertices, shape.faces)
    return shape


def check_positions(name: str, x: NDArray) -> None:
    """Raises ValueError unless x is (N, 3) with N >= 4, finite, in range and not all equal."""
    least = MIN_POINTS if name == "points" else 3
    if x.ndim != 2 or x.shape[1] != 3 or len(x) < least:
        raise ValueError(
            f"must hold at least {least} {name} of 3 numbers, got {x.shape}; is it cut short?"
        )
    if not np.isfinite(x).all():
        bad = int((~np.isfinite(x)).any(1).sum())
        raise ValueError(f"must hold finite {name}, {bad} of {len(x)} are not; remove those")
    low, high = (np.array([f(column) for column in x.T]) for f in (np.min, np.max))
    if max(-low.min(), high.max()) > LARGEST:
        raise ValueError(f"must hold {name} up to {LARGEST:.0e}, got larger ones; is it binary?")
    if (high - low).max() <= 1 / LARGEST:
        raise ValueError(f"must hold {name} in different places, all of them are equal")


def _check_faces(vertices: NDArray, faces: NDArray) -> None:
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
        raise ValueError(f"must hold faces of 3 vertices, got {faces.shape}; is it a point cloud?")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"must hold faces that index its {len(vertices)} vertices, got indices from "
            f"{faces.min()} to {faces.max()} (from 0); is it cut short?"
        )
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    size = float(np.ptp(vertices, axis=0).max())
    if not np.linalg.norm(np.cross((b - a) / size, (c - a) / size), axis=1).sum() > 1e-12:
        raise ValueError("must hold faces with an area, all of them are degenerate; remesh it")


def side_by_side(columns: Iterable[NDArray]) -> NDArray[np.float64]:
    """Columns (N,) as (N, k); without a copy between, so that mapped files need no memory."""
    columns = list(columns)
    table = np.empty((len(columns[0]), len(columns)))
    for i, column in enumerate(columns):
        table[:, i] = column
    return table


def unit_normals(x: NDArray) -> NDArray[np.float64]:
    """(N, 3) vectors at unit length; those that have none, or are not finite, become 0."""
    x = np.asarray(x, float)
    with np.errstate(all="ignore"):
        x = x / np.linalg.norm(x, axis=1, keepdims=True)
    return np.where(np.isfinite(x).all(1, keepdims=True), x, 0.0)


def bytes_of_colours(x: NDArray) -> NDArray[np.uint8]:
    """(N, 3 or more) colours as bytes: floating ones up to 1 are scaled, 16 bits are halved."""
    x = np.asarray(x)[:, :3]
    if x.dtype == np.uint8:
        return x
    if x.dtype == np.uint16:
        return (x >> 8).astype(np.uint8)
    x = np.nan_to_num(x.astype(float), posinf=0.0, neginf=0.0)
    scale = 255 if len(x) and x.max() <= 1 else 1
    return np.clip(np.round(x * scale), 0, 255).astype(np.uint8)
