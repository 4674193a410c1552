"""Loss values on Jacobians and maps that one can do in the head."""

from dataclasses import replace

import pytest
import torch
from references import encoded
from torch.autograd import gradcheck

from riemlayer.losses import (
    LossWeights,
    Truth,
    conformal_loss,
    cycle_loss,
    explog_losses,
    isometric_loss,
    mean_over_shapes,
    pair_loss,
    reconstruction_loss,
    self_supervised_losses,
    validity_loss,
    weighted_mean,
)
from riemlayer.surface import EncodedSurface


def double(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, dtype=torch.float64)


def rotations(n: int = 20) -> torch.Tensor:
    return torch.linalg.qr(double(n, 3, 3))[0]


def test_a_rotation_costs_nothing():
    assert isometric_loss(rotations()) < 1e-12 and conformal_loss(rotations()) < 1e-12


@pytest.mark.parametrize("s", [0.0, 0.5, 1.0, 2.0])
def test_a_scaling_costs_isometry_alone(s):
    J = s * rotations()
    assert float(isometric_loss(J)) == pytest.approx(3 * abs(s * s - 1), abs=1e-12)
    assert conformal_loss(J) < 1e-12


def test_a_shear_costs_both():
    J = torch.tensor([[1.0, 2, 0], [0, 1, 0], [0, 0, 1]])  # M = [[1, 2, 0], [2, 5, 0], [0, 0, 1]]
    assert isometric_loss(J) == 4 and conformal_loss(J) == 4


def test_tangent_form_does_not_see_the_normal_direction():
    frame = torch.eye(3)[:, :2]
    J = torch.diag(torch.tensor([1.0, 1.0, 7.0]))
    assert isometric_loss(J @ frame) == 0 and isometric_loss(J) == 48


def test_geometric_losses_average_over_queries():
    J = torch.stack((torch.eye(3), 2 * torch.eye(3)))
    assert isometric_loss(J) == 4.5


def test_reconstruction_is_the_weighted_l1():
    predicted, truth = torch.zeros(2, 3), torch.tensor([[1.0, -2, 3], [0.5, 0, 0]])
    assert reconstruction_loss(predicted, truth, torch.tensor([1.0, 1.0])) == 3.25
    assert reconstruction_loss(predicted, truth, torch.tensor([1.0, 3.0])) == 7.5 / 4
    assert reconstruction_loss(predicted, truth, torch.zeros(2)) == 0


def test_the_weight_zero_leaves_gradients_finite():
    x = torch.ones(2, 3, requires_grad=True)
    reconstruction_loss(x, torch.zeros(2, 3), torch.zeros(2)).backward()
    assert x.grad is not None and (x.grad == 0).all()


def test_an_exact_inverse_pair_has_no_cycle_error():
    turn, v = rotations(1)[0], double(30, 3)
    assert cycle_loss((v @ turn) @ turn.T, v, torch.ones(30)) < 1e-12
    assert cycle_loss(v + 1, v, torch.ones(30)) == pytest.approx(3)


def test_a_constant_error_costs_no_pair_loss():
    error = torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64).expand(4, 10, 3)
    assert pair_loss(error, double(4, 10, 3), torch.ones(4, 10)) == 0


def test_pair_loss_is_change_of_error_over_distance():
    error = torch.tensor([[0.0, 0, 0], [0, 0, 0], [0.1, 0, 0], [0, 0, 0.6]])
    apart = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0], [1, 2, 0]])
    both = pair_loss(error, apart, torch.ones(4))
    torch.testing.assert_close(both, torch.tensor((0.1 / 0.5 + 0.6 / 2) / 2))
    left_out = pair_loss(error, apart, torch.tensor([1.0, 1, 1, 0]))
    torch.testing.assert_close(left_out, torch.tensor(0.2))


def test_validity_is_the_cross_entropy_of_known_labels():
    logit, valid = torch.tensor([0.0, 100.0, -100.0]), torch.tensor([True, True, True])
    known = torch.tensor([True, True, False])
    torch.testing.assert_close(validity_loss(logit, valid, known), torch.tensor(2.0).log() / 2)
    assert validity_loss(logit, valid, torch.zeros(3, dtype=torch.bool)) == 0


def test_gradcheck():
    J, x, w = (y.requires_grad_() for y in (double(3, 3, 3), double(4, 3), double(4).abs()))
    truth = double(4, 3)
    assert gradcheck(isometric_loss, J) and gradcheck(conformal_loss, J)
    assert gradcheck(lambda x, w: reconstruction_loss(x, truth, w), (x, w))
    assert gradcheck(lambda x: pair_loss(x, truth, w.detach()), x)
    assert gradcheck(weighted_mean, (x[:, 0].detach().requires_grad_(), w))


@pytest.mark.parametrize("name", ["rec", "geo", "cyc", "pairs", "validity"])
def test_negative_weights_raise(name):
    with pytest.raises(ValueError, match=f"{name} must not be negative, got -1"):
        LossWeights(**{name: -1})


def test_the_papers_weights_are_the_defaults():
    weights = LossWeights()
    assert (weights.rec, weights.geo, weights.cyc) == (1.0, 0.01, 0.01)
    assert weights.pairs == 0 and not weights.relative


def truth_of(surface, s: int = 3, k: int = 16) -> Truth:
    """Ground truth that the surface itself answers."""
    p, v = 0.7 * double(s, 3), 0.2 * double(s, k, 3)
    shape = torch.zeros(s, dtype=torch.long)
    valid = torch.ones(s, k, dtype=torch.bool)
    q = surface.exp(p[:, None], v).detach()
    return Truth(p, v, q, valid, valid, shape)


def test_the_field_that_made_the_truth_has_no_exp_loss():
    surface = encoded()
    losses = explog_losses(surface, truth_of(surface), LossWeights(pairs=1.0))
    assert losses["exp"] < 1e-12 and losses["log"] > 1e-3


def test_the_total_is_the_weighted_sum_of_its_terms():
    surface, w = encoded(), LossWeights(1.0, 0.3, 0.7, 0.2, 0.1, relative=True)
    terms = explog_losses(surface, truth_of(surface), w)
    assert set(terms) == {
        "total", "exp", "log", "pairs", "cycle", "isometric", "conformal", "validity"
    }  # fmt: skip
    expected = (
        w.rec * (terms["exp"] + terms["log"])
        + w.geo * (terms["isometric"] + terms["conformal"])
        + w.cyc * terms["cycle"]
        + w.pairs * terms["pairs"]
        + w.validity * terms["validity"]
    )
    torch.testing.assert_close(terms["total"], expected)


def test_terms_of_weight_zero_are_not_computed():
    surface = encoded()
    weights = LossWeights(geo=0, cyc=0, pairs=0, validity=0)
    assert set(explog_losses(surface, truth_of(surface), weights)) == {"total", "exp", "log"}


def test_queries_that_are_not_valid_or_known_do_not_count():
    surface = encoded()
    truth = truth_of(surface)
    keep = torch.rand(truth.valid.shape) < 0.5
    wrong = torch.where(keep[..., None], truth.q, truth.q + 9)
    for labels in ((keep, truth.known), (truth.valid, keep)):
        masked = Truth(truth.p, truth.v, wrong, *labels, truth.shape)
        losses = explog_losses(surface, masked, LossWeights(pairs=1.0, geo=0))
        assert losses["exp"] < 1e-12


@pytest.mark.parametrize("supervised", [True, False], ids=["supervised", "self-supervised"])
def test_eq_3_leaves_out_queries_where_the_map_jumps(monkeypatch, supervised):
    """They add nothing to the terms, and their gradient is 0, however steep the jump."""
    surface = encoded()
    truth, weights = truth_of(surface), LossWeights()
    jump = torch.tensor(0.0, requires_grad=True)
    for name in ("jacobian_exp", "jacobian_log"):
        own = getattr(EncodedSurface, name)

        def jumping(self, p, x, own=own, **how):
            value, J = own(self, p, x, **how)
            steep = torch.zeros(J.shape[:2], dtype=J.dtype)
            steep[:, 0] = 1e8
            return value, torch.eye(3, dtype=J.dtype) * (1 + steep * (1 + jump))[..., None, None]

        monkeypatch.setattr(EncodedSurface, name, jumping)
    if supervised:
        terms = explog_losses(surface, truth, weights)
    else:
        terms = self_supervised_losses(surface, weights)
    eq_3 = terms["isometric"] + terms["conformal"]
    assert eq_3 < 1e-12
    eq_3.backward()
    assert jump.grad == 0


def test_lengths_are_measured_in_the_cube():
    """A cloud in other units, with its truth, costs the same."""
    points = torch.nn.functional.normalize(double(200, 3), dim=-1)
    field = encoded().field
    costs = []
    for s, t in ((1.0, 0.0), (40.0, 300.0)):
        surface = field.encode(s * points + t)
        torch.manual_seed(5)
        truth = truth_of(field.encode(points))
        moved = Truth(
            s * truth.p + t,
            s * truth.v,
            s * (truth.q + 0.01) + t,
            truth.valid,
            truth.known,
            truth.shape,
        )
        costs.append(explog_losses(surface, moved, LossWeights(pairs=0.1)))
    for name, cost in costs[0].items():
        torch.testing.assert_close(costs[1][name], cost, rtol=1e-8, atol=1e-10, msg=name)


def test_gradients_are_finite_when_queries_sit_at_the_source():
    surface = encoded()
    field = surface.field
    points = torch.nn.functional.normalize(double(200, 3), dim=-1)
    p = points[:2]
    zero = p[:, None].expand(2, 16, 3)
    flags = torch.ones(2, 16, dtype=torch.bool)
    truth = Truth(p, zero * 0, zero, flags, flags, torch.zeros(2, dtype=torch.long))
    weights = LossWeights(pairs=1.0, geo=1.0, cyc=1.0, relative=True)
    explog_losses(field.encode(points), truth, weights)["total"].backward()
    for name, parameter in field.named_parameters():
        assert parameter.grad is None or parameter.grad.isfinite().all(), name


def part_of(points: torch.Tensor, batch: torch.Tensor, truth: Truth, i: int):
    """One cloud of a packed batch, and its rows of the truth."""
    row = truth.shape == i
    own = Truth(*(x[row] for x in (truth.p, truth.v, truth.q, truth.valid, truth.known)), None)
    return points[batch == i], replace(own, shape=torch.zeros(int(row.sum()), dtype=torch.long))


def test_every_shape_of_a_batch_counts_alike():
    """Loss and gradient of a packed batch are the means of those of its shapes.

    However many sources, valid queries and pairs each one has: 3, 1 and none that counts.
    """
    field = encoded().field
    points, batch = double(600, 3).clamp(-1, 1), torch.arange(3).repeat_interleave(200)
    p, v = 0.5 * double(6, 3), 0.2 * double(6, 16, 3)
    valid, known = torch.rand(2, 6, 16) < 0.7
    valid[4:] = False
    truth = Truth(p, v, p[:, None] + v, valid, known, torch.tensor([0, 0, 0, 1, 2, 2]))
    weights = LossWeights(1.0, 0.3, 0.7, 0.2, 0.1, relative=True)

    def total(points, batch, truth):
        losses = explog_losses(field.encode_in_cube(points, batch), truth, weights)
        gradient = torch.autograd.grad(losses["total"], list(field.parameters()))
        return losses["total"].detach(), torch.cat([x.flatten() for x in gradient])

    packed = total(points, batch, truth)
    parts = [part_of(points, batch, truth, i) for i in range(3)]
    alone = [total(x, torch.zeros(len(x), dtype=torch.long), own) for x, own in parts]
    for i in range(2):
        expected = torch.stack([x[i] for x in alone]).mean(0)
        torch.testing.assert_close(packed[i], expected, rtol=1e-8, atol=1e-10)


def test_the_mean_over_shapes_is_that_of_a_loop():
    x, shape = double(7, 2), torch.tensor([0, 0, 1, 1, 1, 2, 2])
    found = mean_over_shapes(shape, 3, lambda x: x.square().mean(), x)
    rows = [x[:2], x[2:5], x[5:]]
    torch.testing.assert_close(found, sum(y.square().mean() for y in rows) / 3)
