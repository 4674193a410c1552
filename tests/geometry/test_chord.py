"""Chords laid flat and bent: first logs that need no walk."""

import pytest
import torch
from references import fibonacci_sphere, lumpy
from torch import Tensor
from torch.nn.functional import normalize

from riemlayer.data.closed_form import Cylinder, Sphere
from riemlayer.geometry import bend, lay_flat
from riemlayer.octree import HALF_WIDTH

CELL = 2 * HALF_WIDTH / 2**6


def bent_by(n: Tensor, x: Tensor, cell: float = CELL) -> Tensor:
    """Bent chords, of normals that turn as on a unit sphere around the origin."""
    return bend(n, x, normalize(n[:, None] + x, dim=-1), cell)


FIRST_LOGS = {"flat": lay_flat, "bent": bent_by}


@pytest.mark.parametrize("first_log", FIRST_LOGS.values(), ids=FIRST_LOGS)
def test_they_keep_the_length_and_land_on_the_tangent_plane(first_log):
    p = fibonacci_sphere(50)
    v = torch.linalg.cross(p, torch.randn_like(p))
    v = 0.5 * normalize(v, dim=-1)
    chord = (Sphere().exp(p, v) - p)[:, None]
    log = first_log(p, chord, CELL).squeeze(1)
    assert ((log * p).sum(-1).abs() < 1e-2).all()
    torch.testing.assert_close(log.norm(dim=-1), chord.norm(dim=-1).squeeze(-1), rtol=0.02, atol=0)
    torch.testing.assert_close(log, v, rtol=0, atol=0.02)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("first_log", FIRST_LOGS.values(), ids=FIRST_LOGS)
def test_they_are_the_identity_to_first_order(first_log, dtype):
    n = normalize(lumpy(300)[:20], dim=-1).to(dtype)
    zero = torch.zeros(20, 1, 3, dtype=dtype, requires_grad=True)
    assert torch.equal(first_log(n, zero, CELL), zero)
    for axis in torch.eye(3, dtype=dtype):
        direction = axis.expand(20, 1, 3)
        _, moved = torch.func.jvp(lambda x: first_log(n, x, CELL), (zero.detach(),), (direction,))
        assert torch.equal(moved, direction)
    first_log(n, zero, CELL).sum().backward()
    assert zero.grad is not None and torch.equal(zero.grad, torch.ones_like(zero))


@pytest.mark.parametrize("first_log", FIRST_LOGS.values(), ids=FIRST_LOGS)
def test_chords_along_the_normal_shrink(first_log):
    n = fibonacci_sphere(30)
    log = first_log(n, -0.5 * n[:, None], CELL)
    assert (log.norm(dim=-1) < 0.01).all()


def test_bent_chords_are_right_to_the_third_order():
    """Helices of a cylinder: the error of a flat chord falls by 8 when they are half as long."""
    cylinder, cell = Cylinder(), CELL / 8  # hardly any fading in
    p = cylinder.sample(200)
    n = cylinder.normal(p)
    v = cylinder.project_to_tangent(p, torch.randn_like(p))
    errors = []
    for length in (0.6, 0.3):
        w = length * normalize(v, dim=-1)
        q = cylinder.exp(p, w)
        flat = lay_flat(n, (q - p)[:, None], cell).squeeze(1)
        bent = bend(n, (q - p)[:, None], cylinder.normal(q)[:, None], cell).squeeze(1)
        errors.append([float((y - w).norm(dim=-1).mean()) for y in (flat, bent)])
    (flat, bent), (half_flat, half_bent) = errors
    assert 6 < flat / half_flat < 10 and bent / half_bent > 14, errors
    assert bent < flat / 10, errors


def test_the_sign_of_the_normal_at_the_end_has_no_meaning():
    n = normalize(lumpy(300)[:3], dim=-1)
    end, x = normalize(torch.randn(3, 40, 3).double(), dim=-1), 0.2 * torch.randn(3, 40, 3).double()
    assert torch.equal(bend(n, x, end, CELL), bend(n, x, -end, CELL))


def test_bent_chords_can_be_differentiated():
    n = normalize(lumpy(300)[:3], dim=-1)
    end = normalize(n[:, None] + 0.3 * torch.randn(3, 4, 3).double(), dim=-1)
    inputs = [y.requires_grad_() for y in (n, 0.2 * torch.randn(3, 4, 3).double(), end)]
    run = lambda n, x, end: bend(n, x, end, CELL)  # noqa: E731
    assert torch.autograd.gradcheck(run, inputs, check_forward_ad=True)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("length", [0, 1e-25, 1e-12, 0.2])
def test_second_derivatives_are_bounded_at_the_source_and_where_nothing_turns(length, dtype):
    """Eq. (3) trains on first ones; a plane's ends lie level with its source but for rounding."""
    n = normalize(lumpy(300)[:20], dim=-1).to(dtype).requires_grad_()
    x = torch.linalg.cross(n.detach()[:, None].expand(20, 8, 3), torch.randn(20, 8, 3).to(dtype))
    x = length * normalize(x, dim=-1)

    def log(x: Tensor) -> Tensor:
        end = n[:, None].expand_as(x)
        return bend(n, x, end / end.square().sum(-1, keepdim=True).sqrt(), CELL)

    for axis in torch.eye(3, dtype=dtype):
        _, moved = torch.func.jvp(log, (x,), (axis.expand_as(x),))
        (gradient,) = torch.autograd.grad(moved.sum(), n)
        assert gradient.abs().max() < 8 / CELL, gradient.abs().max()
