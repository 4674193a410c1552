"""Reads whatever a newcomer has, a mesh or a cloud in a file, into one cloud in the cube."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from riemlayer.data.meshes import (
    PreparedMesh,
    check_mesh,
    load_mesh,
    normalise,
    prepare_mesh,
    sample_surface,
)

MESHES = (".obj", ".off", ".ply", ".stl", ".glb", ".gltf", ".dae")
CLOUDS = (".xyz", ".txt", ".npz", ".ply")


@dataclass(frozen=True)
class LoadedShape:
    """A raw cloud, and the mesh it was sampled from where there is one; both in [-1, 1]^3."""

    points: NDArray[np.float32]
    """(N, 3)"""
    vertices: NDArray[np.float64] | None = None
    """(n, 3) of a manifold mesh, isotropic unless the file held points beside the mesh."""
    faces: NDArray[np.int64] | None = None
    """(m, 3)"""


def load_shape(path: str | Path, count: int = 10_000, seed: int = 0) -> LoadedShape:
    """A cloud in the cube from a file; a mesh is prepared for tracing and sampled (ours).

    Args:
        path: a mesh (.obj .off .ply .stl .glb .gltf .dae), a cloud (.xyz or .txt: three numbers a
            line, more columns are ignored; .ply without faces), or an .npz with `points`, with
            `vertices` and `faces` (also `V` and `F`), or with all three in one frame.
        count: points to sample from a mesh, uniformly by area.
        seed: of the samples.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file holds no shape; the message says what it held.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"path must name a file, found none at {path}")
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return _from_npz(path, count, seed)
    if suffix in (".xyz", ".txt"):
        return _from_cloud(_read_columns(path), path)
    if suffix not in MESHES:
        known = " ".join(dict.fromkeys(MESHES + CLOUDS))
        raise ValueError(f"path must end in one of {known}, got {path.name}")
    cloud = _read_ply_cloud(path) if suffix == ".ply" else None
    if cloud is not None:
        return _from_cloud(cloud, path)
    return sample_mesh(*load_mesh(path), count, seed)


def sample_mesh(
    vertices: NDArray, faces: NDArray, count: int = 10_000, seed: int = 0
) -> LoadedShape:
    """Prepares a mesh (`prepare_mesh`) and samples its raw surface uniformly by area (ours).

    Args:
        vertices, faces: any triangle mesh, (n, 3) and (m, 3), in any unit.
        count: points of the cloud, at most 12,000 where the mesh had to be made watertight.
        seed: of the samples.
    """
    rng = np.random.default_rng(seed)
    mesh: PreparedMesh = prepare_mesh(vertices, faces, rng)
    if mesh.soup is None:
        points = sample_surface(mesh.vertices, mesh.faces, count, rng)
    else:
        points = rng.permutation(mesh.soup)[:count]
    return LoadedShape(points.astype(np.float32), mesh.vertices, mesh.faces)


def _from_npz(path: Path, count: int, seed: int) -> LoadedShape:
    with np.load(path, allow_pickle=False) as data:
        names = list(data)
        points = data["points"] if "points" in names else None
        mesh = next(
            (
                (data[v], data[f])
                for v, f in (("vertices", "faces"), ("V", "F"))
                if {v, f} <= {*names}
            ),
            None,
        )
    if mesh is None and points is None:
        raise ValueError(f"{path} must hold `points`, or `vertices` and `faces`, got {names}")
    if mesh is None:
        assert points is not None  # the line above
        return _from_cloud(points, path)
    vertices, faces = np.asarray(mesh[0], float), np.asarray(mesh[1], np.int64)
    if points is None:
        return sample_mesh(vertices, faces, count, seed)
    check_mesh(vertices, faces)
    _check_cloud(points, path)
    vertices, centre, scale = normalise(vertices)
    return LoadedShape(((points - centre) / scale).astype(np.float32), vertices, faces)


def _from_cloud(points: NDArray, path: Path) -> LoadedShape:
    _check_cloud(points, path)
    return LoadedShape(normalise(np.asarray(points, float))[0].astype(np.float32))


def _check_cloud(points: NDArray, path: Path) -> None:
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
        raise ValueError(f"{path} must hold at least 4 points of 3 numbers, got {points.shape}")
    bad = int((~np.isfinite(points)).any(1).sum())
    if bad:
        raise ValueError(f"{path} must hold finite points, {bad} of {len(points)} are not")


def _read_columns(path: Path) -> NDArray:
    text = path.read_text("utf-8", errors="replace").replace(",", " ")
    lines = [line for line in text.splitlines() if line.split("#")[0].strip()]
    try:
        return np.loadtxt(lines, ndmin=2)[:, :3] if lines else np.zeros((0, 3))
    except ValueError as error:
        raise ValueError(f"{path} must hold three numbers a line: {error}") from error


def _read_ply_cloud(path: Path) -> NDArray | None:
    """The points of a .ply without faces; None for a mesh, or what only `load_mesh` can judge."""
    import trimesh

    try:
        content = trimesh.load(path, process=False)
    except Exception:  # trimesh's readers raise whatever their parsers raise; load_mesh words it
        return None
    return np.asarray(content.vertices) if isinstance(content, trimesh.PointCloud) else None
