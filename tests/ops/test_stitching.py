"""A stitched chart of a developable surface is its unrolling; of a sphere it covers what it can."""

import math

import pytest
import torch
from exact import Exact, sphere_points, unit

from riemlayer.data.closed_form import Cylinder, Plane
from riemlayer.ops import decal, stitch_log


def cylinder_points(n: int = 3000) -> tuple[torch.Tensor, torch.Tensor]:
    """Points of a cylinder of radius 0.5, and their unrolled coordinates from (0.5, 0, 0)."""
    angle = (torch.rand(n, dtype=torch.float64) * 2 - 1) * 0.95 * math.pi
    height = torch.rand(n, dtype=torch.float64) * 2 - 1
    points = torch.stack((0.5 * angle.cos(), 0.5 * angle.sin(), height), -1)
    return points, torch.stack((0.5 * angle, height), -1)


def distortion(x: torch.Tensor, y: torch.Tensor, points: torch.Tensor) -> float:
    """E_MDD of a chart x against the true one y, over pairs of near points."""
    near = torch.cdist(points, points).topk(7, largest=False)[1][:, 1:]
    true, own = ((z[:, None] - z[near]).norm(dim=-1) for z in (y, x))
    same_side = true < 0.5
    return float((own / true - 1).abs()[same_side].mean())


def test_a_cylinder_is_unrolled():
    surface, p = Exact(Cylinder(0.5)), torch.tensor([0.5, 0, 0], dtype=torch.float64)
    points, unrolled = cylinder_points()
    near = (unrolled[:, 0].abs() < 1.2) & (unrolled[:, 1].abs() < 0.95)
    stitched = stitch_log(surface, p, points, depth=6)
    assert bool(stitched.covered[near].all())
    assert float(unrolled[near].norm(dim=-1).max()) > 2.5 * 0.5  # far beyond one chart
    assert distortion(stitched.coordinates[near], unrolled[near], points[near]) < 0.02
    length = stitched.coordinates[near].norm(dim=-1)
    torch.testing.assert_close(length, unrolled[near].norm(dim=-1), rtol=0, atol=0.005)


def test_where_ways_round_meet_nothing_is_claimed():
    """Behind a cylinder both ways lead to other coordinates; what is claimed is one of them."""
    surface, p = Exact(Cylinder(0.5)), torch.tensor([0.5, 0, 0], dtype=torch.float64)
    points, unrolled = cylinder_points()
    stitched = stitch_log(surface, p, points, depth=12)
    turn = torch.tensor([math.pi, 0.0], dtype=torch.float64)
    x = surface.to_2d(p, surface.from_2d(p, stitched.coordinates))
    axes = surface.frame(p)[:, :2]
    around = (x @ axes.mT)[:, 1:]  # along y and z
    off = torch.stack([(around - unrolled - s * turn).norm(dim=-1) for s in (-1, 0, 1)]).amin(0)
    assert float(stitched.covered.double().mean()) > 0.8
    assert float(off[stitched.covered].quantile(0.99)) < 0.15


def test_no_rounds_are_the_plain_log_map():
    surface, p = Exact(), unit(0, 0, 1)
    points = sphere_points(500)
    stitched = stitch_log(surface, p, points, depth=0)
    log = surface.to_2d(p, surface.surface.log(p, points))
    assert torch.equal(stitched.covered, log.norm(dim=-1) < 0.5)
    torch.testing.assert_close(stitched.coordinates[stitched.covered], log[stitched.covered])
    assert len(stitched.charts.centre) == 1
    weight = (1 - (log.norm(dim=-1) / 0.5) ** 2).clamp_min(0) ** 2
    torch.testing.assert_close(stitched.confidence, weight)


def test_more_rounds_cover_more_and_charts_that_fit_badly_count_less():
    points = sphere_points(3000)
    shares = []
    for depth in (0, 1, 3):
        stitched = stitch_log(Exact(), unit(0, 0, 1), points, depth)
        shares.append(float(stitched.covered.double().mean()))
        assert bool(stitched.coordinates.isfinite().all())
        assert bool((stitched.coordinates[~stitched.covered] == 0).all())
        assert 0 <= float(stitched.confidence.min()) <= float(stitched.confidence.max()) <= 1
        assert float(stitched.charts.misfit.max()) < 0.3 * 0.5
    assert shares[0] < 0.5 * shares[1] < 0.5 * shares[2]


def test_mirrored_frames_are_turned_back():
    """A cloud's normals have no sign, so neighbouring charts may be mirror images."""

    class Mirrored(Exact):
        def normal(self, p, *, shape=None):
            sign = torch.where((7 * p).sin().sum(-1, keepdim=True) < 0, -1.0, 1.0)
            return super().normal(p) * sign

    points, unrolled = cylinder_points()
    p = torch.tensor([0.5, 0, 0], dtype=torch.float64)
    stitched = stitch_log(Mirrored(Cylinder(0.5)), p, points, depth=4)
    assert bool((torch.linalg.det(stitched.charts.rotation) < 0).any())
    near = stitched.covered & (unrolled[:, 0].abs() < 1) & (unrolled[:, 1].abs() < 0.8)
    assert distortion(stitched.coordinates[near], unrolled[near], points[near]) < 0.02


def test_what_is_not_connected_stays_uncovered():
    x = torch.rand(500, 3, dtype=torch.float64) * 0.4
    x[:, 2] = 0
    points = torch.cat((x, x + torch.tensor([5.0, 0, 0])))
    stitched = stitch_log(Exact(Plane()), points[0], points, depth=5)
    assert bool(stitched.covered[:500].all()) and not bool(stitched.covered[500:].any())


def test_a_decal_is_upright_and_in_scale_where_it_is_stuck_on():
    surface, p = Exact(Plane()), torch.zeros(3, dtype=torch.float64)
    points = torch.rand(800, 3, dtype=torch.float64) * 2 - 1
    points[:, 2] = 0
    up = torch.tensor([1.0, 1.0, 5.0], dtype=torch.float64)
    answer = decal(surface, p, up, 0.5, points)
    y = up[:2] / up[:2].norm()
    axes = torch.stack((torch.stack((y[1], -y[0])), y), -1)
    expected = points[:, :2] @ axes / 0.5 + 0.5
    inside = ((expected >= 0) & (expected <= 1)).all(-1)
    assert torch.equal(answer.inside, inside)
    torch.testing.assert_close(answer.uv[inside], expected[inside])


def test_a_large_decal_wraps_around_a_cylinder():
    points, unrolled = cylinder_points()
    p = torch.tensor([0.5, 0, 0], dtype=torch.float64)
    up = torch.tensor([0.0, 0, 1], dtype=torch.float64)
    answer = decal(Exact(Cylinder(0.5)), p, up, 1.4, points)
    inside = (unrolled.abs() < 0.69).all(-1)
    assert bool(answer.inside[inside].all())
    uv = unrolled[inside] / 1.4 + 0.5
    torch.testing.assert_close(answer.uv[inside], uv, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"depth": -1}, "depth must be at least 0, got -1"),
        ({"radius": 0.0}, "radius must be positive"),
        ({"p": torch.zeros(2, 3)}, r"p must be one point \(3,\), got \(2, 3\)"),
    ],
)
def test_bad_arguments_are_named(options, words):
    with pytest.raises(ValueError, match=words):
        stitch_log(**{"surface": Exact(), "p": unit(0, 0, 1), "points": sphere_points(9)} | options)


def test_bad_decals_are_refused():
    p, points = unit(0, 0, 1), sphere_points(9)
    with pytest.raises(ValueError, match="size must be positive, got 0"):
        decal(Exact(), p, unit(1, 0, 0), 0, points)
    with pytest.raises(ValueError, match="up must have a part in the tangent plane"):
        decal(Exact(), p, p, 0.3, points)
