"""Laws of Exp and Log on the closed-form surfaces, in float64."""

import math
from itertools import pairwise

import pytest
import torch

from riemlayer.data.closed_form import Cylinder, Plane, Sphere, Torus

WITH_LOG = [Plane(), Sphere(), Sphere(0.4), Cylinder(), Cylinder(0.6, 2.0)]
ALL = [*WITH_LOG, Torus(steps=16), Torus(1.0, 0.5, steps=16)]


def tangent(surface, n=200, longest=1.0):
    """Points and tangent vectors of length up to `longest`."""
    generator = torch.Generator().manual_seed(1)
    p = surface.sample(n, generator)
    v = torch.randn(n, 3, generator=generator, dtype=torch.float64)
    v = surface.project_to_tangent(p, v)
    length = longest * torch.rand(n, 1, generator=generator, dtype=torch.float64)
    return p, length * v / v.norm(dim=-1, keepdim=True)


def off_surface(surface, x):
    """How far points are from the surface."""
    if isinstance(surface, Plane):
        return x[..., 2].abs()
    if isinstance(surface, Sphere):
        return (x.norm(dim=-1) - surface.radius).abs()
    around = x[..., :2].norm(dim=-1)
    if isinstance(surface, Cylinder):
        return (around - surface.radius).abs()
    return (torch.hypot(around - surface.major, x[..., 2]) - surface.minor).abs()


@pytest.mark.parametrize("surface", WITH_LOG, ids=repr)
def test_log_undoes_exp_before_the_cut_locus(surface):
    p, v = tangent(surface, longest=0.95 * math.pi * getattr(surface, "radius", 1.0))
    torch.testing.assert_close(surface.log(p, surface.exp(p, v)), v, rtol=0, atol=1e-10)


@pytest.mark.parametrize("surface", WITH_LOG, ids=repr)
def test_exp_undoes_log(surface):
    p, q = surface.sample(300, torch.Generator().manual_seed(2)).chunk(2)
    torch.testing.assert_close(surface.exp(p, surface.log(p, q)), q, rtol=0, atol=1e-10)


@pytest.mark.parametrize("surface", WITH_LOG, ids=repr)
def test_log_is_tangent_and_no_shorter_than_the_chord(surface):
    p, q = surface.sample(300, torch.Generator().manual_seed(3)).chunk(2)
    v = surface.log(p, q)
    assert (v * surface.normal(p)).sum(-1).abs().max() < 1e-12
    assert (v.norm(dim=-1) - (q - p).norm(dim=-1)).min() > -1e-12


@pytest.mark.parametrize("surface", ALL, ids=repr)
def test_samples_and_exp_lie_on_the_surface(surface):
    p, v = tangent(surface)
    assert off_surface(surface, p).max() < 1e-12
    assert off_surface(surface, surface.exp(p, v)).max() < 1e-12


@pytest.mark.parametrize("surface", ALL, ids=repr)
def test_normal_is_the_unit_gradient_of_the_distance(surface):
    p, _ = tangent(surface, 50)
    n = surface.normal(p)
    torch.testing.assert_close(n.norm(dim=-1), torch.ones(50, dtype=torch.float64))
    step = 1e-4
    if isinstance(surface, Plane):
        assert (n[:, 2] == 1).all()
    torch.testing.assert_close(
        off_surface(surface, p + step * n), torch.full((50,), step, dtype=torch.float64)
    )


@pytest.mark.parametrize("surface", ALL, ids=repr)
def test_exp_of_zero_is_p_and_its_differential_the_identity(surface):
    p, v = tangent(surface, 20)
    zero = torch.zeros_like(v)
    torch.testing.assert_close(surface.exp(p, zero), p, rtol=0, atol=1e-14)
    _, moved = torch.autograd.functional.jvp(lambda x: surface.exp(p, x), zero, v)
    torch.testing.assert_close(moved, v, rtol=0, atol=1e-12)


@pytest.mark.parametrize("surface", WITH_LOG, ids=repr)
def test_log_of_p_is_zero_and_its_differential_the_identity(surface):
    p, v = tangent(surface, 20)
    torch.testing.assert_close(surface.log(p, p), torch.zeros_like(p), rtol=0, atol=1e-14)
    _, moved = torch.autograd.functional.jvp(lambda x: surface.log(p, x), p, v)
    torch.testing.assert_close(moved, v, rtol=0, atol=1e-12)


@pytest.mark.parametrize("surface", ALL, ids=repr)
def test_gradients_are_right(surface):
    p, v = (x.requires_grad_() for x in tangent(surface, 2, longest=0.8))
    assert torch.autograd.gradcheck(surface.exp, (p, v), fast_mode=True)


@pytest.mark.parametrize("surface", WITH_LOG, ids=repr)
def test_gradients_of_log_are_right(surface):
    p, v = tangent(surface, 3, longest=0.8)
    q = surface.exp(p, v).detach()
    assert torch.autograd.gradcheck(surface.log, (p.requires_grad_(), q.requires_grad_()))


@pytest.mark.parametrize("surface", ALL, ids=repr)
def test_broadcasts_like_a_loop(surface):
    p, v = tangent(surface, 12)
    p = p[:4]
    fan = surface.project_to_tangent(p[:, None], v[None])
    together = surface.exp(p[:, None], fan)
    for i in range(4):
        torch.testing.assert_close(together[i], surface.exp(p[i].expand(12, 3), fan[i]))


@pytest.mark.parametrize("surface", [Sphere(), Torus()], ids=repr)
def test_samples_are_uniform_by_area(surface):
    p = surface.sample(20_000, torch.Generator().manual_seed(4))
    assert p.shape == (20_000, 3)
    if isinstance(surface, Sphere):  # Archimedes: z is uniform, its square has mean R^2 / 3
        assert abs(p[:, 2].square().mean() - surface.radius**2 / 3) < 0.01
    else:  # Pappus: the mean distance from the axis is R + r^2 / (2 R)
        expected = surface.major + surface.minor**2 / (2 * surface.major)
        assert abs(p[:, :2].norm(dim=-1).mean() - expected) < 0.005


def test_sphere_geodesics_meet_at_the_antipode():
    p, v = tangent(Sphere(), 20)
    v = math.pi * v / v.norm(dim=-1, keepdim=True)
    torch.testing.assert_close(Sphere().exp(p, v), -p, rtol=0, atol=1e-12)


def test_torus_geodesics_split_anywhere():
    """Exp(p, v) = Exp(Exp(p, v/2), half the velocity there): the end point is on one geodesic."""
    torus = Torus(steps=256)
    p, v = tangent(torus, 20)
    middle = torus.exp(p, v / 2)
    step = 1e-5
    speed = (torus.exp(p, v * (0.5 + step)) - torus.exp(p, v * (0.5 - step))) / (2 * step)
    torch.testing.assert_close(speed.norm(dim=-1), v.norm(dim=-1), rtol=1e-8, atol=0)
    torch.testing.assert_close(torus.exp(middle, speed / 2), torus.exp(p, v), rtol=0, atol=1e-8)


def test_torus_steps_are_of_fourth_order():
    p, v = tangent(Torus(), 50, longest=2.0)
    exact = Torus(steps=512).exp(p, v)
    errors = [(Torus(steps=n).exp(p, v) - exact).norm(dim=-1).mean() for n in (16, 32, 64)]
    orders = [math.log2(a / b) for a, b in pairwise(errors)]
    assert all(3.7 < order < 4.5 for order in orders), orders
