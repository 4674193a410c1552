"""Patterns and colours in closed form."""

import numpy as np
import pytest

from riemlayer.viz import (
    checkerboard,
    colour_map,
    label_colours,
    polar_grid,
    tangent_coordinates,
)
from riemlayer.viz.palette import BLACK, BLUE, CHARTS, CREAM, MAP, ORANGE, PLAIN, apart
from riemlayer.viz.tiles import SECTORS

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
# Linear RGB as protanopes and deuteranopes see it (Vienot, Brettel and Mollon 1999)
PROTAN = np.array([[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]])
DEUTAN = np.array([[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]])


def linear(colours) -> np.ndarray:
    colours = np.asarray(colours, float)
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def lightness(colours) -> np.ndarray:
    """CIE L*, 0 to 100."""
    y = linear(colours) @ LUMINANCE
    return np.where(y > 0.008856, 116 * np.cbrt(y) - 16, 903.3 * y)


def test_tiles_next_to_each_other_differ_and_repeat_after_two():
    x = np.random.default_rng(0).uniform(-0.2, 0.2, (500, 2))
    colours = checkerboard(x, period=0.1, radius=9)
    for shift in ((0.2, 0.0), (0.1, 0.1)):
        assert np.array_equal(colours, checkerboard(x + np.array(shift), period=0.1, radius=9))
    neighbour = checkerboard(x + np.array((0.1, 0.0)), period=0.1, radius=9)
    assert (colours != neighbour).any(1).all()


def test_polar_tiles_alternate_along_the_ray_and_around():
    rng = np.random.default_rng(0)
    r, angle = rng.uniform(0, 0.3, 500), rng.uniform(-np.pi, np.pi, 500)

    def at(r, angle):
        x = np.stack([r * np.cos(angle), r * np.sin(angle)], -1)
        return polar_grid(x, period=0.1, radius=9)

    colours, sector = at(r, angle), 2 * np.pi / SECTORS
    assert (colours != at(r + 0.1, angle)).any(1).all()
    assert (colours != at(r, angle + sector)).any(1).all()
    assert np.array_equal(colours, at(r + 0.1, angle + sector))


@pytest.mark.parametrize("tiles", [checkerboard, polar_grid])
def test_tiles_end_at_the_radius(tiles):
    inside = tiles([[0.29, 0.0], [0.31, 0.0]], radius=0.3)
    assert not np.array_equal(inside[0], PLAIN)
    assert np.array_equal(inside[1], PLAIN)


def test_tiles_differ_in_lightness():
    assert lightness(CREAM) - lightness(BLUE) > 40
    assert abs(lightness(ORANGE) - lightness(BLACK)) > 30


def test_colour_map_gets_lighter_all_the_way_in_even_steps():
    """So the order of values survives every colour blindness, and a grey printer."""
    steps = np.diff(lightness(colour_map(np.linspace(0, 1, 101))))
    assert steps.min() > 0.5 * steps.mean()
    assert steps.max() < 2 * steps.mean()


def test_colour_map_runs_from_end_to_end_and_stays_there():
    ends = colour_map([0.0, 1.0])
    assert np.array_equal(colour_map([-3.0, 7.0]), ends)
    assert lightness(ends[0]) < 20 and lightness(ends[1]) > 85
    assert np.array(MAP)[:, 0].tolist() == sorted(x[0] for x in MAP)


@pytest.mark.parametrize("eye", [np.eye(3), PROTAN, DEUTAN])
def test_charts_can_be_told_apart_by_colour_blind_eyes(eye):
    seen = linear(CHARTS) @ eye.T
    gap = np.linalg.norm(seen[:, None] - seen, axis=-1) + np.eye(len(CHARTS))
    assert gap.min() > 0.08


def test_labels_repeat_their_hue_in_a_lighter_round():
    colours = label_colours(np.arange(2 * len(CHARTS)))
    assert np.allclose(colours[: len(CHARTS)], CHARTS)
    assert (lightness(colours[len(CHARTS) :]) > lightness(CHARTS)).all()


def test_charts_next_to_each_other_have_different_colours():
    centres = np.random.default_rng(0).uniform(size=(200, 3))
    label = apart(centres)
    gap = np.linalg.norm(centres[:, None] - centres, axis=-1)
    for i in range(1, len(centres)):
        assert label[i] != label[gap[i, :i].argmin()]
    assert label.max() < len(CHARTS)


def test_tangent_coordinates_keep_lengths_and_angles_of_tangent_vectors():
    rng = np.random.default_rng(0)
    normal = rng.normal(size=3)
    v = np.cross(rng.normal(size=(50, 3)), normal)
    x = tangent_coordinates(v, normal)
    assert np.allclose(x @ x.T, v @ v.T)
    assert np.allclose(tangent_coordinates(normal, normal), 0)
