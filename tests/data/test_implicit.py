"""Clouds of functions: on the level to rounding, everywhere on it, whatever the function."""

import math

import pytest
import torch
from torch import Tensor, nn

from riemlayer.data import sample_occupancy, sample_sdf

WIDE = (-1.5, 1.5)


def sphere(x: Tensor) -> Tensor:
    return x.norm(dim=-1) - 1


def torus(x: Tensor) -> Tensor:
    ring = torch.stack((x[:, :2].norm(dim=-1) - 0.9, x[:, 2]), -1)
    return ring.norm(dim=-1) - 0.4


def box(x: Tensor) -> Tensor:
    d = x.abs() - x.new_tensor([1.0, 0.8, 0.5])
    return d.clamp_min(0).norm(dim=-1) + d.amax(-1).clamp_max(0)


def quadric(x: Tensor) -> Tensor:
    """Zero on the unit sphere, but no distance: its gradient has length 20 there."""
    return 10 * (x.square().sum(-1) - 1)


def flat(x: Tensor) -> Tensor:
    """Zero on the unit sphere with a gradient of length 0.01."""
    return (sphere(x) / 100).tanh()


# ------------------------------------------------------------------------------------- distances


@pytest.mark.parametrize("dtype, tolerance", [(torch.float32, 3e-6), (torch.float64, 1e-12)])
@pytest.mark.parametrize("f", [sphere, torus, box])
def test_points_of_a_distance_lie_on_its_level(f, dtype, tolerance):
    points, normals, residual = sample_sdf(f, 2000, WIDE, dtype=dtype)
    assert points.shape == normals.shape == (2000, 3) and points.dtype == dtype
    assert torch.equal(residual, f(points).abs()) and float(residual.max()) < tolerance
    assert (normals.norm(dim=-1) - 1).abs().max() < 1e-5
    outward = f(points + 1e-3 * normals)
    assert (outward - 1e-3).abs().max() < 1e-4


@pytest.mark.parametrize("f", [quadric, flat])
def test_functions_that_are_no_distance(f):
    points, normals, residual = sample_sdf(f, 1000, WIDE, dtype=torch.float64)
    assert (points.norm(dim=-1) - 1).abs().max() < 5e-3 < TOLERANCE_OF_WIDE * 1.01
    assert (points.norm(dim=-1) - 1).abs().median() < 1e-4
    assert (normals - torch.nn.functional.normalize(points, dim=-1)).abs().max() < 1e-9
    assert torch.equal(residual, f(points).abs())


TOLERANCE_OF_WIDE = 1e-3 * 3 * math.sqrt(3)


def test_for_a_distance_one_step_is_equation_7():
    points = sample_sdf(sphere, 500, WIDE, iterations=1, dtype=torch.float64).points
    assert (points.norm(dim=-1) - 1).abs().max() < 1e-12


def test_an_unsigned_distance_will_do():
    points = sample_sdf(lambda x: torus(x).abs(), 500, WIDE).points
    assert torus(points).abs().max() < 1e-5


def test_every_part_of_the_surface_is_reached():
    points = sample_sdf(sphere, 4000, WIDE).points
    octant = ((points > 0) * torch.tensor([4, 2, 1])).sum(-1).bincount(minlength=8)
    assert (octant - 500).abs().max() < 120
    two = sample_sdf(lambda x: torch.minimum(sphere(x * 4 - 3), sphere(x * 4 + 3)), 600, WIDE)
    assert 150 < int((two.points[:, 0] > 0).sum()) < 450


def test_bounds_cut_the_surface():
    bounds = torch.tensor([[-1.5, -1.5, 0.2], [1.5, 1.5, 1.5]])
    points = sample_sdf(sphere, 300, bounds).points
    assert points[:, 2].min() >= 0.2 and (points.norm(dim=-1) - 1).abs().max() < 1e-6


def test_a_module_gives_kind_and_gathers_no_gradient():
    net = nn.Sequential(nn.Linear(3, 32), nn.Softplus(10), nn.Linear(32, 1)).double()
    torch.nn.init.constant_(net[2].bias, float(-net(torch.zeros(1, 3).double()).detach()))
    with torch.inference_mode():
        points, _, residual = sample_sdf(net, 200, (-1, 1))
    assert points.dtype == torch.float64 and residual.max() < 1e-3
    assert all(p.grad is None for p in net.parameters()) and not points.requires_grad


def test_chunks_and_seeds():
    sizes = []

    def counted(x: Tensor) -> Tensor:
        sizes.append(len(x))
        return sphere(x)

    once = sample_sdf(sphere, 300, WIDE, seed=4).points
    chunked = sample_sdf(counted, 300, WIDE, seed=4, chunk_size=100).points
    assert torch.equal(once, chunked) and max(sizes) == 100
    assert not torch.equal(once, sample_sdf(sphere, 300, WIDE, seed=5).points)


@pytest.mark.parametrize(
    "f, words",
    [
        (lambda x: x.square().sum(-1) + 0.1, "found 0 of 9 points .* check the bounds"),
        (lambda x: sphere(x / 10), "found 0 of 9 points"),
        (lambda x: (sphere(x) > 0).float(), "must be differentiable by torch.*sample_occupancy"),
        (lambda x: x, r"must answer \(4096,\) or \(4096, 1\).* got \(4096, 3\)"),
        (lambda x: sphere(x) * float("nan"), "found 0 of 9"),
        (lambda x: 3.0, "got float"),
    ],
)
def test_functions_without_a_level_are_refused(f, words):
    with pytest.raises(ValueError, match=words):
        sample_sdf(f, 9, WIDE)


@pytest.mark.parametrize(
    "arguments, words",
    [
        ({"n": 0}, "`n` must be a whole number of at least 1, got 0"),
        ({"iterations": 0}, "`iterations`"),
        ({"bounds": (1, -1)}, "`bounds` must grow from low to high"),
        ({"bounds": (0, 1, 2)}, r"lowest and the highest corner \(2, 3\), got \(3,\)"),
        ({"bounds": (0, math.inf)}, "`bounds` must be finite"),
    ],
)
@pytest.mark.parametrize("sample", [sample_sdf, sample_occupancy])
def test_arguments_are_checked(sample, arguments, words):
    with pytest.raises(ValueError, match=words):
        sample(sphere, **({"n": 5, "bounds": WIDE} | arguments))


# ------------------------------------------------------------------------------------ occupancies


@pytest.mark.parametrize("f", [sphere, torus, box])
def test_crossings_of_an_occupancy_lie_on_the_surface(f):
    points, width = sample_occupancy(lambda x: f(x) < 0, 2000, WIDE, dtype=torch.float64)
    assert points.shape == (2000, 3) and width.max() < 3 * math.sqrt(3) / 2**20 * 1.01
    assert (f(points).abs() <= width / 2 + 1e-12).all()
    assert len(points.unique(dim=0)) > 1990


def test_probabilities_logits_and_signs():
    for g, level in (
        (lambda x: torch.sigmoid(-9 * sphere(x)), 0.5),
        (lambda x: -9 * sphere(x)[:, None], 0.0),
        (lambda x: -sphere(x).sign(), 0.0),
    ):
        points = sample_occupancy(g, 100, WIDE, level=level).points
        assert (points.norm(dim=-1) - 1).abs().max() < 1e-5


def test_a_small_inside_is_found_and_used_again():
    points = sample_occupancy(lambda x: sphere(10 * x) < 0, 3000, WIDE).points
    assert points.shape == (3000, 3) and (points.norm(dim=-1) - 0.1).abs().max() < 1e-5
    assert len(points.unique(dim=0)) > 2900


def test_occupancies_are_chunked_and_seeded():
    sizes = []

    def counted(x: Tensor) -> Tensor:
        sizes.append(len(x))
        return sphere(x) < 0

    once = sample_occupancy(lambda x: sphere(x) < 0, 200, WIDE).points
    assert torch.equal(once, sample_occupancy(counted, 200, WIDE, chunk_size=70).points)
    assert max(sizes) == 70
    assert not torch.equal(once, sample_occupancy(counted, 200, WIDE, seed=1).points)


def test_all_or_nothing_is_refused():
    with pytest.raises(ValueError, match=r"must be above `level` = 0\.5 .* none of \d+ points"):
        sample_occupancy(lambda x: torch.zeros(len(x)), 5, WIDE)
    with pytest.raises(ValueError, match="must be below"):
        sample_occupancy(lambda x: torch.ones(len(x)), 5, WIDE)
