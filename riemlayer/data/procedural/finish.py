"""From parts or a sculpture to one valid closed mesh, with the raw parts beside it where asked."""

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from riemlayer.data.procedural.sculpture import Sculpture
from riemlayer.data.procedural.solids import Rng, chance, from_arrays, pick, to_arrays, union
from riemlayer.data.procedural.warps import placement

Mesh = tuple[np.ndarray, np.ndarray]
EDGE = 0.05
"""Longest edge of a finished mesh before its warp; the longest half side of the shape is 1."""


@dataclass(frozen=True)
class Shape:
    """A closed surface: watertight, edge-manifold, outward oriented, one component."""

    vertices: np.ndarray
    """(n, 3) float64."""
    faces: np.ndarray
    """(m, 3) int64."""
    kind: str
    soup: Mesh | None
    """Vertices and faces of the overlapping parts whose outer hull is the surface, or None."""


def finish(rng: Rng, model: list[Manifold] | Sculpture, kind: str, soup: bool) -> Shape | None:
    """The shape of a model after random warps, or None where it is not one valid body (ours).

    Args:
        rng: source of randomness.
        model: overlapping solids, or a sculpture.
        kind: the category, for the record.
        soup: keep the parts; sometimes the body is then the shell around opened parts.
    """
    if isinstance(model, Sculpture):
        whole, parts = from_arrays(*model.mesh()), []
    else:
        whole, parts = union(model), model
    if whole.is_empty():
        return None
    low, high = np.reshape(whole.bounding_box(), (2, 3))
    half, place = (high - low).max() / 2, placement(rng, low, high)
    raw, shelled = None, soup and chance(rng, 0.3)
    if parts or chance(rng, 0.25):
        coarse = 1e-3 if parts else rng.uniform(3e-3, 1e-2)  # some organic shapes are low-poly
        whole = whole.simplify(coarse * half).refine_to_length(EDGE * half)
    if parts and soup and (len(parts) > 1 or shelled):
        meshes = [to_arrays(part.refine_to_length(3 * EDGE * half)) for part in parts]
        vertices, faces = concatenate([opened(rng, m) for m in meshes] if shelled else meshes)
        raw = place(vertices), faces
    vertices, faces = to_arrays(whole)
    if raw and shelled:
        body = shell(*raw, size=pick(rng, 80, 96, 128))
    else:
        body = outer_body(place(vertices), faces)
    if body is None or not is_valid(*body):
        return None
    return Shape(*body, kind, raw)


def concatenate(meshes: list[Mesh]) -> Mesh:
    """Several meshes as one soup."""
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    faces = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def opened(rng: Rng, mesh: Mesh) -> Mesh:
    """Half of the time the mesh without the faces that look along one axis (ours)."""
    vertices, faces = mesh
    axis, side = int(rng.integers(3)), rng.choice([-1.0, 1.0])
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    away = side * normal[:, axis] > 0.9 * area
    if chance(rng, 0.5) or area[away].sum() > 0.4 * area.sum():
        return mesh
    return vertices, faces[~away]


def shell(vertices: np.ndarray, faces: np.ndarray, size: int) -> Mesh | None:
    """The surface two cells of a grid around open sheets, as raw meshes are made watertight."""
    from riemlayer.data.watertight import make_watertight

    try:
        around = make_watertight(vertices, faces, size, 2 / size)
    except ValueError:
        return None
    body = to_arrays(from_arrays(*around).simplify(3e-4).refine_to_length(EDGE))
    return body if len(body[0]) else None


def outer_body(vertices: np.ndarray, faces: np.ndarray) -> Mesh | None:
    """The one outer surface, with inner voids filled; crumbs below 1 % of the area fall off.

    None where more than that falls off.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    n = len(vertices)
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    count, label = connected_components(graph, directed=False)
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    owner = label[faces[:, 0]]
    volume = np.bincount(owner, (a * normal).sum(1), count)
    area = np.bincount(owner, np.linalg.norm(normal, axis=1), count)
    area = np.where(volume > 0, area, 0)
    best = int(np.argmax(area))
    if area[best] <= 0.99 * area.sum() or area[best] == 0:
        return None
    used, faces = np.unique(faces[owner == best], return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def is_valid(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Is the mesh finite, edge-manifold, consistently wound, free of coincident vertices?"""
    if len(faces) < 8 or not np.isfinite(vertices).all():
        return False
    half = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    keys = np.sort(half[:, 0] * len(vertices) + half[:, 1])
    twins = np.sort(half[:, 1] * len(vertices) + half[:, 0])
    distinct = len(np.unique(np.round(vertices, 9), axis=0)) == len(vertices)
    return bool((np.diff(keys) > 0).all() and np.array_equal(keys, twins) and distinct)
