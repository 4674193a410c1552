"""Shapes made ready to be drawn: discs of clouds, creases and subdivision of meshes."""

import numpy as np
import pytest
from flat import flat_canvas, grid

from riemlayer.viz import Canvas, Drawing, subdivide
from riemlayer.viz.cloud import neighbourhoods

CUBE = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
SIDES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
                  [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip


def sphere(n: int) -> np.ndarray:
    x = np.random.default_rng(0).normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def areas(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = points[faces].transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def test_neighbours_are_the_nearest():
    points = np.random.default_rng(0).normal(size=(400, 3)) * [1, 10, 0.1]
    index, distance = neighbourhoods(points, 9)
    every = np.linalg.norm(points[:, None] - points, axis=-1)
    assert np.allclose(distance, np.sort(every, axis=1)[:, :9], rtol=1e-4, atol=1e-4)
    assert (index[:, 0] == np.arange(400)).all()


def test_discs_of_a_plane_lie_in_the_plane():
    """A log map that is the identity runs across them as the identity."""
    canvas = flat_canvas(mesh=False)
    slope = canvas.log_slope(canvas.points[:, :2])
    assert canvas.discs is not None and slope is not None
    assert np.allclose(slope, np.eye(3)[:2], atol=0.05)
    assert np.allclose(np.abs(canvas.normals), [0, 0, 1], atol=1e-3)
    assert np.allclose(canvas.discs.bend, 0, atol=1e-3)
    assert np.isclose(canvas.spacing, 0.05, rtol=1e-4)


def test_normals_of_a_sphere_and_their_derivative():
    """On the unit sphere the normal is the point, so its derivative is the projection."""
    points = sphere(4000)
    canvas = Canvas(points)
    assert canvas.discs is not None
    sign = np.sign((canvas.normals * points).sum(1))
    assert np.linalg.norm(sign[:, None] * canvas.normals - points, axis=1).max() < 0.05
    wanted = np.eye(3) - points[:, :, None] * points[:, None]
    error = np.abs(sign[:, None, None] * canvas.discs.bend - wanted).max((1, 2))
    assert np.median(error) < 0.1


def test_discs_cover_a_random_cloud():
    """No place on a sphere is outside of all discs, in 2,000 samples of it."""
    points = sphere(3000)
    discs = Canvas(points).discs
    assert discs is not None
    place = sphere(5000)[3000:]
    near = np.linalg.norm(place[:, None] - points, axis=-1) < discs.size
    offset = place[:, None] - points
    inner = (offset * discs.rim).sum(-1) < 1
    assert (near & inner).any(1).mean() > 0.999


def test_discs_of_a_plane_end_near_its_border():
    canvas = flat_canvas(mesh=False)
    assert canvas.discs is not None
    corners = np.einsum(
        "n,kd->nkd", canvas.discs.size, [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]
    )
    cut = (corners * canvas.discs.rim[:, None]).sum(-1) > 1
    ends = np.where(cut[..., None], 0, corners) + canvas.points[:, None]
    assert np.abs(ends).max() < 0.5 + 1.5 * canvas.spacing
    inner = np.abs(canvas.points).max(1) < 0.4
    assert (canvas.discs.rim[inner] == 0).all()


def test_two_sheets_keep_their_own_normals_and_neighbours():
    """A plate much thinner than the spacing of its points."""
    rng = np.random.default_rng(0)
    top = np.c_[rng.uniform(size=(1500, 2)), np.zeros(1500)]
    plate = np.concatenate([top, np.c_[rng.uniform(size=(1500, 2)), np.full(1500, -0.01)]])
    canvas = Canvas(plate)
    assert canvas.discs is not None
    inner = np.abs(plate[:, :2] - 0.5).max(1) < 0.4
    assert (np.abs(canvas.normals[inner, 2]) > 0.99).mean() > 0.95
    same = plate[canvas.discs.neighbours, 2] == plate[:, None, 2]
    assert same[inner].mean() > 0.75


def test_a_torn_map_is_flat_across_discs():
    canvas = flat_canvas(mesh=False)
    x = canvas.points
    slope = canvas.log_slope(np.where(x[:, :1] > 0, x[:, :2] + 5, x[:, :2]))
    assert slope is not None
    assert (slope[np.abs(x[:, 0]) < 0.01] == 0).all()
    assert np.allclose(slope[np.abs(x[:, 0]) > 0.2], np.eye(3)[:2], atol=0.05)


def test_slope_of_values_is_not_that_of_the_hidden_ones():
    canvas = flat_canvas(mesh=False)
    x = canvas.points[:, 0]
    drawn = x < 0.3
    slope = canvas.slope(np.where(drawn, 7 * x, -1e6)[:, None], drawn)
    assert slope is not None
    assert np.allclose(slope[drawn & (x > -0.49)], [[7, 0, 0]], atol=0.4)


def test_a_map_goes_on_up_to_its_border_and_hidden_points_do_not_bend_it():
    canvas = flat_canvas(mesh=False)
    log = canvas.points[:, :2].copy()
    drawn = log[:, 0] < 0.3
    cut = Drawing(canvas, log=np.where(drawn[:, None], log, np.nan))
    masked = Drawing(canvas, log=np.where(drawn[:, None], log, 1.0), valid=drawn)
    inner = drawn & (np.abs(log) < 0.45).all(1)
    assert (inner & (log[:, 0] > 0.2)).any(), "points beside the border"
    for drawing in (cut, masked):
        assert drawing.slope is not None
        assert np.allclose(drawing.slope[inner], np.eye(3)[:2], atol=0.05)


def test_given_normals_are_kept():
    points = sphere(500)
    assert np.allclose(Canvas(points, normals=-2 * points).normals, -points)
    with pytest.raises(ValueError, match=r"`normals` must have shape \(500, 3\), got \(4, 3\)"):
        Canvas(points, normals=points[:4])


def test_a_cube_has_sharp_edges_and_flat_sides():
    canvas = Canvas(CUBE, SIDES)
    assert len(canvas.corner) == 24  # each vertex once for each of its three sides
    assert np.allclose(np.sort(np.abs(canvas.normals), axis=1), [0, 0, 1])
    assert canvas.triangles is not None
    assert np.array_equal(canvas.corner[canvas.triangles], SIDES)
    a, b, c = canvas.points[SIDES].transpose(1, 0, 2)
    assert ((np.cross(b - a, c - a) * canvas.normals[canvas.triangles[:, 0]]).sum(1) > 0).all()


def test_a_smooth_mesh_keeps_its_vertices():
    points, faces = grid()
    height = 0.1 * np.sin(3 * points[:, :1])
    canvas = Canvas(points + height * [0, 0, 1], faces)
    assert len(canvas.corner) == len(points)
    slope = 0.3 * np.cos(3 * points[canvas.corner, 0])
    wanted = np.c_[-slope, 0 * slope, np.ones_like(slope)]
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    assert np.abs(canvas.normals - wanted).max() < 0.03


def test_faces_without_area_do_no_harm():
    canvas = Canvas(CUBE, np.concatenate([SIDES, [[0, 0, 1], [3, 3, 3]]]))
    assert np.allclose(np.linalg.norm(canvas.normals, axis=1), 1)


@pytest.mark.parametrize("longest", [2.0, 0.9, 0.5, 0.3])
def test_subdivision_shortens_edges_and_keeps_the_surface(longest):
    points, faces = subdivide(CUBE, SIDES, longest)
    edges = points[faces] - points[np.roll(faces, 1, axis=1)]
    assert np.linalg.norm(edges, axis=-1).max() <= longest
    assert np.isclose(areas(points, faces).sum(), 6)
    assert np.array_equal(points[:8], CUBE)
    a, b, c = points[faces].transpose(1, 0, 2)
    volume = (a * np.cross(b, c)).sum() / 6
    assert np.isclose(abs(volume), 1), "triangles keep their orientation"
    pairs = np.sort(np.stack([faces, np.roll(faces, -1, 1)], -1).reshape(-1, 2), axis=1)
    assert (np.unique(pairs, axis=0, return_counts=True)[1] == 2).all(), "neighbours stay joined"


def test_subdivision_needs_a_length():
    with pytest.raises(ValueError, match="`longest` must be positive, got 0"):
        subdivide(CUBE, SIDES, 0)
