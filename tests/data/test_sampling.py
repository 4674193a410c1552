"""Blue noise on any mesh: exactly n points, none close to another, everywhere on the surface."""

import math

import numpy as np
import pytest
from scipy.spatial import KDTree

from riemlayer.data import sample_poisson
from riemlayer.data.sampling import sample_surface

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


def cube(low: float = 0.0, high: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """The 12 triangles of a cube, each with corners of its own: a soup."""
    quads = []
    for axis in range(3):
        for side in (low, high):
            quad = np.insert(SQUARE[:, :2] * (high - low) + low, axis, side, axis=1)
            quads.append(quad[HALVES].reshape(-1, 3))
    return np.concatenate(quads), np.arange(36).reshape(-1, 3)


def densest(area: float, n: int) -> float:
    """Distance of n points of the hexagonal packing on that area."""
    return math.sqrt(2 / math.sqrt(3) * area / n)


def nearest(x: np.ndarray) -> np.ndarray:
    return KDTree(x).query(x, 2)[0][:, 1]


@pytest.mark.parametrize("n", [1, 7, 500, 2000])
def test_exactly_n_points_of_the_surface_none_close_to_another(n):
    x = sample_poisson(*cube(), n)
    assert x.shape == (n, 3) and np.abs(np.abs(x - 0.5).max(1) - 0.5).max() < 1e-12
    if n >= 500:
        uniform = sample_surface(*cube(), n, np.random.default_rng(0))
        assert nearest(x).min() > 0.6 * densest(6, n) > 10 * nearest(uniform).min()


def test_no_place_of_the_surface_is_far_from_a_sample():
    x = sample_poisson(*cube(), 1000)
    places = sample_surface(*cube(), 50_000, np.random.default_rng(1))
    uniform = sample_surface(*cube(), 1000, np.random.default_rng(0))
    hole = KDTree(x).query(places)[0].max()
    assert hole < 1.1 * densest(6, 1000)
    assert hole < 0.7 * KDTree(uniform).query(places)[0].max()


def test_every_area_has_its_share():
    """Triangles of very different sizes: a fan with one corner near an edge."""
    v = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.02, 0.5, 0]])
    f = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    x = sample_poisson(v, f, 2000)
    cells, _, _ = np.histogram2d(x[:, 0], x[:, 1], bins=5, range=[[0, 1], [0, 1]])
    assert np.abs(cells - 80).max() < 20  # uniform samples: a standard deviation of 9


@pytest.mark.parametrize("case", ["fin", "crossing", "pieces", "doubled"])
def test_any_soup_will_do(case):
    v, f = cube()
    if case == "fin":  # three triangles at an edge
        v = np.concatenate([SQUARE, [[0.5, 0.5, 1]]])
        f = np.concatenate([HALVES, [[0, 2, 4]]])
    elif case == "crossing":
        w, g = cube(0.5, 1.5)
        v, f = np.concatenate([v, w]), np.concatenate([f, g + len(v)])
    elif case == "pieces":
        v, f = np.concatenate([v, v + 50]), np.concatenate([f, f + len(v)])
    else:
        f = np.concatenate([f, f[:, ::-1], f[:1, [0, 0, 1]]])
    x = sample_poisson(v, f, 600, seed=3)
    assert x.shape == (600, 3) and (nearest(x) > 0).all()
    assert nearest(x).min() > 0.1 * densest(6, 600)
    assert np.ptp(x, axis=0).max() > 0.9 * np.ptp(v, axis=0).max()
    if case == "pieces":
        assert abs((x[:, 0] > 25).sum() - 300) < 30


@pytest.mark.parametrize("scale, shift", [(1e-3, 0), (1e9, 0), (1.0, 1e6)])
def test_the_unit_and_the_origin_do_not_matter(scale, shift):
    v, f = cube()
    x = sample_poisson(v, f, 200)
    y = (sample_poisson(scale * v + shift, f, 200) - shift) / scale
    assert np.abs(x - y).max() < 1e-8


def test_a_seed_is_repeated_and_another_differs():
    v, f = cube()
    first, again, other = (sample_poisson(v, f, 100, seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_arguments_are_checked_and_left_alone():
    v, f = cube()
    copy = v.copy(), f.copy()
    sample_poisson(v, f, 20)
    assert np.array_equal(v, copy[0]) and np.array_equal(f, copy[1])
    with pytest.raises(ValueError, match="n must be at least 1, got 0"):
        sample_poisson(v, f, 0)
    with pytest.raises(ValueError, match="faces must have an area"):
        sample_poisson(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]]), 5)
    with pytest.raises(ValueError, match="faces must index the 36 vertices"):
        sample_poisson(v, f + 1, 5)
