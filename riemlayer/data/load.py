"""Reads whatever a newcomer has, a mesh or a cloud in a file, into one cloud in the cube."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from riemlayer.data.meshes import PreparedMesh, normalise, prepare_mesh, sample_surface
from riemlayer.data.readers import RawShape, read_shape


@dataclass(frozen=True)
class LoadedShape:
    """A raw cloud, and the mesh it was sampled from where there is one; both in [-1, 1]^3."""

    points: NDArray[np.float32]
    """(N, 3)"""
    vertices: NDArray[np.float64] | None = None
    """(n, 3) of a manifold mesh, isotropic unless the file held points beside the mesh."""
    faces: NDArray[np.int64] | None = None
    """(m, 3)"""
    centre: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    """(3,) and `scale`: file = centre + scale * cube, in the file's own units."""
    scale: float = 1.0
    unit: str | None = None
    """Length unit that the file states."""


def load_shape(path: str | Path, count: int = 10_000, seed: int = 0) -> LoadedShape:
    """A cloud in the cube from a file; a mesh is prepared for tracing and sampled (ours).

    Args:
        path: a file that `read_shape` reads, a mesh or a cloud. An .npz may hold `points` beside
            `vertices` and `faces`, all in one frame; they are taken as they are.
        count: points to sample from a mesh, uniformly by area.
        seed: of the samples.

    Raises:
        OSError: there is no such file, or it may not be read.
        ValueError: the file holds no shape, or a mesh that cannot be prepared; both name the file.
    """
    raw = read_shape(path)
    try:
        return _loaded(raw, count, seed)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _loaded(raw: RawShape, count: int, seed: int) -> LoadedShape:
    if raw.vertices is None or raw.faces is None:
        points, centre, scale = normalise(raw.positions)
        return LoadedShape(points.astype(np.float32), centre=centre, scale=scale, unit=raw.unit)
    if raw.points is None:
        return sample_mesh(raw.vertices, raw.faces, count, seed, raw.unit)
    vertices, centre, scale = normalise(raw.vertices)
    points = ((raw.points - centre) / scale).astype(np.float32)
    return LoadedShape(points, vertices, raw.faces, centre, scale, raw.unit)


def sample_mesh(
    vertices: NDArray,
    faces: NDArray,
    count: int = 10_000,
    seed: int = 0,
    unit: str | None = None,
) -> LoadedShape:
    """Prepares a mesh (`prepare_mesh`) and samples its raw surface uniformly by area (ours).

    Args:
        vertices, faces: any triangle mesh, (n, 3) and (m, 3), in any unit.
        count: points of the cloud, at most 12,000 where the mesh had to be made watertight.
        seed: of the samples.
        unit: name of the unit, passed on.
    """
    rng = np.random.default_rng(seed)
    mesh: PreparedMesh = prepare_mesh(vertices, faces, rng)
    if mesh.soup is None:
        points = sample_surface(mesh.vertices, mesh.faces, count, rng)
    else:
        points = rng.permutation(mesh.soup)[:count]
    points = points.astype(np.float32)
    return LoadedShape(points, mesh.vertices, mesh.faces, mesh.centre, mesh.scale, unit)
