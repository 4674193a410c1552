"""Means, principal directions and clusters, on surfaces whose maps are exact."""

import math

import pytest
import torch
from exact import Exact, sphere_points, tangents, unit
from torch.autograd import gradcheck

from riemlayer.data.closed_form import Plane
from riemlayer.ops import farthest_points, frechet_mean, kmeans, tangent_pca

SPHERE, PLANE = Exact(), Exact(Plane())


@pytest.mark.parametrize("gradient", ["unrolled", "implicit"])
def test_the_mean_of_symmetric_points_is_their_centre(gradient):
    centre = sphere_points(4)
    v = tangents(SPHERE, centre, 0.4)
    turned = torch.linalg.cross(centre, v)
    fan = torch.stack((v, turned, -v, -turned), -2)
    points = SPHERE.surface.exp(centre[:, None], fan)
    mean = frechet_mean(SPHERE, points, gradient=gradient)
    torch.testing.assert_close(mean, centre, rtol=0, atol=1e-9)


def test_the_mean_of_two_points_divides_their_geodesic_by_the_weights():
    p = sphere_points(5)
    q = SPHERE.surface.exp(p, tangents(SPHERE, p, 0.5))
    w = torch.tensor([0.25, 0.75], dtype=p.dtype)
    mean = frechet_mean(SPHERE, torch.stack((p, q), 1), w.expand(5, 2), steps=20)
    expected = SPHERE.geodesic(p, q, torch.full((5,), 0.75, dtype=p.dtype))
    torch.testing.assert_close(mean, expected, rtol=0, atol=1e-9)


def test_at_the_mean_the_logs_balance():
    p = unit(0.3, 0.2, 1)
    points = SPHERE.surface.exp(p, 0.4 * tangents(SPHERE, p.expand(9, 3)))
    w = torch.rand(9, dtype=p.dtype)
    mean = frechet_mean(SPHERE, points, w)
    balance = (w[:, None] * SPHERE.surface.log(mean, points)).sum(0)
    assert float(balance.norm()) < 1e-9
    torch.testing.assert_close(frechet_mean(SPHERE, points, 7 * w), mean)
    order = torch.randperm(9)
    torch.testing.assert_close(frechet_mean(SPHERE, points[order], w[order]), mean)


def test_on_a_plane_it_is_the_weighted_average():
    points = torch.randn(3, 6, 3, dtype=torch.float64) * 0.1
    points[..., 2] = 0
    w = torch.rand(3, 6, dtype=torch.float64)
    expected = (w[..., None] * points).sum(-2) / w.sum(-1, keepdim=True)
    torch.testing.assert_close(frechet_mean(PLANE, points, w, steps=30), expected)


def test_both_gradients_agree_and_are_right():
    p = unit(0.3, 0.2, 1)
    points = SPHERE.surface.exp(p, 0.3 * tangents(SPHERE, p.expand(4, 3))).requires_grad_()
    w = torch.rand(4, dtype=p.dtype).requires_grad_()

    def mean(points, w, gradient):
        points = torch.nn.functional.normalize(points, dim=-1)
        return frechet_mean(SPHERE, points, w, steps=25, gradient=gradient)

    assert gradcheck(lambda *x: mean(*x, "implicit"), (points, w), atol=1e-6)
    assert gradcheck(lambda *x: mean(*x, "unrolled"), (points, w), atol=1e-6)


def test_coincident_points_have_a_mean_and_gradients():
    points = unit(0, 0.3, 1).expand(3, 3).clone().requires_grad_()
    mean = frechet_mean(SPHERE, points)
    torch.testing.assert_close(mean, points[0])
    mean.sum().backward()
    assert points.grad is not None and bool(points.grad.isfinite().all())


def test_principal_directions_of_an_elongated_set():
    p, along = unit(0, 0, 1), unit(0.6, 0.8, 0)
    across = torch.linalg.cross(p, along)
    s = torch.linspace(-0.4, 0.4, 9, dtype=p.dtype)[:, None]
    points = SPHERE.surface.exp(p, torch.cat((s * along, 0.2 * s * across)))
    answer = tangent_pca(SPHERE, points)
    torch.testing.assert_close(answer.mean, p, rtol=0, atol=1e-9)
    torch.testing.assert_close((answer.directions[:, 0] * along).sum().abs(), p[2])
    torch.testing.assert_close(answer.variances[0], s.square().mean() / 2)
    torch.testing.assert_close(answer.variances[1], 0.04 * s.square().mean() / 2)


def test_clusters_are_those_that_were_made():
    centres = torch.stack((unit(1, 0, 0), unit(0, 1, 0), unit(0, 0, -1)))
    points = SPHERE.surface.exp(
        centres[:, None], 0.2 * tangents(SPHERE, centres[:, None].expand(3, 20, 3))
    )
    found = kmeans(SPHERE, points.flatten(0, 1), 3, seed=4)
    label = found.label.view(3, 20)
    assert all(len(row.unique()) == 1 for row in label) and len(label[:, 0].unique()) == 3
    gap = SPHERE.cdist(found.centres, centres).amin(0)
    assert float(gap.max()) < 0.1
    assert float(found.distance.max()) < 0.35


def test_lloyds_steps_bring_points_nearer_to_their_centres():
    points = sphere_points(400)
    before, after = (
        kmeans(SPHERE, points, 12, steps=steps).distance.square().mean() for steps in (0, 15)
    )
    assert float(after) < 0.9 * float(before)


def test_farthest_points_are_apart():
    points = sphere_points(500)
    chosen = farthest_points(SPHERE, points, 6, seed=1)
    apart = SPHERE.cdist(points[chosen], points[chosen]) + 9 * torch.eye(6)
    assert float(apart.min()) > math.pi / 3
    assert torch.equal(chosen, farthest_points(SPHERE, points, 6, seed=1))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda x: frechet_mean(SPHERE, x[:0]), r"K >= 1, got \(0, 3\)"),
        (lambda x: frechet_mean(SPHERE, x, -torch.ones(4)), "weights must be at least 0"),
        (lambda x: frechet_mean(SPHERE, x, torch.zeros(4)), "not all 0"),
        (lambda x: frechet_mean(SPHERE, x, gradient="none"), "gradient must be 'unrolled'"),
        (lambda x: kmeans(SPHERE, x, 5), r"k must lie in \[1, 4\] \(the points\), got 5"),
    ],
)
def test_bad_arguments_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call(sphere_points(4))
