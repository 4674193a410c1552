"""What a drawing holds, and where the camera stands."""

import numpy as np
import pytest
import torch
from flat import flat_canvas, flat_drawing

from riemlayer.viz import Drawing, outward, viewpoint


def sphere(n: int = 300) -> np.ndarray:
    x = np.random.default_rng(0).normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 1), (1, 1, 1)])
def test_camera_sees_the_source_from_outside_and_holds_the_shape(up):
    points = sphere()
    for normal in points[:20]:
        view = viewpoint(points, normal, up=up)
        offset = points - view.centre
        assert view.direction @ normal > 0.7
        assert np.allclose(view.axes @ view.axes.T, np.eye(3))
        assert np.linalg.norm(offset, axis=1).max() <= view.extent + 1e-12
        assert np.abs(offset @ view.axes[:2].T).max() <= view.fit + 1e-12


def test_up_is_up_in_the_picture():
    for up in np.eye(3):
        view = viewpoint(sphere(), np.roll(up, 1), up=up)
        assert view.up @ up > 0.7


def test_outward_points_away_from_the_shape_whatever_the_sign_of_the_normal():
    points = sphere()
    for p in points[:20]:
        for sign in (1, -1):
            assert np.allclose(outward(points, p, sign * p), p)


def test_outward_in_a_cup_is_where_one_can_look_from():
    """Most of a deep cup lies above its floor's inside, but nothing hides the floor."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(0, 1.5, 30))
    wall = np.stack([np.cos(angle), np.sin(angle), height], -1).reshape(-1, 3)
    disc = sphere(3000)[:, :2]
    floor = np.c_[disc, np.zeros(len(disc))]
    below = floor - [0, 0, 0.1]
    cup = np.concatenate([wall, floor, below])
    assert np.allclose(outward(cup, [0, 0, 0], [0, 0, 1]), [0, 0, 1])


def test_drawing_takes_tensors_and_leaves_them_alone():
    points = torch.rand(50, 3, requires_grad=True)
    before = points.detach().clone()
    drawing = Drawing(points, log=points[:, :2], paths=[points[:4]], valid=points[:, 0] > 0.5)
    assert isinstance(drawing.points, np.ndarray)
    assert torch.equal(points, before)


def test_drawings_share_a_canvas():
    canvas = flat_canvas(mesh=False)
    first = Drawing(canvas, log=canvas.points[:, :2])
    second = first.replace(texture="polar", title="polar")
    assert second.canvas is canvas and second.texture == "polar"
    assert np.array_equal(first.slope, second.slope)


def test_limits_are_the_least_and_greatest_of_what_is_drawn():
    canvas = flat_canvas(mesh=True)
    values = np.arange(len(canvas.points), dtype=float)
    assert Drawing(canvas, values=values).limits == (0, len(values) - 1)
    hidden = values < 10
    assert Drawing(canvas, values=values, valid=~hidden).limits == (10, len(values) - 1)
    values[-5:] = np.nan
    assert Drawing(canvas, values=values, valid=~hidden).limits == (10, len(values) - 6)
    assert Drawing(canvas, values=values, limits=(-1, 1)).limits == (-1, 1)


def test_points_without_a_log_are_not_valid():
    canvas = flat_canvas(mesh=True)
    log = canvas.points[:, :2].copy()
    log[:7] = np.nan
    drawing = Drawing(canvas, log=log)
    assert drawing.valid is not None and drawing.log is not None
    assert np.array_equal(drawing.valid == 0, np.arange(len(log)) < 7)
    assert np.isfinite(drawing.log).all()


def test_each_content_has_a_pattern_of_its_own():
    canvas = flat_canvas(mesh=True)
    log, colours = canvas.points[:, :2], np.ones_like(canvas.points)
    contents = (
        {}, {"log": log}, {"log": log, "texture": "polar"}, {"values": log[:, 0]},
        {"colours": colours}, {"log": log, "colours": colours},
    )  # fmt: skip
    assert len({Drawing(canvas, **content).pattern for content in contents}) == len(contents)


@pytest.mark.parametrize(
    "points, content, words",
    [
        (np.zeros((9, 2)), {}, r"`points` .*\(N, 3\).* got \(9, 2\)"),
        (np.zeros((3, 3)), {}, r"got \(3, 3\)"),
        (np.full((4, 3), np.nan), {}, r"`points` must be finite, 4 of 4"),
        (np.eye(4, 3), {"faces": [[0, 1, 4]]}, r"`faces` must index the 4 points, got 0 to 4"),
        (np.eye(4, 3), {"faces": [[0, 1]]}, r"`faces` .*\(M, 3\).* got \(1, 2\)"),
        (np.eye(4, 3), {"log": np.zeros((4, 3))}, r"`log` .*\(4, 2\), got \(4, 3\); .*tangent_c"),
        (np.eye(4, 3), {"values": np.zeros(3)}, r"`values` must have shape \(4,\), got \(3,\)"),
        (np.eye(4, 3), {"valid": np.zeros(3)}, r"`valid` must have shape \(4,\)"),
        (np.eye(4, 3), {"colours": np.zeros(4)}, r"`colours` must have shape \(4, 3\)"),
        (np.eye(4, 3), {"texture": "dots"}, r"`texture` must be one of checker, polar, got dots"),
        (np.eye(4, 3), {"values": np.zeros(4), "limits": (1, 0)}, r"`limits` must be \(low, high"),
        (np.eye(4, 3), {"values": np.zeros(4), "log": np.zeros((4, 2))}, r"`values` must stand a"),
    ],
)
def test_bad_drawing_is_named(points, content, words):
    with pytest.raises(ValueError, match=words):
        Drawing(points, **content)


def test_flat_drawing_is_its_own_log_map():
    """The square that the tests of pictures rest on."""
    for mesh in (True, False):
        drawing = flat_drawing(mesh)
        assert np.array_equal(drawing.log, drawing.points[:, :2])
