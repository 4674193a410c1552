"""Laws of the procedural shapes: same seed same shape, closed, oriented outward, one body."""

from functools import cache

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

pytest.importorskip("manifold3d")
pytest.importorskip("skimage")

from riemlayer.data.procedural import KINDS, Shape, random_shape
from riemlayer.data.procedural.finish import is_valid, opened, outer_body
from riemlayer.data.procedural.sculpture import Sculpture
from riemlayer.data.procedural.solids import ball, box, soft_box, thin, to_arrays, tube, union
from riemlayer.data.procedural.warps import bend, random_turn, taper, twist


@cache
def shape_of(seed: int, kind: str) -> Shape:
    return random_shape(seed, kind)


def half_edges(faces: np.ndarray) -> np.ndarray:
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def components(faces: np.ndarray) -> int:
    i, j = half_edges(faces).T
    count, _ = connected_components(coo_array((np.ones(len(i)), (i, j))), directed=False)
    return count


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return float((a * np.cross(b, c)).sum() / 6)


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_one_closed_outward_surface(kind):
    shape = shape_of(3, kind)
    edges = half_edges(shape.faces)
    directed = np.unique(edges, axis=0)
    assert len(directed) == len(edges), "an edge is used twice in the same direction"
    twins = np.unique(edges[:, ::-1], axis=0)
    assert np.array_equal(directed, twins), "an edge has no twin"
    assert volume(shape.vertices, shape.faces) > 0, "inward orientation"
    assert components(shape.faces) == 1
    assert len(np.unique(shape.vertices, axis=0)) == len(shape.vertices)
    assert set(np.unique(shape.faces)) == set(range(len(shape.vertices)))
    assert np.isfinite(shape.vertices).all() and shape.vertices.dtype == np.float64
    assert shape.kind == kind


@pytest.mark.parametrize("kind", ["vessel", "humanoid", "csg", "furniture_soup", "relief"])
def test_seed_and_kind_fix_the_shape_and_another_seed_changes_it(kind):
    first, again = shape_of(3, kind), random_shape(3, kind)
    np.testing.assert_array_equal(first.vertices, again.vertices)
    np.testing.assert_array_equal(first.faces, again.faces)
    assert (first.soup is None) == (again.soup is None)
    if first.soup is not None and again.soup is not None:
        np.testing.assert_array_equal(first.soup[0], again.soup[0])
    other = random_shape(4, kind)
    same_size = first.vertices.shape == other.vertices.shape
    assert not (same_size and np.allclose(first.vertices, other.vertices))


def test_kind_is_drawn_from_the_seed():
    kinds = [random_shape(seed).kind for seed in range(5)]
    assert len(set(kinds)) > 2 and set(kinds) <= set(KINDS)
    assert random_shape(4).kind == kinds[4]


def test_soup_surrounds_the_body_and_has_interior_sheets():
    soups = [random_shape(seed, "furniture_soup") for seed in range(4)]
    for shape in soups:
        assert shape.soup is not None
        vertices, faces = shape.soup
        assert faces.max() < len(vertices)
        reach = np.abs(vertices.max(0) - shape.vertices.max(0)).max()
        assert reach < 0.05, "the soup lies in the frame of the body"
    assert any(area(*s.soup) > 1.05 * area(s.vertices, s.faces) for s in soups if s.soup)


def test_rejects_unknown_kind_and_negative_seed():
    with pytest.raises(ValueError, match="kind must be one of"):
        random_shape(0, "dragon")
    with pytest.raises(ValueError, match="seed must be at least 0"):
        random_shape(-1)


def test_outer_body_fills_voids_and_refuses_two_bodies():
    hollow = to_arrays(box((2, 2, 2)) - box((1, 1, 1)))
    body = outer_body(*hollow)
    assert body is not None and np.isclose(volume(*body), 8)
    assert outer_body(*to_arrays(box((1, 1, 1)) + box((1, 1, 1), (3, 0, 0)))) is None


def test_is_valid_sees_holes_flips_and_nonfinite_vertices():
    vertices, faces = to_arrays(soft_box((1, 1, 1), radius=0.2))
    assert is_valid(vertices, faces)
    assert not is_valid(vertices, faces[1:])
    assert not is_valid(vertices, np.r_[faces[:1, ::-1], faces[1:]])
    assert not is_valid(np.where(vertices > 0.49, np.nan, vertices), faces)
    assert not is_valid(np.r_[vertices, vertices[:1]], faces)


def test_opened_mesh_loses_one_side_or_nothing():
    mesh = to_arrays(box((1, 1, 1)))
    counts = {len(opened(np.random.default_rng(seed), mesh)[1]) for seed in range(12)}
    assert counts == {10, 12}


def test_tube_about_a_circle_is_a_torus():
    t = np.arange(120) * 2 * np.pi / 120
    ring = tube(np.stack([np.cos(t), np.sin(t), 0 * t], 1), 0.2, 48, closed=True)
    assert ring.genus() == 1
    assert np.isclose(ring.volume(), 2 * np.pi**2 * 0.2**2, rtol=0.01)


def test_union_of_overlapping_parts_counts_the_overlap_once():
    assert np.isclose(union([box((2, 1, 1)), box((2, 1, 1), (1, 0, 0))]).volume(), 3)


def test_sculpture_of_one_ball_has_its_volume_and_a_cut_takes_matter_away():
    whole, bitten = Sculpture(cells=1e5), Sculpture(cells=1e5)
    for clay in (whole, bitten):
        clay.ball((0.1, 0, 0), 0.5)
    bitten.cone((0, 0, -1), (0, 0, 1), 0.2, removes=True)
    assert np.isclose(volume(*whole.mesh()), 4 / 3 * np.pi * 0.5**3, rtol=0.01)
    assert volume(*bitten.mesh()) < 0.9 * volume(*whole.mesh())


def test_limbs_keep_a_least_thickness():
    clay = Sculpture(cells=2e5, thinnest=0.03)
    clay.cone((0, 0, -1), (0, 0, 1), 1e-3)
    vertices, _ = clay.mesh()
    assert 0.02 < np.abs(vertices[:, 0]).max() < 0.06


def test_warps_keep_orientation_and_rotations_keep_length():
    vertices, faces = to_arrays(ball(1.0, sides=40))
    for warp in (taper(vertices, 0.3, 0), twist(vertices, 0.8, 1), bend(vertices, -0.7, 2, 0)):
        assert is_valid(warp, faces) and volume(warp, faces) > 0
    assert np.isclose(volume(twist(vertices, 0.8, 1), faces), volume(vertices, faces), rtol=0.02)
    for seed in range(10):
        turn = random_turn(np.random.default_rng(seed))
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        assert np.isclose(np.linalg.det(turn), 1)


def test_thin_stays_between_its_bounds():
    rng = np.random.default_rng(0)
    drawn = [thin(rng, 0.02, 0.1) for _ in range(200)]
    assert 0.02 <= min(drawn) < 0.025 and 0.085 < max(drawn) <= 0.1
