"""Mesh preparation: read, check, make watertight, remesh isotropically, scale to the cube.

The steps follow the paper's data preparation: one watertight manifold component, otherwise the
2/128 level set of the unsigned distance on a 128 grid; then isotropic explicit remeshing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from riemlayer.data.manifold import (
    crease_edges,
    drop_unused_vertices,
    manifold_defect,
    orient,
)
from riemlayer.data.sampling import sample_surface as sample_surface
from riemlayer.data.slivers import heights, remove_slivers

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]

SOUP_SIZE = 12_000


@dataclass(frozen=True)
class PreparedMesh:
    """A mesh ready for tracing, in the cube [-1, 1]^3."""

    vertices: Vertices
    """(n, 3), 8k to 12k isotropic vertices."""
    faces: Faces
    """(m, 3), watertight, manifold, one component, normals outward."""
    soup: Vertices | None
    """(12000, 3) samples of the raw surface, only where it was not watertight."""
    centre: Vertices
    """(3,) and `scale`: cube = (raw - centre) / scale."""
    scale: float


def load_mesh(path: str | Path) -> tuple[Vertices, Faces]:
    """Reads any mesh file that trimesh reads; the parts of a scene are concatenated (ours).

    Args:
        path: a mesh file (.obj .off .ply .stl .glb .dae ...).

    Returns:
        vertices (n, 3) float64 and faces (m, 3) int64, in the file's own units.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file cannot be read, or `check_mesh` refuses its content.
    """
    import trimesh

    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"path must name a mesh file, found no file {path}")
    try:
        scene = trimesh.load_scene(path, process=False, skip_materials=True)
        mesh = scene.to_mesh() if len(scene.geometry) else None
    except Exception as error:  # trimesh's readers raise whatever their parsers raise
        raise ValueError(f"path must name a readable mesh file, {path} gave: {error}") from error
    if mesh is None or not hasattr(mesh, "faces") or len(mesh.faces) == 0:
        raise ValueError(f"path must name a mesh with faces, {path} has none (a point cloud?)")
    vertices, faces = np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64)
    check_mesh(vertices, faces)
    return vertices, faces


def check_mesh(vertices: Vertices, faces: Faces) -> None:
    """Raises ValueError unless vertices and faces describe a triangle mesh (ours).

    Example:
        >>> check_mesh(np.eye(3), np.array([[0, 1, 5]]))
        Traceback (most recent call last):
        ...
        ValueError: faces must index the 3 vertices (0 to 2), got indices from 0 to 5
    """
    vertices, faces = np.asarray(vertices), np.asarray(faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ValueError(f"vertices must have shape (n, 3), got {vertices.shape}")
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
        raise ValueError(f"faces must have shape (m, 3) with m > 0, got {faces.shape}")
    if not np.issubdtype(faces.dtype, np.integer):
        raise ValueError(f"faces must hold integers, got {faces.dtype}")
    bad = int((~np.isfinite(vertices).all(1)).sum())
    if bad:
        raise ValueError(f"vertices must be finite, {bad} of {len(vertices)} hold NaN or inf")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"faces must index the {len(vertices)} vertices (0 to {len(vertices) - 1}), "
            f"got indices from {faces.min()} to {faces.max()}"
        )


def is_watertight_manifold(vertices: Vertices, faces: Faces) -> bool:
    """Is this one watertight component, edge- and vertex-manifold, consistently wound? (ours)"""
    return manifold_defect(vertices, faces) is None


def merge_by_position(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    """Merges coinciding vertices and drops duplicate and degenerate faces (ours).

    Two vertices coincide when they round to the same multiple of 1e-7 of the bounding box.
    """
    size = np.ptp(vertices, axis=0).max()
    if size == 0:
        raise ValueError("vertices must span a volume, all of them are equal")
    keys = np.round((vertices - vertices.min(0)) / (1e-7 * size)).astype(np.int64)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, unique = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    if len(unique) == 0:
        raise ValueError("faces must have an area, all of them are degenerate")
    return drop_unused_vertices(vertices[first], faces[np.sort(unique)])


def normalise(vertices: Vertices) -> tuple[Vertices, Vertices, float]:
    """Centres the bounding box and scales its longest side to [-1, 1] (ours).

    Returns:
        (vertices - centre) / scale, the centre (3,), and the scale.

    Example:
        >>> cube, centre, scale = normalise(np.array([[0.0, 0, 0], [4, 2, 0]]))
        >>> cube[1], centre, scale
        (array([1. , 0.5, 0. ]), array([2., 1., 0.]), 2.0)
    """
    low, high = vertices.min(0), vertices.max(0)
    centre, scale = (low + high) / 2, float((high - low).max() / 2)
    if not scale > 0:
        raise ValueError("vertices must span a volume, all of them are equal")
    return (vertices - centre) / scale, centre, scale


def remesh(
    vertices: Vertices, faces: Faces, count: int = 10_000, feature_angle: float = 30.0
) -> tuple[Vertices, Faces]:
    """Isotropic explicit remeshing (Botsch and Kobbelt) to about `count` vertices.

    Creases sharper than `feature_angle` degrees stay where they are: without them a cube of 10k
    vertices would lose 4 % of its area. The edge length is that of `count` equilateral vertices
    on the same area; a first result more than 20 % off is
    repeated with a corrected length, and the nearer of the two is returned.

    Triangles that are nearly flat (heights below a few percent of an edge) are taken out before
    and after (`remove_slivers`).

    Raises:
        ValueError: the input is not edge-manifold.
    """
    from gpytoolbox import remesh_botsch

    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    edge = float(np.sqrt(2 / np.sqrt(3) * area / count))
    iterations = 10 if len(vertices) < count / 2 else 6
    own = float(np.median(np.linalg.norm(b - a, axis=1)))  # a dense input is no heap of slivers
    results = []
    for _ in range(2):
        clean, clean_faces = remove_slivers(vertices, faces, 0.2 * min(edge, own), rounds=3)
        creases = crease_edges(clean, clean_faces, feature_angle, 0.1 * edge)
        u, g = remesh_botsch(
            clean, clean_faces.astype(np.int32), iterations, edge, feature_edges=creases
        )
        miss = abs(np.log(len(u) / count))
        results.append((miss, *remove_slivers(u, g.astype(np.int64), 0.15 * edge)))
        if miss < 0.2:
            break
        edge *= float(np.sqrt(len(u) / count))
    return min(results, key=lambda result: result[0])[1:]


def prepare_mesh(
    vertices: Vertices,
    faces: Faces,
    rng: np.random.Generator | None = None,
    count: int = 10_000,
) -> PreparedMesh:
    """Raw mesh to one watertight, manifold, isotropic component in the cube (paper, 4.1).

    A mesh that is not one watertight manifold component is replaced by the shell around it
    (`make_watertight`), and 12,000 samples of the raw surface inside that shell are kept.

    Args:
        vertices, faces: any triangle mesh, in any unit.
        rng: draws the samples of the raw surface; default seed 0.
        count: vertices to aim at; 0.7 to 1.4 times as many are accepted.

    Raises:
        ValueError: with the reason, where no such component comes out.
    """
    from riemlayer.data.watertight import make_watertight, samples_inside

    check_mesh(vertices, faces)
    rng = rng or np.random.default_rng(0)
    raw_vertices, raw_faces = merge_by_position(np.asarray(vertices, float), faces)
    raw_faces = orient(raw_vertices, raw_faces)
    soup, feature_angle = None, 30.0
    closed_vertices, closed_faces = raw_vertices, raw_faces
    if not is_watertight_manifold(raw_vertices, raw_faces):
        closed_vertices, closed_faces = make_watertight(raw_vertices, raw_faces)
        feature_angle = 45.0  # a level set has no true crease below, only grid steps
    new_vertices, new_faces = remesh(closed_vertices, closed_faces, count, feature_angle)
    defect = manifold_defect(new_vertices, new_faces) or _flaw(new_vertices, new_faces, count)
    if defect is not None:
        raise ValueError(f"vertices, faces cannot be remeshed to a manifold: {defect}")
    new_vertices, centre, scale = normalise(new_vertices)
    if closed_faces is not raw_faces:
        inside = samples_inside(
            raw_vertices, raw_faces, closed_vertices, closed_faces, SOUP_SIZE, rng
        )
        soup = (inside - centre) / scale
    return PreparedMesh(new_vertices, new_faces, soup, centre, scale)


def _flaw(vertices: Vertices, faces: Faces, count: int) -> str | None:
    """Why geodesics cannot be traced well on a manifold mesh; None where they can."""
    if not 0.7 * count <= len(vertices) <= 1.4 * count:
        return f"{len(vertices)} vertices where about {count} were asked for"
    edge = np.median(np.linalg.norm(vertices[faces[:, 1]] - vertices[faces[:, 0]], axis=1))
    flat = int((heights(vertices, faces) < 0.04 * edge).sum())
    few = len(faces) // 200
    return f"{flat} degenerate faces (parts thinner than an edge?)" if flat > few else None
