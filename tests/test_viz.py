"""Pictures and pages: what they show, and that they stand alone."""

import base64
import json
import re

import numpy as np
import pytest
import torch
from flat import flat_drawing

from riemlayer.viz import (
    Drawing,
    checkerboard,
    tangent_coordinates,
    viewpoint,
    write_html,
)

BLUE, CREAM, PLAIN = (
    checkerboard([x], period=0.1, radius=0.5)[0] for x in ([0.05, 0.05], [0.05, 0.15], [9.0, 0.0])
)


def test_tiles_next_to_each_other_differ_and_repeat_after_two():
    x = np.random.default_rng(0).uniform(-0.2, 0.2, (500, 2))
    colours = checkerboard(x, period=0.1, radius=9)
    for shift in ((0.2, 0.0), (0.1, 0.1)):
        assert np.array_equal(colours, checkerboard(x + np.array(shift), period=0.1, radius=9))
    neighbour = checkerboard(x + np.array((0.1, 0.0)), period=0.1, radius=9)
    assert (colours != neighbour).any(1).all()


def test_tiles_end_at_the_radius():
    inside = checkerboard([[0.29, 0.0], [0.31, 0.0]], radius=0.3)
    assert not np.array_equal(inside[0], PLAIN)
    assert np.array_equal(inside[1], PLAIN)


def test_tiles_differ_in_lightness():
    luminance = np.array([0.2126, 0.7152, 0.0722])
    assert luminance @ CREAM - luminance @ BLUE > 0.4


def test_tangent_coordinates_keep_lengths_and_angles_of_tangent_vectors():
    rng = np.random.default_rng(0)
    normal = rng.normal(size=3)
    v = np.cross(rng.normal(size=(50, 3)), normal)
    x = tangent_coordinates(v, normal)
    assert np.allclose(x @ x.T, v @ v.T)
    assert np.allclose(tangent_coordinates(normal, normal), 0)


def test_camera_sees_the_source_from_outside_and_holds_the_shape():
    x = np.random.default_rng(0).normal(size=(300, 3))
    sphere = x / np.linalg.norm(x, axis=1, keepdims=True)
    for normal in sphere[:20]:
        view = viewpoint(sphere, normal)
        right = np.cross(view.up, view.direction)
        offset = sphere - view.centre
        assert view.direction @ normal > 0.7
        assert abs(view.up @ view.direction) < 1e-12
        assert np.linalg.norm(offset, axis=1).max() <= view.extent + 1e-12
        assert np.abs(offset @ np.stack([right, view.up], 1)).max() <= view.fit + 1e-12


def test_drawing_takes_tensors_and_leaves_them_alone():
    points = torch.rand(50, 3, requires_grad=True)
    before = points.detach().clone()
    drawing = Drawing(points, log=points[:, :2], paths=[points[:4]])
    assert isinstance(drawing.points, np.ndarray)
    assert torch.equal(points, before)


def test_discs_of_a_plane_lie_in_the_plane():
    """And a log map that is the identity runs across them as the identity."""
    drawing = flat_drawing(mesh=False)
    assert drawing.slope is not None
    assert np.allclose(drawing.slope, np.eye(3)[:2], atol=0.05)
    assert np.allclose(np.abs(drawing.normals), [0, 0, 1], atol=1e-3)
    assert np.isclose(drawing.spacing, 0.05, rtol=1e-4)


@pytest.mark.parametrize(
    "points, log, words",
    [
        (np.zeros((9, 2)), None, r"`points` .*\(N, 3\).* got \(9, 2\)"),
        (np.zeros((3, 3)), None, r"got \(3, 3\)"),
        (np.eye(4, 3), np.zeros((4, 3)), r"`log` .*\(4, 2\), got \(4, 3\); .*tangent_coordinates"),
    ],
)
def test_bad_drawing_is_named(points, log, words):
    with pytest.raises(ValueError, match=words):
        Drawing(points, log=log)


def test_page_stands_alone_and_holds_the_data(tmp_path):
    line = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]])
    mesh = flat_drawing(mesh=True, paths=[line], title="</script>")
    cloud = flat_drawing(mesh=False)
    view = viewpoint(mesh.points, [0, 0, 1])
    page = write_html(tmp_path / "page.html", mesh, cloud, view=view).read_text("utf-8")
    assert not re.search(r"https?:|src=|@import|<link(?! rel=.icon. href=.data:)", page)
    assert page.count("</script>") == 3
    scene = json.loads(re.search(r'id="scene">(.*?)</script>', page, re.S)[1])

    def array(index, dtype, width):
        return np.frombuffer(base64.b64decode(scene["arrays"][index]), dtype).reshape(-1, width)

    first, second = scene["drawings"]
    assert first["log"] == second["log"], "an array that two drawings share is stored once"
    assert first["title"] == "</script>"
    assert np.array_equal(array(first["point"], np.float32, 3), mesh.points.astype(np.float32))
    assert np.array_equal(array(first["faces"], np.uint32, 3), mesh.faces)
    assert np.allclose(array(first["paths"], np.float32, 6)[1], [0.1, 0, 0, 0.2, 0, 0])
    assert second["faces"] is None and array(second["paths"], np.float32, 6).shape == (0, 6)
