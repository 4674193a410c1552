"""Laws of the procedural shapes: same seed same shape, closed, oriented, one body."""

import numpy as np
import pytest

pytest.importorskip("manifold3d")
pytest.importorskip("skimage")

from riemlayer.data.procedural import KINDS, random_shape


def half_edges(faces: np.ndarray) -> np.ndarray:
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def components(faces: np.ndarray) -> int:
    parent = {int(i): int(i) for i in np.unique(faces)}

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for a, b in half_edges(faces):
        parent[root(int(a))] = root(int(b))
    return sum(root(i) == i for i in parent)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_one_closed_outward_surface(kind):
    shape = random_shape(11, kind)
    edges = half_edges(shape.faces)
    directed = {(int(a), int(b)) for a, b in edges}
    assert len(directed) == len(edges), "an edge is used twice in the same direction"
    assert all((b, a) in directed for a, b in directed), "an edge has no twin"
    a, b, c = shape.vertices[shape.faces].transpose(1, 0, 2)
    assert (a * np.cross(b, c)).sum() > 0, "inward orientation"
    assert components(shape.faces) == 1
    assert len(np.unique(shape.vertices, axis=0)) == len(shape.vertices)
    assert set(np.unique(shape.faces)) == set(range(len(shape.vertices)))
    assert np.isfinite(shape.vertices).all() and shape.vertices.dtype == np.float64
    assert shape.kind == kind


@pytest.mark.parametrize("kind", KINDS)
def test_seed_and_kind_fix_the_shape(kind):
    first, again, other = (random_shape(seed, kind) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.vertices, again.vertices)
    np.testing.assert_array_equal(first.faces, again.faces)
    assert (first.soup is None) == (again.soup is None)
    same_size = first.vertices.shape == other.vertices.shape
    assert not (same_size and np.allclose(first.vertices, other.vertices))


def test_kind_is_drawn_from_the_seed():
    kinds = {random_shape(seed).kind for seed in range(8)}
    assert len(kinds) > 3 and kinds <= set(KINDS)
    assert random_shape(5).kind == random_shape(5).kind


def test_soup_holds_the_surface_and_more():
    shape = random_shape(0, "furniture_soup")
    assert shape.soup is not None
    vertices, faces = shape.soup
    assert faces.max() < len(vertices)
    np.testing.assert_allclose(vertices.min(0), shape.vertices.min(0), atol=1e-6)
    np.testing.assert_allclose(vertices.max(0), shape.vertices.max(0), atol=1e-6)

    def area(vertices, faces):
        a, b, c = vertices[faces].transpose(1, 0, 2)
        return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2

    assert area(vertices, faces) > area(shape.vertices, shape.faces)


def test_rejects_unknown_kind_and_negative_seed():
    with pytest.raises(ValueError, match="kind must be one of"):
        random_shape(0, "dragon")
    with pytest.raises(ValueError, match="seed must be at least 0"):
        random_shape(-1)
