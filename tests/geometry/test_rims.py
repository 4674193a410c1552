"""Walks at a height and at rims: as on a shell around the cloud, and round the edge of a sheet."""

import math

import pytest
import torch
from references import fibonacci_sphere, go, lumpy, planes_of
from torch import Tensor

from riemlayer.geometry import LocalPlanes, fan_of, log_on_fan
from riemlayer.geometry.planes import SPARSE
from riemlayer.geometry.rims import may_end
from riemlayer.geometry.walk import RIM

EDGE = 0.5


def grid(side: float, n: int) -> Tensor:
    """(n^2, 3) points of a square sheet around the origin, at the middles of cells."""
    line = ((torch.arange(n, dtype=torch.float64) + 0.5) / n - 0.5) * 2 * side
    return torch.cat((torch.cartesian_prod(line, line), torch.zeros(n * n, 1).double()), -1)


@pytest.fixture(scope="module")
def sheet() -> Tensor:
    return grid(EDGE, 80)


@pytest.fixture(scope="module")
def turned() -> Tensor:
    """A rotation, so that nothing is aligned with the octree."""
    generator = torch.Generator().manual_seed(3)
    q = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64, generator=generator))[0]
    return q * q.det().sign()


def reflected(x: Tensor) -> Tensor:
    """Where straight lines that are folded back at the edge x = EDGE end."""
    return torch.cat((EDGE - (EDGE - x[:, :1]).abs(), x[:, 1:]), -1)


def test_at_the_rim_of_a_sheet_a_walk_is_reflected_and_turned_over(sheet, turned):
    planes = planes_of(sheet @ turned.T, 5)
    y = torch.linspace(-0.2, 0.2, 9, dtype=torch.float64)[:, None]
    p = torch.cat((torch.full_like(y, 0.35), y, torch.zeros_like(y)), -1)
    v = torch.tensor([[0.35, 0.1, 0.0]], dtype=torch.float64).expand(9, 3)
    end = go(planes, p @ turned.T, v @ turned.T, 16)
    cell = planes.fine.level.cell_size
    assert ((end.point @ turned - reflected(p + v)).norm(dim=-1) < 2 * RIM * cell).all()
    back = v * torch.tensor([-1.0, 1, 1])
    torch.testing.assert_close(end.vector @ turned, back, rtol=0, atol=0.1)
    torch.testing.assert_close(end.vector.norm(dim=-1), v.norm(dim=-1))
    start = go(planes, p @ turned.T, 0.1 * v @ turned.T, 16).normal
    torch.testing.assert_close(end.normal, -start)


def test_without_rims_a_walk_leaves_the_sheet_straight(sheet):
    planes = LocalPlanes.of([planes_of(sheet, 5).scales[0]._replace(rims=False)])
    p = torch.tensor([[0.4, 0.0, 0.0]], dtype=torch.float64)
    v = torch.tensor([[0.4, 0.1, 0.0]], dtype=torch.float64)
    torch.testing.assert_close(go(planes, p, v, 16).point, p + v, rtol=0, atol=1e-9)


@pytest.mark.parametrize("n, turns", [(60, True), (8, False)])
def test_gaps_of_a_sparse_cloud_are_no_rims(n, turns):
    """Between points further apart than `SPARSE` allows a walk goes on."""
    sheet = grid(EDGE, n)
    planes = planes_of(sheet, 5)
    spacing = 2 * EDGE / n / planes.scales[0].coarse.level.cell_size
    assert (spacing < SPARSE) == turns
    middle, shape = 0.2 * sheet, torch.zeros(len(sheet), dtype=torch.long)
    found = planes.scales[0].coarse.spacing(middle, shape)
    torch.testing.assert_close(found.mean().item(), spacing, rtol=0.2, atol=0)
    p = torch.tensor([[0.35, 0.0, 0.0]], dtype=torch.float64)
    end = go(planes, p, torch.tensor([[0.3, 0.02, 0.0]], dtype=torch.float64), 16)
    assert bool(end.met[0, 3]) == turns
    assert planes.scales[0].coarse.spacing(p + 9, shape[:1]).isinf().all()


def test_a_step_that_lands_in_the_air_is_taken_in_halves(sheet):
    """It ends three cells beyond the rim, its first half one cell beyond."""
    planes = planes_of(sheet, 5)
    p = torch.tensor([[0.45, 0.01, 0.0], [0.45, -0.2, 0.0]], dtype=torch.float64)
    v = torch.tensor([[0.25, 0.0, 0.0]], dtype=torch.float64).expand(2, 3)
    batch = torch.zeros(2, dtype=torch.long)
    assert (planes.look(p + v, batch, torch.zeros_like(p)).beside == 0).all()
    end = go(planes, p, v, 1).point
    torch.testing.assert_close(end, reflected(p + v), rtol=0, atol=2 * RIM * 0.06)


def test_across_a_gap_a_walk_goes_on(sheet):
    """Where the sheet is missing for less than the distance that is looked ahead."""
    planes = planes_of(sheet, 5)
    cell = planes.fine.level.cell_size
    split = planes_of(sheet[(sheet[:, 0] - 0.1).abs() > 0.4 * cell], 5)
    p = torch.tensor([[-0.1, 0.013, 0.0], [-0.1, 0.2, 0.0]], dtype=torch.float64)
    v = torch.tensor([[0.4, 0.05, 0.0]], dtype=torch.float64).expand(2, 3)
    torch.testing.assert_close(go(split, p, v, 16).point, p + v, rtol=0, atol=1e-6)


def test_walks_say_what_they_met(sheet, turned):
    """Nothing on a flat sheet; one turn at its rim; no support in the air; curvature."""
    planes, steps = planes_of(sheet @ turned.T, 5), 16
    p = torch.tensor([[0.35, 0.02, 0.0]], dtype=torch.float64) @ turned.T
    away = torch.tensor([[0.35, 0.02, 0.0], [-0.4, 0.1, 0.0]], dtype=torch.float64) @ turned.T
    at_rim, inside = (go(planes, p, v[None], steps).met[0] for v in away)
    assert inside[:2].max() < 1e-6 and inside[2] > 0.7 * steps and inside[3] == 0
    assert at_rim[3] == 1
    up = (p + 0.5 * turned.T[2:]).contiguous()
    lost = go(planes, up, away[:1], steps).met[0]
    assert lost.abs().max() < 1e-6
    n = fibonacci_sphere(10)
    v = torch.linalg.cross(n, torch.randn_like(n))
    v = 0.5 * v / v.norm(dim=-1, keepdim=True)
    bent = go(planes_of(fibonacci_sphere(20_000)), n, v, steps).met
    each = 1 - math.cos(0.5 / steps)
    torch.testing.assert_close(
        bent[:, 1], torch.full((10,), steps * each).double(), rtol=0.2, atol=0
    )


def slab(thick: float, n: int = 90) -> Tensor:
    """Both sides of a thin square slab."""
    up = torch.tensor([0.0, 0.0, thick / 2], dtype=torch.float64)
    return torch.cat((grid(EDGE, n) + up, grid(EDGE, n) - up))


def round_the_edge(p: Tensor, v: Tensor, thick: float) -> Tensor:
    """Exp on the slab across its edge at x = EDGE, from the upper side."""
    beyond = p[:, 0] + v[:, 0] - EDGE - thick
    y = p[:, 1] + v[:, 1]
    return torch.stack((EDGE - beyond, y, torch.full_like(y, -thick / 2)), -1)


def test_round_the_edge_of_a_thin_slab():
    """From the upper side to the lower one; without rims the walk ends in the air."""
    thick = 0.04
    planes = planes_of(slab(thick), 5)
    y = torch.linspace(-0.2, 0.2, 9, dtype=torch.float64)[:, None]
    p = torch.cat((torch.full_like(y, 0.4), y, torch.full_like(y, thick / 2)), -1)
    v = torch.tensor([[0.3, 0.05, 0.0]], dtype=torch.float64).expand(9, 3)
    exact = round_the_edge(p, v, thick)
    batch = torch.zeros(9, dtype=torch.long)
    height = planes.plane(p, batch)[1]
    ends = []
    for rims in (True, False):
        end = go(LocalPlanes.of([planes.scales[0]._replace(rims=rims)]), p, v, 16)
        ends.append((end.point + height * end.normal - exact).norm(dim=-1).mean())
    assert ends[0] < 0.05 and ends[0] < ends[1] / 6, ends


def test_near_the_rim_a_fan_tells_the_sides_of_a_thin_slab_apart():
    """Logs of the upper side are straight; those of the lower one go round the edge."""
    thick = 0.04
    planes = planes_of(slab(thick), 5)
    p = torch.tensor([[0.44, 0.0, thick / 2]], dtype=torch.float64)
    v = torch.tensor([[0.03, 0.03, 0.0], [-0.1, -0.2, 0.0], [0.12, 0.02, 0.0], [0.13, -0.03, 0.0]])
    v = v.double()
    q = torch.cat((p + v[:2], round_the_edge(p.expand(2, 3), v[2:], thick)))
    fan = fan_of(planes, p, torch.zeros(1, dtype=torch.long), 48, 0.5)
    read, straight = log_on_fan(fan, (q - p)[None]).vector[0], q - p
    assert ((read - v)[:2].norm(dim=-1) < 0.01).all()
    assert ((read - v)[2:].norm(dim=-1) < 0.3 * (straight - v)[2:].norm(dim=-1)).all()


@pytest.mark.parametrize("height", [-0.03, 0.03])
def test_at_a_height_a_walk_is_as_long_as_on_the_shell_there(height):
    """Above a sphere of radius 1 it turns by |v| / (1 + h)."""
    planes, n = planes_of(fibonacci_sphere(20_000)), fibonacci_sphere(100)
    v = torch.linalg.cross(n, torch.randn_like(n))
    v = 0.5 * v / v.norm(dim=-1, keepdim=True)
    angle = 0.5 / (1 + height)
    for steps, tolerance in ((8, 4e-3), (32, 1.5e-3)):
        end = go(planes, (1 + height) * n, v, steps).point
        exact = math.cos(angle) * n + math.sin(angle) * v / 0.5
        assert float((end - exact).norm(dim=-1).max()) < tolerance
    unaware = math.cos(0.5) * n + math.sin(0.5) * v / 0.5
    assert float((unaware - exact).norm(dim=-1).min()) > 0.01


def test_rims_have_gradients_and_forward_mode_agrees():
    """Reflections are differentiable: of the end in start, vector and cloud."""
    points = grid(0.5, 12) + 1e-3 * lumpy(144)
    p = torch.tensor([[0.31, 0.02, 0.001], [0.3, -0.11, 0.0]], dtype=torch.float64)
    v = torch.tensor([[0.4, 0.05, 0.0], [0.38, -0.1, 0.02]], dtype=torch.float64)

    def end(p: Tensor, v: Tensor, points: Tensor) -> Tensor:
        return torch.cat(go(planes_of(points, 4), p, v, 5), -1)

    assert float((end(p, v, points)[:, 0] - (p + v)[:, 0]).max()) < -0.1  # they were reflected
    arguments = [x.clone().requires_grad_() for x in (p, v, points)]
    assert torch.autograd.gradcheck(end, arguments, fast_mode=True, atol=1e-4)
    along = torch.randn_like(v)
    _, pushed = torch.func.jvp(lambda v: end(p, v, points), (v,), (along,))
    step = 1e-6
    slope = (end(p, v + step * along, points) - end(p, v - step * along, points)) / (2 * step)
    torch.testing.assert_close(pushed, slope, rtol=0, atol=1e-5)


def everywhere(planes: LocalPlanes) -> LocalPlanes:
    """The same planes, with every node as one at which the sheet may end."""
    grids = planes.grids
    return planes._replace(grids=grids._replace(may_end=torch.ones_like(grids.may_end)))


def test_sheets_may_end_at_their_rims_and_not_inside(sheet, turned):
    coarse = planes_of(sheet @ turned.T, 5).scales[0].coarse
    n, cell = len(coarse.level), coarse.level.cell_size
    inside = EDGE - (coarse.plane[:3, :n].T @ turned).abs().amax(-1)
    found = may_end(coarse.level, coarse.plane)
    assert not found[n] and not found[:n][inside > 2 * cell].any() and (inside > 2 * cell).any()
    rim = inside < 0.25 * cell
    assert found[:n][rim].double().mean() > 0.95 and rim.sum() > 20


@pytest.mark.parametrize(("width", "ends"), [(0.04, True), (1.0, False)])
def test_closed_surfaces_end_only_where_they_are_narrower_than_a_cell(turned, width, ends):
    """An ellipsoid, flat and thin or round."""
    cloud = fibonacci_sphere(4000).double() * torch.tensor([0.8, 0.8 * width, 0.8 * width]).double()
    coarse = planes_of(cloud @ turned.T, 5).scales[0].coarse
    assert (may_end(coarse.level, coarse.plane)[:-1] == ends).all()


def test_where_sheets_may_not_end_no_walk_would_have_turned_back(sheet, turned):
    """Looking closer at fewer places changes no answer."""
    holed = sheet[(sheet - torch.tensor([0.1, 0.1, 0.0])).norm(dim=-1) > 0.15]
    for cloud in (sheet, holed, lumpy(3000).double()):
        cloud = cloud @ turned.T
        planes = planes_of(cloud, 5)
        p = cloud[::53]
        normal = planes.normal(p, torch.zeros(len(p), dtype=torch.long))
        away = torch.nn.functional.normalize(torch.randn_like(p), dim=-1)
        v = 0.5 * (away - (away * normal).sum(-1, keepdim=True) * normal)
        end, again = go(planes, p, v, 16), go(everywhere(planes), p, v, 16)
        torch.testing.assert_close(end.met[:, 3], again.met[:, 3])
        torch.testing.assert_close(end.point, again.point)
        assert bool(end.met[:, 3].any()) == (len(cloud) != 3000)
