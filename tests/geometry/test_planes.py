"""Local planes: normals of known surfaces, and answers that are defined everywhere."""

import pytest
import torch
from references import fibonacci_sphere, lumpy, planes_of
from torch import Tensor

from riemlayer.geometry import LocalPlanes, local_planes, planes_at_scales
from riemlayer.geometry.grids import BLEND
from riemlayer.geometry.planes import FEW
from riemlayer.octree import build_octree, corners

UP = torch.tensor([0.0, 0, 1], dtype=torch.float64)


def at(planes: LocalPlanes, x: Tensor, towards: Tensor) -> tuple[Tensor, Tensor]:
    return planes.look(x, torch.zeros(len(x), dtype=torch.long), towards.expand_as(x))[:2]


def tilted_plane(n: int = 4000) -> tuple[Tensor, Tensor]:
    """Points of a tilted square, and its normal."""
    turn = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64))[0]
    flat = torch.rand(n, 3, dtype=torch.float64) * torch.tensor([1.0, 1, 0]) - 0.5
    flat[:, 2] = 0
    return flat @ turn.T, turn[:, 2]


def test_planes_of_a_plane_are_that_plane():
    points, normal = tilted_plane()
    planes = planes_of(points, 5)
    found = planes.fine.plane[3:, :-1].T
    torch.testing.assert_close((found @ normal).abs(), torch.ones(len(found)).double())
    height = 0.02 * torch.randn(200, 1, dtype=torch.float64)
    blended, gap = at(planes, points[:200] + height * normal, normal)
    torch.testing.assert_close(blended, normal.expand(200, 3), rtol=0, atol=1e-6)
    torch.testing.assert_close(gap, height, rtol=0, atol=1e-6)


def test_normals_of_a_sphere_are_radial():
    points = fibonacci_sphere(8000)
    normal, gap = planes_of(points, 5).look(points, torch.zeros(8000).long(), points)[:2]
    assert ((normal * points).sum(-1) > 0.999).all()
    assert gap.abs().max() < 0.01  # a fifth of the sagitta of a cell


def test_normals_get_better_as_cells_shrink():
    points, x = fibonacci_sphere(20_000), fibonacci_sphere(300)
    errors = []
    for depth in (3, 4, 5):
        normal, _ = at(planes_of(points, depth), x, x)
        errors.append(float((normal - x).norm(dim=-1).mean()))
    assert errors[1] < errors[0] / 1.7 and errors[2] < errors[1] / 1.7, errors


def test_normals_take_the_sign_that_is_asked_for():
    planes, x = planes_of(fibonacci_sphere(4000), 5), fibonacci_sphere(100)
    normal, gap = at(planes, 1.01 * x, x)
    inward, other = at(planes, 1.01 * x, -x)
    torch.testing.assert_close(inward, -normal)
    torch.testing.assert_close(other, -gap)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_normals_of_noisy_walls_do_not_cancel(axis):
    """Stored signs are arbitrary: a fixed direction that sorts them has walls that it lies in."""
    points = torch.rand(10_000, 3, dtype=torch.float64) - 0.5
    points[:, axis] = 0.013 + 1e-3 * torch.randn(10_000, dtype=torch.float64)
    x = points[:1000]
    normal = planes_of(points, 6).normal(x, torch.zeros(1000, dtype=torch.long))
    assert (normal[:, axis].abs() > 0.999).all()


def test_stored_signs_have_no_meaning():
    planes, x = planes_of(fibonacci_sphere(2000), 5), fibonacci_sphere(100)
    fine = planes.fine
    sign = torch.randint(0, 2, (fine.plane.shape[1],)) * 2 - 1
    turned = fine._replace(plane=torch.cat((fine.plane[:3], fine.plane[3:] * sign)))
    flipped = LocalPlanes.of([planes.scales[0]._replace(fine=turned)])
    for a, b in zip(at(planes, x, x), at(flipped, x, x), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12)
    n, m = (y.normal(x, torch.zeros(100, dtype=torch.long)) for y in (planes, flipped))
    torch.testing.assert_close((n * m).sum(-1).abs(), torch.ones(100).double())
    points = fibonacci_sphere(2000)
    leaf = build_octree(points, torch.zeros(2000, dtype=torch.long), 5).leaf
    features = planes.point_features(points, leaf), flipped.point_features(points, leaf)
    torch.testing.assert_close(*features, rtol=0, atol=1e-12)


def test_far_from_every_point_there_is_no_plane():
    planes = planes_of(0.3 * fibonacci_sphere(500), 5)
    far, shape = torch.tensor([[0.9, 0.9, 0.9], [0.0, 0, 0]]).double(), torch.tensor([0, 0])
    towards = torch.tensor([0.6, 0.8, 0.0]).double()
    normal, gap = at(planes, far, towards)
    torch.testing.assert_close(normal, towards.expand(2, 3))
    assert (gap == 0).all()
    assert torch.equal(planes.normal(far, shape), UP.expand(2, 3))


def test_sheets_three_cells_apart_do_not_mix():
    """Just outside one of them, the distance is measured from it."""
    flat = (torch.rand(8000, 3, dtype=torch.float64) - 0.5) * torch.tensor([1.0, 1, 0])
    planes = planes_of(torch.cat((flat, flat + 0.2 * UP)), 5)  # cells of 0.066
    for sheet in (flat[:200], flat[:200] + 0.2 * UP):
        _, gap = at(planes, sheet + 0.01 * UP, UP)
        torch.testing.assert_close(gap, torch.full_like(gap, 0.01), rtol=0, atol=2e-4)


@pytest.mark.parametrize("spread", [[0.0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 1, 0]])
def test_clouds_of_few_points_have_settled_planes(spread):
    """A point, a line, a sparse square: shifting the cloud by a cell shifts its planes."""
    points = torch.randn(12, 3, dtype=torch.float64) * 0.05 * torch.tensor(spread).double()
    points = points + torch.tensor([0.21, 0.31, 0.41]).double()
    shift = 2.125 / 8
    here, there = planes_of(points, 5), planes_of(points - shift, 5)
    for a, b in zip(here.scales[0].levels, there.scales[0].levels, strict=True):
        moved = b.plane[:, :-1].T + torch.tensor([shift] * 3 + [0.0] * 3)
        torch.testing.assert_close(moved, a.plane[:, :-1].T, rtol=0, atol=1e-9)
        torch.testing.assert_close(a.eigenvalues, b.eigenvalues, rtol=0, atol=1e-9)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_degenerate_clouds_have_finite_planes_and_gradients(dtype):
    line = torch.linspace(-1, 1, 40, dtype=dtype)[:, None] * torch.tensor([1.0, 0, 0], dtype=dtype)
    far = torch.tensor([[0.9, 0.9, 0.9], [0.9, 0.9, 0.9]], dtype=dtype)
    points = torch.cat((line, far)).requires_grad_()
    planes = planes_of(points, 5)
    x = torch.cat((line + 0.01, far, torch.zeros(3, 3, dtype=dtype)))
    normal, gap = at(planes, x, UP.to(dtype))
    assert normal.isfinite().all() and gap.isfinite().all()
    (normal.sum() + gap.sum()).backward()
    assert points.grad is not None and points.grad.isfinite().all()


def test_point_features_have_no_units_and_no_position():
    points = lumpy(400)
    shift = 2.125 / 32  # a cell
    leaf = build_octree(points, torch.zeros(400, dtype=torch.long), 5).leaf
    a = planes_of(points, 5).point_features(points, leaf)
    moved = points + torch.tensor([shift, -shift, 0]).double() * 2
    leaf = build_octree(moved, torch.zeros(400, dtype=torch.long), 5).leaf
    b = planes_of(moved, 5).point_features(moved, leaf)
    torch.testing.assert_close(a, b, rtol=0, atol=1e-8)
    assert a.shape == (400, 11)


def test_gradcheck_in_queries_and_points():
    points = lumpy(60).requires_grad_()
    towards = points.detach()[:6]
    x = (1.01 * towards).requires_grad_()

    def answer(points: Tensor, x: Tensor) -> Tensor:
        return torch.cat(at(planes_of(points, 4), x, towards), -1)

    assert torch.autograd.gradcheck(answer, (points, x), fast_mode=True, atol=1e-4)


def test_scales_are_the_planes_of_deeper_and_shallower_trees():
    points, batch = fibonacci_sphere(3000), torch.zeros(3000).long()
    wide, fine = planes_at_scales(points, build_octree(points, batch, 6), (1, 0)).scales
    for got, depth in ((wide, 5), (fine, 6)):
        expected = local_planes(points, build_octree(points, batch, depth)).scales[0]
        for a, b in ((got.fine, expected.fine), (got.coarse, expected.coarse)):
            torch.testing.assert_close(a.plane, b.plane)
            torch.testing.assert_close(a.eigenvalues, b.eigenvalues)


def test_staggered_planes_are_those_of_a_shifted_cloud():
    points = lumpy(500)
    staggered = planes_of(points, 5).scales[0].staggered
    moved = points + staggered.shift
    expected = planes_of(moved, 5).fine
    centroid, normal = staggered.plane[:, :-1].split(3)
    assert 0 < staggered.shift < staggered.level.cell_size
    torch.testing.assert_close(centroid + staggered.shift, expected.plane[:3, :-1])
    agree = (normal * expected.plane[3:, :-1]).sum(0).abs()
    torch.testing.assert_close(agree, torch.ones_like(agree))


def test_two_grids_depend_less_on_where_their_cells_lie():
    """A noisy sphere under shifts of its grid: how far the surface beneath a point moves."""
    points = fibonacci_sphere(4000) * 0.8
    points = (
        points + 0.01 * torch.randn(4000, 3, generator=torch.Generator().manual_seed(0)).double()
    )
    x = fibonacci_sphere(500) * 0.8
    one, two = [], []
    for t in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5):
        planes = planes_of(points + t / 16, 5)
        both = at(planes, x + t / 16, x)
        moved, shape = (x + t / 16).T, torch.zeros(500).long()
        nodes = planes.grids.nodes(moved, shape, slice(0, 1))
        fine = planes.grids.blend(nodes, moved, x.T).squeeze(1)
        two.append(both[1].squeeze(-1))
        one.append(fine[3] / fine[4])
    spread = [float(torch.stack(gaps).std(0).mean()) for gaps in (one, two)]
    assert spread[1] < 0.8 * spread[0], spread


def test_a_blend_is_the_sum_over_the_eight_nodes_of_each_grid():
    points = lumpy(800)
    planes, shape = planes_of(points, 5), torch.zeros(200, dtype=torch.long)
    x = 1.02 * points[:200]
    towards = torch.nn.functional.normalize(torch.randn_like(x), dim=-1)
    for i, on in enumerate(planes.scales[0].levels):
        nodes = planes.grids.nodes(x.T, shape, slice(i, i + 1))
        found = planes.grids.blend(nodes, x.T, towards.T).squeeze(1)
        node, weight = corners(on.level, x + on.shift, shape)
        centroid, normal = on.plane.T[node].split(3, -1)  # (Q, 8, 3)
        offset = x[:, None] - centroid
        width = BLEND * on.level.cell_size
        weight = weight * (-0.5 * offset.square().sum(-1) / width**2).exp()
        sign = weight * torch.where((normal * towards[:, None]).sum(-1) < 0, -1, 1)
        torch.testing.assert_close(found[:3].T, (sign[..., None] * normal).sum(1))
        torch.testing.assert_close(found[3], (sign * (normal * offset).sum(-1)).sum(-1))
        torch.testing.assert_close(found[4], weight.sum(-1))
        torch.testing.assert_close(found[5:].T, (weight[..., None] * offset).sum(1))


def test_spectra_measure_thickness_in_cells():
    """Uniform noise of width w has standard deviation w / sqrt(12); the rest of a plane is flat."""
    points, normal = tilted_plane(20_000)
    width = 0.04
    points = points + width * (torch.rand(len(points), 1, dtype=torch.float64) - 0.5) * normal
    level = planes_of(points, 4).fine
    inner = points[(points.norm(dim=-1) < 0.3).nonzero().squeeze(-1)[:200]]
    own, around = level.spectra(inner, torch.zeros(len(inner)).long()).split(3, -1)
    thickness = width / 12**0.5 / level.level.cell_size
    for spread in (own, around):
        assert (spread[:, 0] / thickness - 1).abs().max() < 0.15
        assert (spread[:, 1] > 5 * spread[:, 0]).all()
    nowhere = torch.full((1, 3), 0.99, dtype=torch.float64)
    assert (level.spectra(nowhere, torch.zeros(1).long()) == 0).all()
    assert not level.spectra(inner.requires_grad_(), torch.zeros(len(inner)).long()).requires_grad


def test_normals_hide_the_other_side_of_a_thin_plate():
    """Two sheets a cell apart: without normals their planes blend, with them they do not."""
    flat = torch.rand(100_000, 3).double() * torch.tensor([1.6, 1.6, 0]) - 0.8
    flat[:, 2] = 0
    gap = 1 / 64  # a cell at depth 7
    points = torch.cat((flat + gap / 4 * UP, flat + 5 * gap / 4 * UP))
    normals = torch.cat((-UP.expand_as(flat), UP.expand_as(flat)))
    octree = build_octree(points, torch.zeros(len(points), dtype=torch.long), 7)
    x = 0.5 * flat[:200] + 5 * gap / 4 * UP
    miss = []
    for given in (None, normals):
        planes = planes_at_scales(points, octree, (0,), given)
        miss.append(float(at(planes, x, UP)[1].abs().mean()))
    assert miss[1] < 0.1 * miss[0] and miss[0] > 0.03 * gap, miss
    facing = planes.normal(x, torch.zeros(200, dtype=torch.long))
    assert (facing[:, 2] > 0.9).all()


def test_normals_give_planes_their_side_and_change_nothing_else():
    points = fibonacci_sphere(4000)
    octree = build_octree(points, torch.zeros(4000, dtype=torch.long), 6)
    plain, outward = (planes_at_scales(points, octree, (0,), n) for n in (None, points))
    torch.testing.assert_close(outward.fine.plane[:3], plain.fine.plane[:3])
    turned = outward.fine.plane[3:, :-1].T
    torch.testing.assert_close(turned.abs(), plain.fine.plane[3:, :-1].T.abs())
    assert ((turned * outward.fine.plane[:3, :-1].T).sum(-1) > 0).all()


def test_planes_of_few_points_do_not_turn_with_rounding():
    """Two or three points a node, in single precision: a millionth of a cell turns no normal."""
    points = lumpy(300).float()
    moved = points + 1e-6 * 2.125 / 64 * torch.randn_like(points)
    batch = torch.zeros(300, dtype=torch.long)
    octree = build_octree(points, batch, 6)
    here, there = (local_planes(x, octree).fine for x in (points, moved))
    n, m = (y.plane[3:, :-1] for y in (here, there))
    flat = here.eigenvalues[:, 0] < 0.5 * here.eigenvalues[:, 1]  # elsewhere there is no normal
    turned = torch.linalg.cross(n, m, dim=0).norm(dim=0)
    assert flat.float().mean() > 0.8 and turned[flat].max() < 1e-4, float(turned[flat].max())


def test_few_queries_and_many_are_answered_alike():
    """Few are looked up on all three grids at once, many on the coarse one where they must."""
    points = lumpy(800)
    planes, few = planes_of(points, 5), FEW // 2
    x = (1 + torch.linspace(-0.2, 0.2, FEW + few)[:, None]) * points.repeat(3, 1)[: FEW + few]
    shape, towards = torch.zeros(len(x), dtype=torch.long), torch.randn_like(x)
    parts = [
        planes.look(*y) for y in zip(*(y.split(few) for y in (x, shape, towards)), strict=True)
    ]
    together = planes.look(x, shape, towards)
    assert (together.support < 0.3).any()
    for got, want in zip(together, zip(*parts, strict=True), strict=True):
        torch.testing.assert_close(got, torch.cat(want))
