"""Neighbourhoods of points: their normals, against brute force and closed forms."""

import pytest
import torch
from references import fibonacci_sphere, lumpy
from torch import Tensor

from riemlayer.data.closed_form import Sphere
from riemlayer.geometry import Points, planes_at_scales
from riemlayer.geometry.grids import PlaneLevel
from riemlayer.geometry.points import CLOSEST, REACHES
from riemlayer.octree import Octree, build_octree


def sorted_cloud(points: Tensor, shape: Tensor | None = None) -> tuple[Points, PlaneLevel, Octree]:
    shape = torch.zeros(len(points), dtype=torch.long) if shape is None else shape
    octree = build_octree(points.detach(), shape, 6)
    plane = planes_at_scales(points, octree, (0,)).scales[0].coarse
    return Points.of(points, octree, plane), plane, octree


def sources(n: int) -> Tensor:
    return torch.zeros(n, dtype=torch.long)


def test_points_within_a_radius_are_those_of_brute_force():
    cloud = lumpy(1500)
    points, _, _ = sorted_cloud(cloud)
    x = torch.cat((1.02 * cloud[::50], torch.full((1, 3), 3.0).double(), -cloud[:1] * 1.2))
    radius = torch.linspace(0.2, 1.0, len(x)).double() * points.level.cell_size
    row, offset = points.within(x, sources(len(x)), radius)
    near = torch.cdist(x, cloud) < radius[:, None]
    assert near.any() and torch.equal(row.bincount(minlength=len(x)), near.sum(-1))
    expected = (near[..., None] * (cloud - x[:, None])).sum(1)
    torch.testing.assert_close(torch.zeros_like(x).index_add(0, row, offset.T), expected)


@pytest.mark.parametrize("shift", [0.0, 0.013])
def test_normals_of_a_sphere_and_of_a_plane(shift):
    ball = 0.8 * fibonacci_sphere(4000) + shift
    points, plane, _ = sorted_cloud(ball)
    x = ball[::37]
    for normal, says, _ in points.normals(x, sources(len(x)), plane):
        cosine = (normal * (x - shift)).sum(-1).abs() / 0.8
        assert (cosine > 1 - 1e-3).all() and says.isfinite().all()
    flat = torch.rand(3000, 3, dtype=torch.float64) * 1.6 - 0.8
    flat[:, 2] = 0.3 * flat[:, 0] + shift
    points, plane, _ = sorted_cloud(flat)
    up = torch.tensor([-0.3, 0.0, 1.0], dtype=torch.float64) / 1.09**0.5
    for normal, *_ in points.normals(flat[::50], sources(60), plane):
        torch.testing.assert_close((normal @ up).abs(), torch.ones(60).double())


def test_they_say_whether_points_are_enough():
    """On a grid they are; on a line, or where the next point is beyond the radius, they are not."""
    line = (torch.arange(40, dtype=torch.float64) + 0.5) / 40 - 0.5
    grid = torch.nn.functional.pad(torch.cartesian_prod(line, line), (0, 1))
    points, plane, _ = sorted_cloud(grid)
    inside = grid[grid.abs().amax(-1) < 0.4]
    for near in points.normals(inside, sources(len(inside)), plane):
        assert (near.enough == 1).all()
    points, plane, _ = sorted_cloud(torch.nn.functional.pad(line[:, None], (0, 2)))
    for near in points.normals(points.xyz.T, sources(40), plane):
        assert (near.enough < 1e-6).all()  # rounding of eigenvalues
    points, plane, _ = sorted_cloud(fibonacci_sphere(300))
    for near in points.normals(points.xyz.T, sources(300), plane):
        assert (near.enough == 0).all()


def test_of_dense_clouds_few_are_kept_and_the_normals_are_right():
    """Of 150,000 points of a sphere at random, four fifths on one half."""
    ball = Sphere(0.4).sample(240_000, torch.Generator().manual_seed(0))
    ball = ball[(ball[:, 2] > 0) | (torch.arange(240_000) % 4 == 0)]
    points, plane, _ = sorted_cloud(ball)
    cells = 4 * torch.pi * (0.4 / plane.level.cell_size) ** 2  # as many as the sphere is large
    assert points.xyz.shape[1] < 1.2 * cells / CLOSEST**2 < len(ball) / 5
    x = ball[::1999]
    for near, share in zip(points.normals(x, sources(len(x)), plane), (0.8, 0.98), strict=True):
        assert near.enough.mean() > share  # the more of 7 and of 21 points
        cosine = (near.normal * x).sum(-1).abs()[near.enough.squeeze(-1) == 1] / 0.4
        assert (cosine > 1 - 1e-3).all()


def test_near_an_edge_few_points_tell_the_face():
    """Twice the distance from point to point from the edge of a cube, where planes are round it."""
    n = 40
    line = (torch.arange(n, dtype=torch.float64) + 0.5) / n - 0.5
    face = torch.cartesian_prod(line, line)
    top = torch.cat((face, torch.full((n * n, 1), 0.5).double()), -1)
    cube = torch.cat([sign * top.roll(i, 1) for i in range(3) for sign in (1, -1)])
    points, plane, octree = sorted_cloud(cube)
    x = top[(top[:, 0] > 0.5 - 2.6 / n) & (top[:, 0] < 0.5 - 2.4 / n)]
    few = points.normals(x, sources(len(x)), plane)[0].normal
    blended = planes_at_scales(cube, octree, (0,)).normal(x, sources(len(x)))
    inside = x[:, 1].abs() < 0.4
    steep, rounded = (1 - normal[inside, 2].abs() for normal in (few, blended))
    assert rounded.min() > 5e-4 and steep.max() < 1e-6


def test_clouds_of_a_batch_do_not_see_one_another():
    clouds = lumpy(900), 0.7 * fibonacci_sphere(600)
    shape = torch.arange(2).repeat_interleave(torch.tensor([900, 600]))
    together, plane, _ = sorted_cloud(torch.cat(clouds), shape)
    for i, cloud in enumerate(clouds):
        alone, own, _ = sorted_cloud(cloud)
        x = cloud[::20]
        expected = alone.normals(x, sources(len(x)), own)
        found = together.normals(x, sources(len(x)) + i, plane)
        for got, want in zip(found, expected, strict=True):
            torch.testing.assert_close(got, want)


def test_far_from_every_point_and_at_lonely_ones_answers_are_finite():
    cloud = torch.cat((0.4 * fibonacci_sphere(800), torch.tensor([[0.9, 0.9, 0.9]]).double()))
    points, plane, _ = sorted_cloud(cloud.requires_grad_())
    x = torch.tensor([[0.0, 0, 0], [0.9, 0.9, 0.9], [5.0, 0, 0]], dtype=torch.float64)
    found = points.normals(x.requires_grad_(), sources(3), plane)
    assert len(found) == len(REACHES) and all(float(x.enough.detach().max()) == 0 for x in found)
    for normal, says, _ in found:
        torch.testing.assert_close(normal.norm(dim=-1), torch.ones(3).double())
        assert says.isfinite().all()
    sum(x.normal.sum() for x in found).backward()
    assert cloud.grad.isfinite().all() and x.grad.isfinite().all()


def test_normals_have_gradients_in_the_place_and_in_the_points():
    cloud = lumpy(700)
    octree = build_octree(cloud, torch.zeros(700, dtype=torch.long), 6)
    plane = planes_at_scales(cloud, octree, (0,)).scales[0].coarse
    x = 1.003 * cloud[:3]

    def normals(x: Tensor, points: Tensor) -> Tensor:
        found = Points.of(points, octree, plane).normals(x, sources(3), plane)
        return torch.stack([x.normal for x in found])

    assert torch.autograd.gradcheck(normals, (x.requires_grad_(), cloud.requires_grad_()), eps=1e-7)
