"""Geodesic walking: straight on planes, round on spheres, isometric, exact at the start."""

import itertools
import math

import pytest
import torch
from references import fibonacci_sphere, go, lumpy, planes_of
from torch import Tensor

from riemlayer.data.closed_form import Cylinder, Sphere
from riemlayer.geometry import Walked, local_planes, planes_at_scales, turn, walk
from riemlayer.geometry.planes import LocalPlanes
from riemlayer.geometry.walk import advance
from riemlayer.octree import build_octree


def tangents(n: Tensor, length: float) -> Tensor:
    """One vector of that length at each point, orthogonal to the unit normals `n`."""
    v = torch.linalg.cross(n, torch.randn_like(n))
    return length * v / v.norm(dim=-1, keepdim=True)


@pytest.fixture(scope="module")
def sphere() -> LocalPlanes:
    return planes_of(fibonacci_sphere(20_000))


def test_on_a_plane_a_walk_is_straight():
    turned = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64))[0]
    points = (torch.rand(20_000, 3, dtype=torch.float64) - 0.5) * torch.tensor([1.0, 1, 0])
    planes = planes_of(points @ turned.T, 5)
    n = turned[:, 2].expand(100, 3)
    p, v = (0.2 * points[:100]) @ turned.T, tangents(n, 0.3)
    for steps in (1, 4, 8):
        end = go(planes, p, v, steps)
        torch.testing.assert_close(end.point, p + v, rtol=0, atol=1e-9)
        torch.testing.assert_close(end.vector, v, rtol=0, atol=1e-9)
        assert ((end.normal * n).sum(-1).abs() > 1 - 1e-9).all()


@pytest.mark.parametrize("surface", [Sphere(), Cylinder(0.5)], ids=repr)
def test_a_walk_is_close_to_the_closed_form(surface):
    points = surface.sample(30_000, torch.Generator().manual_seed(0))
    planes = planes_of(points)
    p = points[points[:, 2].abs() < 0.4][:200]  # away from the cylinder's ends
    v = tangents(surface.normal(p), 0.5)
    exact = surface.exp(p, v)
    error = (go(planes, p, v).point - exact).norm(dim=-1)
    straight = (p + v - exact).norm(dim=-1)
    assert error.mean() < straight.mean() / 30 and error.max() < straight.max() / 20


def test_error_falls_at_least_with_the_square_of_the_number_of_steps(sphere):
    p = fibonacci_sphere(400)
    v = tangents(p, 1.0)
    limit = go(sphere, p, v, 256).point
    errors = [float((go(sphere, p, v, n).point - limit).norm(dim=-1).mean()) for n in (2, 4, 8, 32)]
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert orders[0] > 1.7 and orders[1] > 2 and orders[2] > 2, (errors, orders)
    assert float((limit - Sphere().exp(p, v)).norm(dim=-1).mean()) < 1e-3  # of the planes


@pytest.mark.parametrize("radius", [0.15, 0.3])
def test_chords_of_a_bending_geodesic_are_closer_than_steps_straight_ahead(radius):
    surface = Cylinder(radius)
    points = surface.sample(30_000, torch.Generator().manual_seed(0)).double()
    planes = planes_of(points)
    p = points[points[:, 2].abs() < 0.4][:300]
    v, place = tangents(surface.normal(p), 0.5), torch.zeros(300, dtype=torch.long)
    at, site = Walked.starting(p, v, planes.plane(p, place)[0]), planes.site(place)
    for _ in range(12):
        at, _ = advance(planes, at, site, torch.full_like(v[:, :1], 1 / 12))
    exact = surface.exp(p, v)
    straight, chords = (x.point - exact for x in (at, walk(planes, p, v, place, 12)))
    assert chords.norm(dim=-1).mean() < straight.norm(dim=-1).mean() / 3


def test_transport_is_isometric_and_ends_along_the_geodesic(sphere):
    p = fibonacci_sphere(200)
    v = tangents(p, 0.5)
    end = go(sphere, p, v)
    torch.testing.assert_close(end.vector.norm(dim=-1), v.norm(dim=-1), rtol=0, atol=1e-3)
    assert (end.vector * end.normal).sum(-1).abs().max() < 1e-3
    exact = -math.sin(0.5) * 0.5 * p + math.cos(0.5) * v
    torch.testing.assert_close(end.vector, exact, rtol=0, atol=0.02)


def test_a_walk_is_reversible(sphere):
    p = fibonacci_sphere(200)
    v = tangents(p, 0.5)
    end = go(sphere, p, v)
    back = go(sphere, end.point, -end.vector)
    assert (back.point - p).norm(dim=-1).max() < 0.01


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_at_zero_a_walk_is_exact_with_the_identity_as_differential(dtype):
    points = lumpy(300).to(dtype)
    planes = planes_of(points, 5)
    p = torch.cat((points[:20], torch.randn(20, 3, dtype=dtype)))  # on the cloud and off it
    zero = torch.zeros_like(p)
    assert torch.equal(go(planes, p, zero).point, p)
    for axis in torch.eye(3, dtype=dtype):
        _, moved = torch.func.jvp(lambda v: go(planes, p, v).point, (zero,), (axis.expand(40, 3),))
        assert torch.equal(moved, axis.expand(40, 3))


def test_the_departure_from_the_straight_line_starts_with_the_square():
    """|walk(p, v) - p - v| falls at least with |v|^2 even where p lies off the cloud."""
    planes = planes_of(lumpy(2000), 5)
    p, v = 1.01 * lumpy(50), torch.randn(50, 3, dtype=torch.float64)
    errors = []
    for t in (1e-2, 1e-3, 1e-4):
        errors.append(float((go(planes, p, t * v).point - p - t * v).norm(dim=-1).max()))
    assert errors[1] < errors[0] / 50 and errors[2] < errors[1] / 50, errors


def test_where_there_is_no_plane_a_walk_goes_straight_on():
    planes = planes_of(0.2 * fibonacci_sphere(500))
    p = torch.tensor([[0.8, 0.8, 0.8], [-0.9, 0.0, 0.0]], dtype=torch.float64)
    v = torch.tensor([[0.1, 0.0, -0.2], [0.0, 0.3, 0.1]], dtype=torch.float64)
    end = go(planes, p, v)
    torch.testing.assert_close(end.point, p + v, rtol=0, atol=1e-10)
    torch.testing.assert_close(end.vector.norm(dim=-1), v.norm(dim=-1))


def test_turn_is_a_rotation_that_takes_one_normal_to_the_other():
    n, m = torch.nn.functional.normalize(torch.randn(2, 200, 3, dtype=torch.float64), dim=-1)
    m = torch.where((n * m).sum(-1, keepdim=True) > -0.7, m, -m)  # short of opposite normals
    w = tangents(n, 0.7)
    turned = turn(w, n, m)
    torch.testing.assert_close(turned.norm(dim=-1), w.norm(dim=-1))
    torch.testing.assert_close((turned * m).sum(-1), torch.zeros(200).double())
    axis = torch.linalg.cross(n, m)
    torch.testing.assert_close((turned * axis).sum(-1), (w * axis).sum(-1))  # about n x m
    torch.testing.assert_close(turn(turned, m, n), w)


def test_turn_between_opposite_normals_is_finite():
    n, w = torch.tensor([[0.0, 0, 1]]), torch.tensor([[1.0, 0, 0]])
    assert turn(w, n, -n).isfinite().all()


def test_a_batch_walks_on_its_own_shapes():
    """The same start and vector on two spheres of different sizes."""
    points = fibonacci_sphere(4000)
    both = torch.cat((points, 0.5 * points))
    batch = torch.arange(2).repeat_interleave(4000)
    planes = local_planes(both, build_octree(both, batch, 6))
    p = fibonacci_sphere(50)
    v = tangents(p, 0.4)
    starts = torch.cat((p, 0.5 * p))
    shape = torch.arange(2).repeat_interleave(50)
    together = walk(planes, starts, torch.cat((v, v)), shape)
    for i in range(2):
        mine = shape == i
        alone = go(planes_of(both[batch == i]), starts[mine], v)
        torch.testing.assert_close(together.point[mine], alone.point, rtol=0, atol=1e-12)


def test_gradcheck_in_starts_vectors_and_points():
    points = lumpy(80)
    p = (lumpy(4) * 1.01).requires_grad_()
    v = (0.2 * torch.randn(4, 3, dtype=torch.float64)).requires_grad_()

    def end(p: Tensor, v: Tensor, points: Tensor) -> Tensor:
        return torch.cat(go(planes_of(points, 4), p, v, 3), -1)

    assert torch.autograd.gradcheck(end, (p, v, points.requires_grad_()), fast_mode=True, atol=1e-4)


def test_gradients_at_zero_are_finite():
    points = lumpy(200, torch.float32).requires_grad_()
    p = points.detach()[:10].clone().requires_grad_()
    v = torch.zeros(10, 3, requires_grad=True)
    end = go(planes_of(points, 5), p, v)
    (end.point.sum() + end.vector.sum() + end.normal.sum()).backward()
    for x in (p, v, points):
        assert x.grad is not None and x.grad.isfinite().all()


def test_walks_over_several_scales_are_taken_together_as_alone():
    points = lumpy(3000)
    octree = build_octree(points, torch.zeros(3000, dtype=torch.long), 6)
    planes = planes_at_scales(points, octree, (1, 0, 2), rims=2)
    p = points[:40].repeat(3, 1)
    v = 0.4 * torch.nn.functional.normalize(torch.randn(120, 3).double(), dim=-1)
    place = planes.places(torch.zeros(40, dtype=torch.long), 3)
    together = walk(planes, p, v, place, 12)
    for i, scale in enumerate(planes.scales):
        rows = slice(40 * i, 40 * (i + 1))
        alone = go(LocalPlanes.of([scale]), p[rows], v[rows], 12)
        for got, want in zip(together, alone, strict=True):
            torch.testing.assert_close(got[rows], want)
