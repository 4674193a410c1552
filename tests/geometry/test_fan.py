"""Log on a fan of walked geodesics: exact on planes, near on curved surfaces, a softmax of maps."""

import pytest
import torch
from references import fibonacci_sphere, lumpy, planes_of
from torch import Tensor

from riemlayer.data.closed_form import Cylinder, Sphere
from riemlayer.geometry import Fan, LocalPlanes, fan_of, lay_flat, log_on_fan
from riemlayer.geometry.fan import ABOVE, LENGTHS, REACH, SHORTER, WIDTH

RADIUS = 0.5


def fan_at(planes: LocalPlanes, p: Tensor, rays: int = 48, tangent: Tensor | None = None) -> Fan:
    shape = torch.zeros(len(p), dtype=torch.long)
    return fan_of(planes, p, shape, rays, RADIUS, tangent=tangent)


def points_of(fan: Fan) -> Tensor:
    """(S, F, 3) as seen from the sources."""
    return fan.values[..., 14:17]


def test_on_a_plane_a_chord_is_its_own_log():
    points = torch.rand(20_000, 3).double() - 0.5
    turned = torch.linalg.qr(torch.randn(3, 3).double())[0]
    points = (2 * points * torch.tensor([1.0, 1, 0])) @ turned.T
    p, x = 0.1 * points[:20], 0.4 * points[20:220].expand(20, 200, 3)
    read = log_on_fan(fan_at(planes_of(points, 5), p), x)
    torch.testing.assert_close(read.vector, x, rtol=0, atol=1e-9)
    assert (read.length.squeeze(-1) > x.norm(dim=-1) / (1 + SHORTER) - WIDTH).all()


@pytest.mark.parametrize("surface", [Sphere(0.5), Cylinder(0.35, 0.8)], ids=repr)
def test_the_fan_is_nearer_to_the_closed_form_than_the_flat_chord(surface):
    points = surface.sample(30_000, torch.Generator().manual_seed(0))
    planes = planes_of(points)
    p = points[points[:, 2].abs() < 0.2][:50]
    normal = surface.normal(p)[:, None].expand(50, 40, 3)
    v = torch.linalg.cross(normal, torch.randn_like(normal))
    v = v / v.norm(dim=-1, keepdim=True) * torch.linspace(0.1, RADIUS, 40)[:, None]
    x = surface.exp(p[:, None], v) - p[:, None]
    flat = lay_flat(
        planes.normal(p, torch.zeros(50, dtype=torch.long)), x, planes.fine.level.cell_size
    )
    error = (log_on_fan(fan_at(planes, p), x).vector - v).norm(dim=-1)
    assert error.mean() < (flat - v).norm(dim=-1).mean() / 3
    assert error.max() < 0.03


def test_a_tangent_plane_has_no_side():
    points = lumpy(3000)
    planes, p = planes_of(points), points[::100]
    normal = planes.normal(p, torch.zeros(len(p), dtype=torch.long))
    flipped = torch.where(torch.arange(len(p))[:, None] % 2 == 0, normal, -normal)
    x = 0.3 * torch.randn(len(p), 7, 3, dtype=p.dtype)
    own = log_on_fan(fan_at(planes, p), x)
    for tangent in (normal, flipped):
        torch.testing.assert_close(log_on_fan(fan_at(planes, p, tangent=tangent), x), own)


def test_logs_lie_in_the_tangent_plane_that_is_given():
    """And are nearer to the closed form there than in one that planes of few points tell."""
    sphere = Sphere(0.5)
    points = sphere.sample(2_000, torch.Generator().manual_seed(0))
    planes, p = planes_of(points), points[:50]
    v = torch.linalg.cross(p[:, None].expand(50, 40, 3), torch.randn(50, 40, 3).double())
    v = v / v.norm(dim=-1, keepdim=True) * torch.linspace(0.1, RADIUS, 40)[:, None]
    x = sphere.exp(p[:, None], v) - p[:, None]
    given = log_on_fan(fan_at(planes, p, tangent=2 * p), x).vector
    own = log_on_fan(fan_at(planes, p), x).vector
    assert (given * p[:, None]).sum(-1).abs().max() < 1e-9
    assert (given - v).norm(dim=-1).mean() < 0.8 * (own - v).norm(dim=-1).mean()


def test_points_of_a_fan_lie_on_the_surface_at_their_distance():
    """On a sphere: their logs are as long as the walk, and A maps to the tangent plane of p."""
    sphere = Sphere()
    p = fibonacci_sphere(30_000)[::1000]
    fan = fan_at(planes_of(fibonacci_sphere(30_000)), p)
    q = p[:, None] + points_of(fan)
    assert float((q.norm(dim=-1) - 1).abs().max()) < 2e-3
    length = REACH * RADIUS * torch.arange(1, LENGTHS + 1, dtype=p.dtype) / LENGTHS
    walked = fan.walked[..., 0].view(len(p), 48, LENGTHS)
    torch.testing.assert_close(walked, length.expand_as(walked), rtol=1e-3, atol=0)
    exact = sphere.log(p[:, None], q).norm(dim=-1)
    torch.testing.assert_close(exact, walked.flatten(1), rtol=0.02, atol=0)
    back = fan.axes[:, None] @ fan.values[..., :6].unflatten(-1, (2, 3))
    normal = torch.einsum("sfij,si->sfj", back, p)
    assert float(normal.abs().max()) < 0.02  # of the planes
    spread = torch.linalg.svdvals(back)
    torch.testing.assert_close(spread, spread.new_tensor([1.0, 1, 0]).expand_as(spread))


def test_reading_is_a_softmax_of_affine_maps():
    points = lumpy(2000)
    fan = fan_at(planes_of(points), points[:2], rays=5)
    x = 0.3 * torch.randn(2, 3, 3, dtype=points.dtype)
    read, lengths = log_on_fan(fan, x), fan.walked[..., 0]
    for s in range(2):
        for k in range(3):
            shares, logs = [], []
            for value, point, length in zip(
                fan.values[s], points_of(fan)[s], lengths[s], strict=True
            ):
                away, (xx, yy, zz, xy, xz, yz) = x[s, k] - point, value[8:14]
                through = torch.stack((xx, xy, xz, xy, yy, yz, xz, yz, zz)).view(3, 3)
                cost = away @ away + ABOVE * away @ through @ away + SHORTER * length**2
                shares.append(-cost / (2 * WIDTH**2))
                logs.append(fan.axes[s] @ (value[:6].view(2, 3) @ x[s, k] + value[6:8]))
            share = torch.stack(shares).softmax(0)
            log = (share[:, None] * torch.stack(logs)).sum(0)
            torch.testing.assert_close(read.vector[s, k], log, rtol=0, atol=1e-9)
            torch.testing.assert_close(read.length[s, k, 0], share @ lengths[s], rtol=0, atol=1e-9)
            gap = x[s, k] - share @ points_of(fan)[s]
            torch.testing.assert_close(read.gap[s, k], gap, rtol=0, atol=1e-9)


def test_sources_do_not_see_each_other():
    points = lumpy(2000)
    planes, x = planes_of(points), 0.3 * torch.randn(4, 6, 3, dtype=points.dtype)
    whole = log_on_fan(fan_at(planes, points[:4]), x)
    part = log_on_fan(fan_at(planes, points[2:3]), x[2:3])
    for a, b in zip(whole, part, strict=True):
        torch.testing.assert_close(a[2:3], b, rtol=0, atol=1e-12)


def test_gradients_in_queries_sources_and_points():
    points = lumpy(300)

    def read(points, p, x):
        return log_on_fan(fan_at(planes_of(points, 4), p, rays=4), x).vector

    arguments = (points, points[:2] * 0.99, 0.3 * torch.randn(2, 3, 3, dtype=points.dtype))
    arguments = tuple(y.clone().requires_grad_() for y in arguments)
    assert torch.autograd.gradcheck(read, arguments, fast_mode=True)
    (slope,) = torch.autograd.grad(read(*arguments).sum(), arguments[1])
    assert slope.isfinite().all() and slope.any()


def test_forward_mode_has_the_same_derivative():
    points = lumpy(2000)
    fan = fan_at(planes_of(points), points[:2])
    x = 0.3 * torch.randn(2, 3, 3, dtype=points.dtype)

    def read(x):
        return log_on_fan(fan, x).vector

    value, slope = torch.func.jvp(read, (x,), (torch.ones_like(x),))
    torch.testing.assert_close(value, read(x))
    step = 1e-6
    torch.testing.assert_close(
        slope, (read(x + step) - read(x - step)) / (2 * step), atol=1e-5, rtol=0
    )
