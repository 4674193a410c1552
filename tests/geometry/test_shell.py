"""Shells around a cloud: level sets of its distance, which lead up walls and round rims."""

import math

import pytest
import torch
from references import fibonacci_sphere, lumpy, planes_of
from torch import Tensor

from riemlayer.geometry import LocalPlanes, Shell, Walked, fan_of, log_on_fan, on_shell, walk
from riemlayer.geometry.shell import HIGH, LOW, REACH, distance
from riemlayer.octree import HALF_WIDTH

H = 0.02
"""Height of the sources: a third of a cell."""


def shell_of(planes: LocalPlanes, p: Tensor) -> Shell:
    return Shell.through(planes, p, torch.zeros(len(p), dtype=torch.long))


def go(shell: Shell, p: Tensor, v: Tensor, steps: int = 48) -> Walked:
    source = torch.arange(len(p))
    return walk(shell, p, v, source, steps, shell.plane(p, source))


def sheet(x: tuple[float, float], y: tuple[float, float], spacing: float = 0.02) -> Tensor:
    """(n, 3) points of a rectangle in the plane z = 0."""
    sides = [torch.arange(a + spacing / 2, b, spacing, dtype=torch.float64) for a, b in (x, y)]
    plane = torch.cartesian_prod(*sides)
    return torch.cat((plane, torch.zeros(len(plane), 1).double()), -1)


def line(x: float, n: int = 9) -> Tensor:
    """(n, 3) sources at height H."""
    y = torch.linspace(-0.2, 0.2, n, dtype=torch.float64)
    return torch.stack((torch.full_like(y, x), y, torch.full_like(y, H)), -1)


def along(x: float, y: float, n: int = 9) -> Tensor:
    return torch.tensor([[x, y, 0.0]], dtype=torch.float64).expand(n, 3)


def test_the_distance_from_a_sheet_is_the_height_and_grows_beside_its_rim():
    planes, batch = planes_of(sheet((-0.5, 0.5), (-0.5, 0.5)), 5), torch.zeros(9).long()
    for height in (-0.03, 0.02, 0.05):
        x = line(0.1) * torch.tensor([1.0, 1.0, height / H])
        away, normal = distance(planes, x, batch)
        torch.testing.assert_close(away, torch.full_like(away, abs(height)), rtol=0, atol=2e-3)
        up = math.copysign(1, height) * torch.tensor([0.0, 0.0, 1.0]).double().expand(9, 3)
        assert float((normal - up).norm(dim=-1).mean()) < 0.1  # radians, among its discs
    beside = line(0.58) * torch.tensor([1.0, 1.0, 0.0])
    away, normal = distance(planes, beside, batch)
    half = planes.fine.level.cell_size / 2  # how far the outermost discs may stand out
    assert (away <= 0.08).all() and (away > 0.08 - 1.2 * half).all() and (normal[:, 0] > 0.9).all()


def test_around_a_sphere_walks_on_the_shell_are_great_circles_of_its_radius():
    n = fibonacci_sphere(100)
    planes, p = planes_of(0.7 * fibonacci_sphere(15_000), 5), (0.7 + H) * n
    v = torch.linalg.cross(n, torch.randn_like(n))
    v = 0.5 * v / v.norm(dim=-1, keepdim=True)
    angle = 0.5 / (0.7 + H)
    exact = (0.7 + H) * (math.cos(angle) * n + math.sin(angle) * v / 0.5)
    end = go(shell_of(planes, p), p, v)
    assert float((end.point - exact).norm(dim=-1).mean()) < 5e-3
    torch.testing.assert_close(end.vector.norm(dim=-1), v.norm(dim=-1))
    assert float((end.vector * end.normal).sum(-1).abs().max()) < 1e-6


def test_up_a_wall_that_stands_on_a_floor_which_goes_on_behind_it():
    """On planes alone the walk goes through the wall."""
    floor, wall = sheet((-0.5, 0.5), (-0.4, 0.4)), sheet((0.0, 0.5), (-0.4, 0.4))
    wall = wall[:, [2, 1, 0]] + torch.tensor([0.2, 0.0, 0.0])
    planes, p, v = planes_of(torch.cat((floor, wall)), 5), line(0.0), along(0.4, 0.05)
    foot = 0.2 - H
    exact = torch.stack((torch.full((9,), foot), p[:, 1] + 0.05, torch.full((9,), H + 0.4 - foot)))
    error = (go(shell_of(planes, p), p, v).point - exact.T.double()).norm(dim=-1)
    batch = torch.zeros(9, dtype=torch.long)
    plain = walk(planes, p, v, batch, 12)
    lifted = plain.point + planes.plane(p, batch)[1] * plain.normal
    assert error.mean() < 0.03 < 0.2 < (lifted - exact.T).norm(dim=-1).mean()


def test_round_the_rim_of_a_sheet_to_its_other_side():
    """In a half circle of radius H, but for the cell over which discs blur the rim."""
    planes, p, v = planes_of(sheet((-0.5, 0.5), (-0.4, 0.4)), 5), line(0.4), along(0.35, 0.05)
    back = 0.5 - (0.35 - 0.1 - math.pi * H)
    exact = torch.stack((torch.full((9,), back), p[:, 1] + 0.05, torch.full((9,), -H))).T
    end = go(shell_of(planes, p), p, v)
    assert (end.point - exact).norm(dim=-1).max() < 1.5 * planes.fine.level.cell_size
    assert (end.normal[:, 2] < -0.9).all() and (end.vector[:, 0] < -0.3).all()


def test_logs_on_the_fan_of_a_shell_lead_up_the_wall():
    floor, wall = sheet((-0.5, 0.2), (-0.4, 0.4)), sheet((0.0, 0.5), (-0.4, 0.4))
    wall = wall[:, [2, 1, 0]] + torch.tensor([0.2, 0.0, 0.0])
    planes, p = planes_of(torch.cat((floor, wall)), 5), line(0.0, 1)
    v = torch.tensor([[0.4, 0.05, 0.0], [0.3, -0.1, 0.0], [-0.2, 0.1, 0.0]]).double()
    foot = 0.2 - H
    q = p + v
    up = v[:2, 0] - foot
    q[:2] = torch.stack((torch.full((2,), foot), p[0, 1] + v[:2, 1], H + up), -1)
    fan = fan_of(shell_of(planes, p), p, torch.zeros(1, dtype=torch.long), 48, 0.5, 32)
    read = log_on_fan(fan, (q - p)[None]).vector[0]
    assert ((read - v).norm(dim=-1) < 0.04).all(), read


def test_far_from_the_cloud_there_is_no_shell():
    planes = planes_of(sheet((-0.2, 0.2), (-0.2, 0.2)), 5)
    p, v = line(0.0), along(0.1, 0.3)
    shell = shell_of(planes, p)
    x = p + torch.tensor([0.0, 0.0, (REACH + 1) * planes.fine.level.cell_size])
    sight = shell.look(x, torch.arange(9), v)
    assert (sight.gap == 0).all() and (sight.support == 0).all() and (sight.normal == v).all()


def test_sources_keep_to_their_own_shells():
    planes = planes_of(0.7 * fibonacci_sphere(8000), 5)
    p = 0.7 * fibonacci_sphere(6) * (1 + torch.linspace(0.02, 0.06, 6)[:, None].double())
    v = torch.linalg.cross(p, torch.randn_like(p))
    v = 0.3 * v / v.norm(dim=-1, keepdim=True)
    together = go(shell_of(planes, p), p, v)
    for i in range(6):
        alone = go(shell_of(planes, p[i : i + 1]), p[i : i + 1], v[i : i + 1])
        torch.testing.assert_close(together.point[i], alone.point[0])
    torch.testing.assert_close(together.point.norm(dim=-1), p.norm(dim=-1), rtol=0.01, atol=0)


def test_the_share_of_shells_grows_with_the_height_without_a_kink():
    height = torch.linspace(-0.4, 0.4, 4001).double()[:, None]
    share = on_shell(height, 1.0).squeeze(-1)
    assert (share[height.squeeze(-1).abs() <= LOW] == 0).all()
    assert (share[height.squeeze(-1).abs() >= HIGH] == 1).all()
    steepest = 6 / (HIGH - LOW) ** 2
    assert share.diff().diff().abs().max() < 1.1 * steepest * 2e-4**2


@pytest.mark.parametrize("argument", range(3))
def test_gradients_in_start_vector_and_points(argument):
    points = lumpy(200)
    p = 1.05 * points[:3]
    v = torch.linalg.cross(p, torch.randn_like(p))
    arguments = [p, 0.3 * v / v.norm(dim=-1, keepdim=True), points]

    def end(x: Tensor) -> Tensor:
        a = [x if i == argument else y for i, y in enumerate(arguments)]
        return torch.cat(go(shell_of(planes_of(a[2], 3), a[0]), a[0], a[1], 4)[:3], -1)

    x = arguments[argument].clone().requires_grad_()
    assert torch.autograd.gradcheck(end, (x,), fast_mode=True, atol=1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_where_a_disc_leaves_what_is_looked_at_its_distance_has_a_derivative(dtype):
    """From places at which the one disc that is near has next to no trilinear weight."""
    around = 0.004 * torch.rand(60, 3, dtype=torch.float64) - 0.002
    disc = torch.tensor([0.49, 0, 0], dtype=torch.float64)
    planes = planes_of(torch.cat((disc + around, -disc - around)).to(dtype), 5)
    cell = planes.fine.level.cell_size
    node = ((disc + HALF_WIDTH) / cell).floor() + 0.5
    away = torch.arange(0, 40, dtype=torch.float64)[:, None, None] * 0.05
    beside = torch.arange(-2, 3, dtype=torch.float64)[:, None]
    steps = away * torch.tensor([-1.0, 0, 0]) + beside * torch.tensor([0.0, 1, 0])
    x = ((node + steps) * cell - HALF_WIDTH).flatten(0, 1).to(dtype)

    def far(x):
        return distance(planes, x, torch.zeros(len(x), dtype=torch.long))

    (gap, _), slopes = torch.func.jvp(far, (x,), (torch.ones_like(x),))
    assert (gap < 2 * cell).any() and (gap > 100).any()
    assert all(slope.abs().max() < 1e3 for slope in slopes)
