"""Takes degenerate triangles out of a closed mesh: short edges collapse, flat caps are flipped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from riemlayer.data.manifold import directed_edges, drop_unused_vertices

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]

_TINY = np.finfo(float).tiny


class _Stars:
    """The faces around each vertex, as they are when a pass begins."""

    def __init__(self, faces: Faces) -> None:
        self.faces = faces
        order = np.argsort(faces, axis=None, kind="stable")
        self.start = np.concatenate([[0], np.cumsum(np.bincount(faces.ravel()))])
        self.owner = order // 3

    def around(self, vertex: int) -> NDArray[np.int64]:
        return self.owner[self.start[vertex] : self.start[vertex + 1]]

    def ring(self, vertex: int) -> set[int]:
        return set(self.faces[self.around(vertex)].ravel().tolist()) - {int(vertex)}


def remove_slivers(
    vertices: Vertices, faces: Faces, length: float, rounds: int = 12
) -> tuple[Vertices, Faces]:
    """Removes needles (an edge < length) and caps (height < length / 4), staying manifold (ours).

    Remeshing leaves some dozens where creases nearly touch; straightest geodesics go astray in
    them. The surface changes by less than `length`: no vertex moves but the ends of edges of no
    length which cannot collapse.

    Args:
        vertices: (n, 3).
        faces: (m, 3), edge-manifold.
        length: shortest edge to keep.
        rounds: at most so many; neighbours of what changed wait for the next round.
    """
    for _ in range(rounds):
        before = faces
        faces = _collapse_needles(vertices, faces, length)
        faces = _flip_caps(vertices, faces, length / 4)
        if faces is before:
            break
    return drop_unused_vertices(_part_twins(vertices, faces, length), faces)


def heights(vertices: Vertices, faces: Faces) -> NDArray[np.float64]:
    """Smallest height of each triangle, (m,): twice its area over its longest edge (ours)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    longest = np.max([np.linalg.norm(x, axis=1) for x in (b - a, c - b, a - c)], axis=0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(longest, _TINY)


def _collapse_needles(vertices: Vertices, faces: Faces, length: float) -> Faces:
    """Merges the ends of short edges that share exactly two neighbours (the link condition)."""
    half = directed_edges(faces)
    half = half[half[:, 0] < half[:, 1]]
    size = np.linalg.norm(vertices[half[:, 0]] - vertices[half[:, 1]], axis=1)
    target = np.arange(len(vertices))
    stars, touched = _Stars(faces), set()
    for edge in np.flatnonzero(size < length)[np.argsort(size[size < length], kind="stable")]:
        a, b = half[edge]
        ring_a, ring_b = stars.ring(a), stars.ring(b)
        if len(ring_a & ring_b) == 2 and touched.isdisjoint(ring_a | ring_b):
            target[b] = a
            touched |= ring_a | ring_b
    if not touched:
        return faces
    faces = target[faces]
    a, b, c = faces.T
    return faces[(a != b) & (b != c) & (c != a)]


def _part_twins(vertices: Vertices, faces: Faces, length: float) -> Vertices:
    """Moves one end of each edge of no length towards the middle of its neighbours.

    Such edges are left where a collapse would pinch the surface; solvers meet NaN in their faces.
    """
    half = directed_edges(faces)
    half = half[half[:, 0] < half[:, 1]]
    size = np.linalg.norm(vertices[half[:, 0]] - vertices[half[:, 1]], axis=1)
    twins = half[size < 1e-3 * length]
    if not len(twins):
        return vertices
    vertices, stars = vertices.copy(), _Stars(faces)
    for _, b in twins:
        away = vertices[sorted(stars.ring(b))].mean(0) - vertices[b]
        vertices[b] += away * min(1.0, length / max(np.linalg.norm(away), _TINY))
    return vertices


def _flip_caps(vertices: Vertices, faces: Faces, height: float) -> Faces:
    """Flips the longest edge of flat triangles where the new edge does not exist yet."""
    flat = np.flatnonzero(heights(vertices, faces) < height)
    stars, touched = _Stars(faces), set()
    new = faces.copy()
    for f in flat:
        corners = vertices[faces[f]]
        first = int(np.argmax(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)))
        a, b, c = np.roll(faces[f], -first)
        other = np.setdiff1d(np.intersect1d(stars.around(a), stars.around(b)), [f])
        if len(other) != 1:
            continue
        (d,) = set(faces[other[0]].tolist()) - {int(a), int(b)}
        if d in stars.ring(c) or not touched.isdisjoint((a, b, c, d)):
            continue
        new[f], new[other[0]] = (c, a, d), (c, d, b)
        touched |= {int(a), int(b), int(c), int(d)}
    return new if touched else faces
