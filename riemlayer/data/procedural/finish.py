"""From parts or sculptures to one valid closed mesh: union, random warps, choice of the component."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from riemlayer.data.procedural.sculpture import Sculpture
from riemlayer.data.procedural.solids import Rng, chance, from_arrays, to_arrays, union

Mesh = tuple[np.ndarray, np.ndarray]
Warp = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Shape:
    """A closed surface: watertight, edge-manifold, outward oriented, one component.

    Attributes:
        vertices: (n, 3) float64.
        faces: (m, 3) int64.
        kind: The procedural category.
        soup: The parts before their union, vertices and faces, whose outer hull is the surface; or None.
    """

    vertices: np.ndarray
    faces: np.ndarray
    kind: str
    soup: Mesh | None


def finish(rng: Rng, model: list[Manifold] | Sculpture, kind: str, soup: bool) -> Shape | None:
    """The shape of a model after random warps, or None where it is not one valid body (ours).

    Args:
        rng: Source of randomness.
        model: Overlapping solids, or a sculpture.
        kind: The category, for the record.
        soup: Keep the parts as well.
    """
    if isinstance(model, Sculpture):
        whole, parts = from_arrays(*model.mesh()), []
    else:
        whole, parts = union(model), model if soup and len(model) > 1 else []
    if whole.is_empty():
        return None
    low, high = np.reshape(whole.bounding_box(), (2, 3))
    warp = random_warp(rng, low, high)
    if warp is not None and not isinstance(model, Sculpture):
        whole, *parts = (refine(solid, 0.07 * (high - low).max()) for solid in [whole, *parts])
    turn = random_turn(rng)

    def place(mesh: Mesh) -> Mesh:
        vertices = (mesh[0] - (low + high) / 2) / ((high - low).max() / 2)
        return (vertices if warp is None else warp(vertices)) @ turn.T, mesh[1]

    body = main_component(*place(to_arrays(whole)))
    if body is None or not is_valid(*body):
        return None
    sheets = concatenate([place(to_arrays(part)) for part in parts]) if parts else None
    return Shape(*body, kind, sheets)


def refine(solid: Manifold, length: float) -> Manifold:
    """The same solid with edges no longer than a length, so that it can bend."""
    return solid.refine_to_length(float(length))


def concatenate(meshes: list[Mesh]) -> Mesh:
    """Several meshes as one soup."""
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    faces = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def random_turn(rng: Rng) -> np.ndarray:
    """A rotation (3, 3): most shapes stay aligned with the axes in some order, some are turned freely."""
    if chance(rng, 0.3):
        q, r = np.linalg.qr(rng.normal(size=(3, 3)))
        turn = q * np.sign(np.diag(r))
    else:
        turn = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    return turn * np.sign(np.linalg.det(turn))


def random_warp(rng: Rng, low: np.ndarray, high: np.ndarray) -> Warp | None:
    """With some probability a smooth deformation of the normalised cube: stretch, taper, twist, bend."""
    half = (high - low) / (high - low).max()
    steps: list[Warp] = []
    if chance(rng, 0.3):
        stretch = np.exp(rng.normal(0, 0.18, 3))
        steps.append(lambda x: x * stretch)
    if chance(rng, 0.08):
        slope, axis = rng.uniform(-0.35, 0.35), int(rng.integers(3))
        steps.append(lambda x: _taper(x, slope, axis))
    if chance(rng, 0.07):
        rate, axis = rng.uniform(-0.9, 0.9), int(rng.integers(3))
        steps.append(lambda x: _twist(x, rate, axis))
    if chance(rng, 0.08):
        axis = int(np.argmax(half)) if chance(rng, 0.7) else int(rng.integers(3))
        curve, across = rng.uniform(-0.8, 0.8), (axis + int(rng.integers(1, 3))) % 3
        steps.append(lambda x: _bend(x, curve, axis, across))
    if chance(rng, 0.08):
        waves = rng.normal(size=(3, 4, 3)) * 1.8
        phases = rng.uniform(0, 2 * np.pi, (3, 4))
        size = rng.uniform(0.01, 0.05)
        steps.append(
            lambda x: x + size * np.sin(np.einsum("akc,nc->nak", waves, x) + phases).sum(2)
        )
    if not steps:
        return None

    def warp(x: np.ndarray) -> np.ndarray:
        for step in steps:
            x = step(x)
        return x

    return warp


def _taper(x: np.ndarray, slope: float, axis: int) -> np.ndarray:
    scale = np.repeat(1 + slope * x[:, axis : axis + 1], 3, 1)
    scale[:, axis] = 1
    return x * scale


def _twist(x: np.ndarray, rate: float, axis: int) -> np.ndarray:
    i, j = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(rate * x[:, axis]), np.sin(rate * x[:, axis])
    y = x.copy()
    y[:, i], y[:, j] = c * x[:, i] - s * x[:, j], s * x[:, i] + c * x[:, j]
    return y


def _bend(x: np.ndarray, curve: float, axis: int, across: int) -> np.ndarray:
    """Roll the axis onto a circle of curvature `curve` in the plane of the axis and `across`."""
    angle = curve * x[:, axis]
    radius = 1 / curve - x[:, across]
    y = x.copy()
    y[:, axis], y[:, across] = radius * np.sin(angle), 1 / curve - radius * np.cos(angle)
    return y


def main_component(vertices: np.ndarray, faces: np.ndarray) -> Mesh | None:
    """The largest outer surface, when it has over 90 % of the area; inner voids are filled."""
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
    if area[best] <= 0.9 * area.sum() or area[best] == 0:
        return None
    faces = faces[owner == best]
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def is_valid(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether a mesh is finite, edge-manifold, consistently oriented, without coincident vertices."""
    if len(faces) < 8 or not np.isfinite(vertices).all():
        return False
    half = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    keys = np.sort(half[:, 0] * len(vertices) + half[:, 1])
    twins = np.sort(half[:, 1] * len(vertices) + half[:, 0])
    distinct = len(np.unique(np.round(vertices, 9), axis=0)) == len(vertices)
    return bool((np.diff(keys) > 0).all() and np.array_equal(keys, twins) and distinct)
