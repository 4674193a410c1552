"""Poor clouds and places get finite answers, flagged where they are not to be relied on.

Off the surface, across gaps, at coincident points, copies, empty neighbourhoods.
"""

import math

import pytest
import torch
from exact import Exact, sphere_points, tangents
from references import fibonacci_sphere, finite, lumpy, packed, shaken

from riemlayer import ExpLogField
from riemlayer.ops import decal, frechet_mean, kmeans, local_geometry, stitch_log, tangent_pca

POINTS = lumpy(120)
P, V = POINTS[:4], 0.2 * torch.randn(4, 3, dtype=torch.float64)


@pytest.fixture(scope="module")
def surface():
    torch.manual_seed(0)
    with torch.no_grad():
        return shaken("tiny", strength=0.3).encode(POINTS)


@pytest.fixture(scope="module")
def base():
    return ExpLogField.from_pretrained("base").eval()


@pytest.mark.slow
def test_from_off_the_surface_nothing_is_valid(base):
    points = fibonacci_sphere(700).float()
    surface = base.encode(points).detach()
    p, q = points[:20], surface.exp(points[:20], 0.2 * surface.frame(points[:20])[..., 0])
    assert bool(surface.valid_mask(p, q).all()) and bool(surface.in_support(p).all())
    for off in (1.5 * p, 40 * p):
        assert not bool(surface.in_support(off).any())
        assert not bool(surface.valid_mask(off, q).any())
        assert bool((surface.injectivity_radius(off) == 0).all())
        assert not bool(stitch_log(surface, off[0], points).covered.any())
        assert not bool(
            decal(surface, off[0], torch.tensor([0.3, 0.5, 0.7]), 0.3, points).inside.any()
        )
        for method in ("differential", "ladder"):
            assert finite(surface.transport(off, q, p, method=method))
        assert finite(surface.log_refined(off, q)) and finite(surface.shoot(off, q))
        assert finite(frechet_mean(surface, off)) and finite(kmeans(surface, off, 3))


# ----------------------------------------------------------------------------------- disconnected


@pytest.fixture(scope="module")
def islands(base):
    """A sphere, a smaller one that comes near it, and a crumb of five points."""
    sphere = fibonacci_sphere(1500).float()
    crumb = fibonacci_sphere(5).float()
    x = torch.tensor([1.0, 0, 0])
    points = torch.cat((0.4 * sphere - 0.5 * x, 0.3 * sphere[::2] + 0.4 * x, 0.02 * crumb + x))
    label = torch.tensor([0, 1, 2]).repeat_interleave(torch.tensor([1500, 750, 5]))
    return base.encode(points).detach(), label


@pytest.mark.slow
def test_no_edge_across_a_gap_is_valid(islands):
    surface, label = islands
    for k, radius in ((16, None), (3, None), (16, 0.3)):
        geometry = local_geometry(surface, k, radius)
        sender, receiver = geometry.edge_index
        across = label[sender] != label[receiver]
        assert bool(across.any()) or k == 3
        assert not bool(geometry.valid[across].any())
        assert float(geometry.valid[~across].float().mean()) > 0.95
        assert bool((geometry.weight[across] == 0).all()) and finite(tuple(geometry))


def test_what_a_gap_divides_is_not_valid(islands):
    surface, label = islands
    near = torch.cdist(surface.points[label == 0], surface.points[label == 1])
    i, j = (near < 0.4).nonzero()[::20].unbind(-1)
    p, q = surface.points[i], surface.points[1500 + j]
    assert len(p) > 50 and float(surface.valid_mask(p, q).float().mean()) < 0.02
    assert finite(surface.dist(p, q)) and finite(surface.transport(p, q, q - p))


def test_a_stitched_map_does_not_jump_a_gap(islands):
    surface, label = islands
    nearest = int(surface.points[:1500, 0].argmax())
    stitched = stitch_log(surface, surface.points[nearest], surface.points, depth=2)
    assert float(stitched.covered[label == 0].float().mean()) > 0.3
    assert float(stitched.covered[label == 1].float().mean()) < 0.02
    assert finite(tuple(stitched)[:3])


# ------------------------------------------------------------------------------------- degenerate


@pytest.mark.parametrize("method", ["differential", "ladder"])
def test_zero_vectors_stay_zero_with_finite_gradients(method):
    p = sphere_points(4)
    q = Exact().surface.exp(p, tangents(Exact(), p, 0.4))
    v = torch.zeros_like(p, requires_grad=True)
    carried = Exact().transport(p, q, v, method=method)
    assert bool((carried.abs() < 1e-12).all())
    carried.sum().backward()
    assert v.grad is not None and bool(v.grad.isfinite().all())


def test_operators_at_coincident_points_have_finite_values_and_gradients(surface):
    p = P.clone().requires_grad_()
    q = P.clone().requires_grad_()
    zero = torch.zeros_like(P, requires_grad=True)
    answers = (
        surface.dist(p, q),
        surface.geodesic(p, q, torch.full((4,), 0.5, dtype=P.dtype)),
        surface.transport(p, q, V),
        surface.transport(p, q, V, method="ladder"),
        surface.log_refined(p, q),
        *surface.shoot(p, zero, 2),
        *surface.advance(p, zero),
    )
    assert finite(answers)
    torch.stack([x.sum() for x in answers]).sum().backward()
    assert all(x.grad is not None and finite(x.grad) for x in (p, q, zero))


@pytest.mark.parametrize("copies", [1, 5])
def test_points_in_one_place_have_a_mean_and_axes_and_finite_gradients(surface, copies):
    points = P[0].expand(copies, 3).clone().requires_grad_()
    answer = tangent_pca(surface, points)
    axes = answer.directions
    torch.testing.assert_close(axes.mT @ axes, torch.eye(2).double())
    assert float(answer.variances.detach().max()) < 1e-3
    (answer.variances.sum() + axes.sum() + answer.mean.sum()).backward()
    assert points.grad is not None and finite(points.grad)


def test_principal_axes_are_those_of_eigh():
    points = Exact().surface.exp(
        sphere_points(1), 0.3 * tangents(Exact(), sphere_points(1).expand(7, 3))
    )
    points = torch.nn.functional.normalize(points + 0.2 * torch.randn(5, 7, 3).double(), dim=-1)
    answer = tangent_pca(Exact(), points)
    log = Exact().surface.log(answer.mean[:, None], points)
    values, vectors = torch.linalg.eigh(log.mT @ log / 7)
    torch.testing.assert_close(answer.variances, values.flip(-1)[:, :2])
    along = (answer.directions * vectors.flip(-1)[..., :2]).sum(-2).abs()
    torch.testing.assert_close(along, torch.ones_like(along))


@pytest.mark.parametrize("gradient", ["unrolled", "implicit"])
def test_points_without_one_mean_have_a_finite_answer(gradient):
    """Nearly opposite points of the sphere: Log of the one at the other is beyond any radius."""
    p = sphere_points(3)
    other = Exact().surface.exp(p, tangents(Exact(), p, math.pi - 0.05))
    points = torch.stack((p, other), 1).requires_grad_()
    mean = frechet_mean(Exact(), points, gradient=gradient)
    assert finite(mean) and bool(((mean.norm(dim=-1) - 1).abs() < 0.3).all())
    mean.sum().backward()
    assert points.grad is not None and finite(points.grad)


def test_clusters_of_coincident_points(surface):
    points = P[:2].repeat(6, 1)
    found = kmeans(surface, points, 4)
    assert finite(tuple(found)) and bool((found.distance < 0.2).all())
    assert len(found.label[0::2].unique()) == 1


@pytest.mark.slow
@pytest.mark.parametrize("repeats", [2, 12])
def test_edges_of_a_cloud_of_copies(base, repeats):
    """As vertices of a triangle soup: each several times. So far apart, each needs fans: with
    gradients about 8 MB a source."""
    points = fibonacci_sphere(80).float().repeat(repeats, 1).requires_grad_()
    geometry = local_geometry(base.encode(points), k=3 * repeats)
    assert finite(tuple(geometry)) and float(geometry.valid.float().mean()) > 0.95
    total = geometry.log.sum() + geometry.theta.sum() + geometry.transport.sum()
    (total + geometry.weight.square().sum()).backward()
    assert points.grad is not None and finite(points.grad)


def test_a_packed_surface_that_lost_a_cloud_still_has_edges():
    surface = shaken("tiny").encode(*packed(lumpy(60), lumpy(70)))
    left = surface.at(torch.arange(60, 130))
    geometry = local_geometry(left, k=5)
    assert geometry.edge_index.shape == (2, 350) and finite(tuple(geometry))


def test_thousands_of_empty_neighbourhoods_take_no_time(base):
    surface = base.encode(fibonacci_sphere(3000).float()).detach()
    geometry = local_geometry(surface, radius=1e-6)
    assert geometry.edge_index.shape == (2, 0) and finite(tuple(geometry))
    assert bool((geometry.frame[:, 2, 2] >= 0).all())  # nobody agrees with anybody: upwards
