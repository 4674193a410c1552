"""Puppets: points lie on the outside of the body, parts are all there, turning is rigid."""

import numpy as np
import pytest

from riemlayer.data.puppets import PARTS, Rods, _body, _on_rods, _signed_distance, puppet


@pytest.mark.parametrize("seed", range(4))
def test_points_lie_on_the_outside_of_the_rods_of_their_part(seed):
    points, part = puppet(seed, 600, turned=False)
    rods = _body(np.random.default_rng(seed))
    distance = _signed_distance(rods, points.astype(float))
    assert np.abs(distance.min(1)).max() < 1e-5
    own = np.where(rods.part == part[:, None], distance, np.inf).min(1)
    assert np.abs(own).max() < 1e-5


@pytest.mark.parametrize("seed", range(4))
def test_every_part_has_points_and_legs_are_below_the_head(seed):
    points, part = puppet(seed, 600, turned=False)
    count = np.bincount(part, minlength=len(PARTS))
    assert len(count) == len(PARTS) and count.min() > 20
    height = [points[part == i, 2].mean() for i in range(len(PARTS))]
    assert height[PARTS.index("leg")] < height[PARTS.index("torso")] < height[PARTS.index("head")]


def test_points_are_uniform_by_area():
    """Slices of equal height of a tube and of a ball have equal areas (Archimedes)."""
    axis = np.array([[0.0, 0.6, 0.8], [1.0, 0, 0]])
    length, radius = np.array([1.0, 0.3]), np.array([0.2, 0.4])
    rods = Rods(np.ones((2, 3)), axis, length, radius, np.array([0, 1]))
    rod, points = _on_rods(np.random.default_rng(0), 40_000, rods)
    for i in range(2):
        height = (points[rod == i] - rods.start[i]) @ axis[i]
        counts = np.histogram(height, 10, (-radius[i], length[i] + radius[i]))[0]
        wanted = 4_000 * (radius * (length + 2 * radius) / (0.2 * 1.4 + 0.4 * 1.1))[i]
        assert counts.sum() == (rod == i).sum()
        assert np.abs(counts / wanted - 1).max() < 0.1
    assert np.abs(_signed_distance(rods, points)[np.arange(40_000), rod]).max() < 1e-12


def test_a_puppet_is_the_same_again_and_turned_as_a_whole():
    points, part = puppet(7, 300)
    again, same = puppet(7, 300)
    upright, upright_part = puppet(7, 300, turned=False)
    assert np.array_equal(points, again) and np.array_equal(part, same)
    assert np.array_equal(part, upright_part)
    assert np.linalg.norm(points - upright, axis=1).max() > 0.1
    turn = np.linalg.lstsq(upright, points, rcond=None)[0]
    assert np.allclose(upright @ turn, points, atol=1e-5)
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-4)
    assert np.linalg.det(turn) == pytest.approx(1, abs=1e-4), "no mirror image"


@pytest.mark.parametrize(("seed", "count"), [(-1, 100), (0, 0)])
def test_seeds_and_counts_out_of_range_are_named(seed, count):
    with pytest.raises(ValueError, match="seed must be at least 0 and count at least 1"):
        puppet(seed, count)
