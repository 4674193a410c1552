"""Laws of the tangent-space operators, on surfaces whose maps are exact and on encoded clouds."""

import contextlib
import math

import pytest
import torch
from exact import Exact, sphere_points, tangents, unit
from references import fibonacci_sphere
from torch.autograd import gradcheck

from riemlayer import ExpLogField
from riemlayer.calculus import nearest_isometry
from riemlayer.data.closed_form import Cylinder, Plane

SPHERE = Exact()


def test_distances_on_the_sphere_are_angles():
    p, q = sphere_points(5), sphere_points(7)
    angles = (p @ q.T).clamp(-1, 1).acos()
    torch.testing.assert_close(SPHERE.cdist(p, q), angles)
    torch.testing.assert_close(SPHERE.dist(p[:, None], q), angles)


def test_a_distance_is_never_shorter_than_the_chord():
    class Short(Exact):
        def decode_log(self, p, q, shape=None):
            return 0.1 * self.surface.log(p, q), q[..., 0]

    p, q = sphere_points(2, 9)
    torch.testing.assert_close(Short().dist(p, q), (q - p).norm(dim=-1))


def test_a_distance_has_a_finite_gradient_at_coincident_points():
    p = sphere_points(3).requires_grad_()
    SPHERE.dist(p, p.detach()).sum().backward()
    assert p.grad is not None and bool(p.grad.isfinite().all())


def test_frames_are_right_handed_orthonormal_and_end_with_the_normal():
    p = sphere_points(200)
    p[:4] = torch.tensor([[0, 0, 1], [0, 0, -1], [1, 0, 0], [0.6, 0.8, 0]], dtype=torch.float64)
    frame = SPHERE.frame(p)
    eye = torch.eye(3, dtype=torch.float64).expand_as(frame)
    torch.testing.assert_close(frame.mT @ frame, eye)
    torch.testing.assert_close(torch.linalg.det(frame), torch.ones(200, dtype=torch.float64))
    torch.testing.assert_close(frame[..., 2], p)


def test_coordinates_and_vectors_are_each_others_inverse():
    p = sphere_points(20)
    v, x = tangents(SPHERE, p), torch.randn(20, 2, dtype=torch.float64)
    torch.testing.assert_close(SPHERE.from_2d(p, SPHERE.to_2d(p, v)), v)
    torch.testing.assert_close(SPHERE.to_2d(p, SPHERE.from_2d(p, x)), x)
    torch.testing.assert_close(SPHERE.to_2d(p, v).norm(dim=-1), SPHERE.norm(p, v))
    torch.testing.assert_close(SPHERE.inner(p, v), SPHERE.norm(p, v) ** 2)


@pytest.mark.parametrize("surface", [Exact(), Exact(Cylinder()), Exact(Plane())])
def test_a_geodesic_has_constant_speed_and_exact_ends(surface):
    generator = torch.Generator().manual_seed(1)
    p = surface.surface.sample(6, generator)
    q = surface.surface.exp(p, tangents(surface, p, 0.8))
    t = torch.linspace(0, 1, 11, dtype=p.dtype)[:, None]
    path = surface.geodesic(p, q, t)
    torch.testing.assert_close(path[0], p)
    torch.testing.assert_close(path[-1], q)
    pieces = surface.dist(path[:-1], path[1:])
    torch.testing.assert_close(pieces, torch.full_like(pieces, 0.08))


def test_both_ends_of_a_geodesic_are_exact_where_exp_is_not():
    class Short(Exact):
        def decode_exp(self, p, v, shape=None):
            return self.surface.exp(p, 0.9 * v), v.norm(dim=-1)

    p, q = sphere_points(2, 4)
    path = Short().geodesic(p, q, torch.tensor([[0.0], [1.0]], dtype=p.dtype))
    torch.testing.assert_close(path, torch.stack((p, q)))


@pytest.mark.parametrize("steps", [None, 3, 40])
def test_a_shot_around_the_sphere_comes_back_with_its_vector(steps):
    p = sphere_points(4)
    v = tangents(SPHERE, p, 2 * math.pi)
    shot = SPHERE.shoot(p, v, steps)
    torch.testing.assert_close(shot.point, p, rtol=0, atol=1e-9)
    torch.testing.assert_close(shot.vector, v, rtol=0, atol=1e-9)
    assert len(shot.path) == (steps or math.ceil(2 * math.pi / 0.25)) + 1


def test_a_shot_of_no_steps_is_refused():
    with pytest.raises(ValueError, match="steps must be at least 1, got 0"):
        SPHERE.shoot(sphere_points(1), torch.zeros(1, 3, dtype=torch.float64), 0)


@pytest.mark.parametrize("method", ["differential", "ladder"])
def test_transport_around_a_triangle_turns_by_its_area(method):
    """Holonomy (Gauss and Bonnet): an octant has area pi / 2."""
    a, b, c = (torch.eye(3, dtype=torch.float64)[i] for i in range(3))
    v = b.clone()
    for p, q in ((a, b), (b, c), (c, a)):
        v = SPHERE.transport(p, q, v, method=method)
    torch.testing.assert_close(v, torch.linalg.cross(a, b), rtol=0, atol=1e-9)


@pytest.mark.parametrize("method", ["differential", "ladder"])
@pytest.mark.parametrize("size", [0.2, 0.7, 1.2])
def test_the_holonomy_of_a_spherical_triangle_is_its_area(method, size):
    """Which is the excess of its angles over pi (Girard)."""
    a, log = sphere_points(1), SPHERE.surface.log
    v = tangents(SPHERE, a)
    side = math.cos(1.1) * v + math.sin(1.1) * torch.linalg.cross(a, v)
    b, c = (SPHERE.surface.exp(a, size * w) for w in (v, side))
    corners = ((a, b, c), (b, c, a), (c, a, b))
    area = sum(between(log(p, q), log(p, r)) for p, q, r in corners) - math.pi
    w = v
    for p, q, _ in corners:
        w = SPHERE.transport(p, q, w, method=method)
    assert between(v, w) == pytest.approx(area, abs=1e-7)


def between(v: torch.Tensor, w: torch.Tensor) -> float:
    """Angle of two vectors (1, 3)."""
    return float(torch.atan2(torch.linalg.cross(v, w).norm(), (v * w).sum()))


@pytest.mark.parametrize("method", ["differential", "ladder"])
@pytest.mark.parametrize("surface", [Exact(), Exact(Cylinder()), Exact(Plane())])
def test_transport_keeps_lengths_angles_and_the_geodesics_direction(method, surface):
    generator = torch.Generator().manual_seed(1)
    p = surface.surface.sample(8, generator)
    w, v = tangents(surface, p, 0.7), tangents(surface, p, 0.3)
    q = surface.surface.exp(p, w)
    ahead, moved = (surface.transport(p, q, x, method=method) for x in (w, v))
    torch.testing.assert_close(ahead, -surface.surface.log(q, p), rtol=0, atol=1e-7)
    torch.testing.assert_close(moved.norm(dim=-1), v.norm(dim=-1))
    torch.testing.assert_close((ahead * moved).sum(-1), (w * v).sum(-1), rtol=0, atol=1e-7)
    there_and_back = surface.transport(q, p, moved, method=method)
    torch.testing.assert_close(there_and_back, v, rtol=0, atol=1e-7)


def test_transport_to_where_one_is_changes_nothing():
    p = sphere_points(5)
    v = tangents(SPHERE, p)
    for method in ("differential", "ladder"):
        torch.testing.assert_close(SPHERE.transport(p, p, v, method=method), v, atol=1e-7, rtol=0)
    zero = torch.zeros_like(v)
    assert bool((SPHERE.transport(p, -p.roll(1, 0), zero).abs() < 1e-12).all())


def test_an_unknown_transport_is_refused():
    p = sphere_points(1)
    with pytest.raises(ValueError, match="must be 'differential' or 'ladder', got 'heat'"):
        SPHERE.transport(p, p, p, method="heat")


def test_the_nearest_isometry_minimises_the_distance():
    m = torch.randn(100, 2, 2, dtype=torch.float64)
    u, _, vh = torch.linalg.svd(m)
    torch.testing.assert_close(nearest_isometry(m), u @ vh)


def test_refinement_makes_log_the_inverse_of_exp():
    class Rough(Exact):
        def decode_log(self, p, q, shape=None):
            v, logit = super().decode_log(p, q)
            return self.project(p, v + 0.05 * torch.sin(7 * q)), logit

    surface, p = Rough(), sphere_points(30)
    v = tangents(SPHERE, p, 0.9)
    q = SPHERE.surface.exp(p, v)
    before = (surface.decode_log(p, q)[0] - v).norm(dim=-1)
    after = (surface.log_refined(p, q, steps=3) - v).norm(dim=-1)
    assert float(before.min()) > 1e-3 and float(after.max()) < 1e-6


def test_valid_queries_lie_before_the_cut_locus():
    p = unit(0, 0, 1)
    q = torch.stack((unit(0, 1, 1), unit(0, 0.01, -1)))
    assert SPHERE.valid_mask(p, q).tolist() == [True, False]


def test_the_injectivity_radius_is_where_validity_ends():
    class Small(Exact):
        def decode_exp(self, p, v, shape=None):
            return self.surface.exp(p, v), 0.3 - v.norm(dim=-1)

    p = sphere_points(3)
    assert SPHERE.injectivity_radius(p).tolist() == [0.5] * 3
    radius = Small().injectivity_radius(p, steps=20)
    assert bool(((radius > 0.3) & (radius <= 0.326)).all())


def test_gradcheck():
    p, q = sphere_points(2, 3)
    v = tangents(SPHERE, p, 0.4)
    assert gradcheck(SPHERE.transport, tuple(x.requires_grad_() for x in (p, q, v)))
    t = torch.rand(3, dtype=torch.float64)
    assert gradcheck(lambda a, b: SPHERE.geodesic(a, b, t), (p, q))
    assert gradcheck(SPHERE.dist, (p, q))
    assert gradcheck(lambda a, b: SPHERE.shoot(a, b, 2)[0], (p, v))


@pytest.fixture(scope="module")
def encoded():
    """Two spheres of different size in one packed batch, by an untrained field."""
    torch.manual_seed(0)
    field = ExpLogField.from_preset("tiny").eval()
    small = fibonacci_sphere(900).float()
    points = torch.cat((small, 3 * small + 5))
    batch = torch.arange(2).repeat_interleave(900)
    return field.encode(points, batch)


def test_normals_and_snapping_of_a_cloud_in_its_own_units(encoded):
    directions = torch.nn.functional.normalize(torch.randn(40, 3), dim=-1)
    for shape, (centre, radius) in enumerate(((0.0, 1.0), (5.0, 3.0))):
        surface, q = encoded[shape], centre + 1.04 * radius * directions
        normal = surface.normal(q)
        assert (normal * directions).sum(-1).abs().min() > 0.97
        snapped = surface.snap(q)
        off = (snapped - centre).norm(dim=-1) - radius
        assert float(off.abs().max()) < 0.015 * radius
        far = surface.snap(centre + 20 * radius * directions)
        assert float(((far - centre).norm(dim=-1) - radius).abs().max()) < 0.03 * radius
        index = torch.full((40,), shape)
        torch.testing.assert_close(encoded.snap(q, shape=index), snapped)
        torch.testing.assert_close(encoded.normal(q, shape=index), normal)


@pytest.mark.slow
def test_operators_of_a_packed_batch_are_those_of_its_shapes(encoded, monkeypatch):
    monkeypatch.setattr(ExpLogField, "half_precision", lambda self: contextlib.nullcontext())
    p, q = encoded.points[::300], encoded.points[1::300]
    shape = encoded.batch[::300]
    v = encoded.log(p, q, shape=shape)
    together = {
        "dist": encoded.dist(p, q, shape=shape),
        "frame": encoded.frame(p, shape=shape),
        "geodesic": encoded.geodesic(p, q, torch.full((6,), 0.4), shape=shape),
        "shoot": encoded.shoot(p, v, 2, shape=shape).point,
        "differential": encoded.transport(p, q, v, shape=shape),
        "ladder": encoded.transport(p, q, v, method="ladder", shape=shape),
        "log_refined": encoded.log_refined(p, q, shape=shape),
        "injectivity_radius": encoded.injectivity_radius(p, shape=shape),
    }
    for i, s in enumerate(shape.tolist()):
        surface, a, b, w = encoded[s], p[i], q[i], v[i]
        alone = {
            "dist": surface.dist(a, b),
            "frame": surface.frame(a),
            "geodesic": surface.geodesic(a, b, torch.tensor(0.4)),
            "shoot": surface.shoot(a, w, 2).point,
            "differential": surface.transport(a, b, w),
            "ladder": surface.transport(a, b, w, method="ladder"),
            "log_refined": surface.log_refined(a, b),
            "injectivity_radius": surface.injectivity_radius(a),
        }
        for name, x in alone.items():
            torch.testing.assert_close(together[name][i], x, rtol=1e-4, atol=1e-4, msg=name)
