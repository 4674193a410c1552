"""An encoded surface where geoopt and flow-matching code expect a manifold."""

import sys

import geoopt
import pytest
import torch
from exact import Exact, sphere_points, tangents, unit

from riemlayer.adapters import FlowManifold, geoopt_manifold

SPHERE = Exact()


def test_it_is_geoopts_own_sphere():
    ours, theirs = geoopt_manifold(SPHERE), geoopt.Sphere()
    x = sphere_points(6)
    u, v = tangents(SPHERE, x, 0.6), tangents(SPHERE, x, 0.3)
    y = theirs.expmap(x, u)
    torch.testing.assert_close(ours.expmap(x, u), y)
    torch.testing.assert_close(ours.logmap(x, y), u)
    torch.testing.assert_close(ours.dist(x, y), theirs.dist(x, y))
    carried = ours.transp(x, y, v)  # theirs projects, which shortens
    torch.testing.assert_close(carried.norm(dim=-1), v.norm(dim=-1))
    torch.testing.assert_close(ours.transp(x, y, u), -theirs.logmap(y, x), rtol=0, atol=1e-7)
    torch.testing.assert_close(ours.inner(x, u, v), (u * v).sum(-1))
    torch.testing.assert_close(ours.norm(x, u), u.norm(dim=-1))
    torch.testing.assert_close(ours.projx(2 * x), x)
    torch.testing.assert_close(ours.proju(x, u + x), u)
    torch.testing.assert_close(ours.egrad2rgrad(x, u + x), u)
    assert ours.inner(x, u, keepdim=True).shape == ours.dist(x, y, keepdim=True).shape == (6, 1)


def test_geoopt_checks_points_and_vectors_by_it():
    manifold, x = geoopt_manifold(SPHERE), sphere_points(3)
    manifold.assert_check_point_on_manifold(x)
    manifold.assert_check_vector_on_tangent(x, tangents(SPHERE, x))
    with pytest.raises(ValueError, match="call projx first"):
        manifold.assert_check_point_on_manifold(1.1 * x)
    with pytest.raises(ValueError, match="call proju first"):
        manifold.assert_check_vector_on_tangent(x, x)


def test_geoopts_optimiser_walks_to_the_nearest_point():
    goal = unit(0.2, 0.1, 1)
    x = geoopt.ManifoldParameter(unit(1, 0.3, 0.2), manifold=geoopt_manifold(SPHERE))
    optimiser = geoopt.optim.RiemannianSGD([x], lr=0.2)
    for _ in range(60):
        optimiser.zero_grad()
        (x - goal).square().sum().backward()
        optimiser.step()
    torch.testing.assert_close(x.detach(), goal, rtol=0, atol=1e-6)


def test_the_four_methods_make_a_geodesic_interpolant():
    """What conditional flow matching does: x_t = Exp_x(t Log_x(y)), and its velocity."""
    manifold = FlowManifold(SPHERE)
    x = sphere_points(5)
    y = SPHERE.surface.exp(x, tangents(SPHERE, x, 0.8))
    t = torch.tensor(0.25, dtype=x.dtype, requires_grad=True)
    xt = manifold.expmap(x, t * manifold.logmap(x, y))
    torch.testing.assert_close(SPHERE.dist(x, xt), torch.full((5,), 0.2, dtype=x.dtype))
    torch.testing.assert_close(manifold.projx(1.3 * xt), xt)
    torch.testing.assert_close(manifold.proju(x, x), torch.zeros_like(x))
    assert torch.autograd.grad(xt.sum(), t)[0].isfinite()
    assert not list(manifold.parameters())


def test_without_geoopt_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "geoopt.manifolds.base", None)
    with pytest.raises(ImportError, match="pip install geoopt"):
        geoopt_manifold(SPHERE)
