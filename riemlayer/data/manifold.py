"""Connectivity of triangle meshes in numpy: is it manifold, how is it wound, tiny edges away."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]


def drop_unused_vertices(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    """The same mesh without vertices that no face uses (ours)."""
    used, inverse = np.unique(faces, return_inverse=True)
    return vertices[used], inverse.reshape(faces.shape)


def directed_edges(faces: Faces) -> NDArray[np.int64]:
    """(3m, 2) half-edges; row c * m + f is the edge from corner c of face f to the next (ours)."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def manifold_defect(vertices: Vertices, faces: Faces, closed: bool = True) -> str | None:
    """Why this is not one consistently wound manifold component; None where it is (ours).

    Args:
        vertices: (n, 3).
        faces: (m, 3).
        closed: a boundary counts as a defect.
    """
    n, m = len(vertices), len(faces)
    if not np.isfinite(vertices).all():
        return "vertices hold NaN or inf"
    half = directed_edges(faces)
    if (half[:, 0] == half[:, 1]).any():
        return "a face uses a vertex twice"
    key, twin = half[:, 0] * n + half[:, 1], half[:, 1] * n + half[:, 0]
    order = np.argsort(key)
    if (np.diff(key[order]) == 0).any():
        return "an edge is used twice in the same direction (non-manifold or wound against)"
    place = order[np.searchsorted(key[order], twin).clip(max=3 * m - 1)]  # where the twin may be
    paired = key[place] == twin
    if closed and not paired.all():
        return f"{int((~paired).sum())} boundary edges"
    if _components(half[:, 0], half[:, 1], n) != 1:
        return "more than one component, or unused vertices"
    # Corners of one vertex in faces that share an edge belong to one fan: one fan a vertex.
    start = np.arange(3 * m)[paired]  # half-edge = its first corner
    after = (place[paired] + m) % (3 * m)  # the corner that ends the twin = the same vertex
    if _components(start, after, 3 * m) != n:
        return "a vertex joins more than one fan of faces"
    return None


def _components(i: NDArray, j: NDArray, n: int) -> int:
    graph = coo_matrix((np.ones(len(i), dtype=bool), (i, j)), shape=(n, n))
    return int(connected_components(graph, directed=False, return_labels=False))


def crease_edges(
    vertices: Vertices, faces: Faces, angle: float, height: float
) -> NDArray[np.int64]:
    """Edges of a closed mesh that bend by more than `angle` degrees, (e, 2) vertex indices (ours).

    An edge of a triangle that rises less than `height` above it does not count: the normal of
    such a triangle says nothing about the surface.
    """
    n, m = len(vertices), len(faces)
    half = directed_edges(faces)
    key, twin = half[:, 0] * n + half[:, 1], half[:, 1] * n + half[:, 0]
    order = np.argsort(key)
    left = np.arange(3 * m) % m
    right = order[np.searchsorted(key[order], twin).clip(max=3 * m - 1)] % m
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    double_area = np.maximum(np.linalg.norm(normal, axis=1), np.finfo(float).tiny)
    normal /= double_area[:, None]
    length = np.linalg.norm(vertices[half[:, 0]] - vertices[half[:, 1]], axis=1)
    rises = np.minimum(double_area[left], double_area[right]) > height * length
    bends = (normal[left] * normal[right]).sum(1) < np.cos(np.radians(angle))
    return half[(half[:, 0] < half[:, 1]) & bends & rises]


def signed_volume(vertices: Vertices, faces: Faces) -> float:
    """Volume enclosed by a closed mesh, negative where the normals point inward (ours)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def orient(vertices: Vertices, faces: Faces) -> Faces:
    """Winds a mesh consistently, normals outward where it is closed (ours)."""
    if manifold_defect(vertices, faces) is not None:
        import trimesh

        mesh = trimesh.Trimesh(vertices, faces, process=False)
        trimesh.repair.fix_winding(mesh)
        faces = np.array(mesh.faces, dtype=np.int64)
    return faces[:, ::-1].copy() if signed_volume(vertices, faces) < 0 else faces


def vertex_normals(vertices: Vertices, faces: Faces) -> Vertices:
    """Unit vertex normals, face normals weighted by the angle at the corner, (n, 3).

    It is the convention of potpourri3d's `GeodesicTracer`: its tangent plane at a vertex is
    orthogonal to this normal (area weights differ by up to 0.4 at creases).
    """
    corners = vertices[faces]  # (m, 3, 3)
    ahead = np.roll(corners, -1, axis=1) - corners
    behind = np.roll(corners, 1, axis=1) - corners
    normal = np.cross(ahead[:, 0], behind[:, 0])
    double_area = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = normal / np.maximum(double_area, np.finfo(float).tiny)
    angle = np.arctan2(
        np.linalg.norm(np.cross(ahead, behind), axis=-1), (ahead * behind).sum(-1)
    )  # (m, 3)
    total = np.zeros_like(vertices)
    for corner in range(3):
        for axis in range(3):
            weight = angle[:, corner] * normal[:, axis]
            total[:, axis] += np.bincount(faces[:, corner], weight, len(vertices))
    size = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.maximum(size, np.finfo(float).tiny)


def vertex_areas(vertices: Vertices, faces: Faces) -> NDArray[np.float64]:
    """A third of the area of the faces around each vertex, (n,) (ours)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    return np.bincount(faces.ravel(), np.repeat(third, 3), len(vertices)).astype(float)
