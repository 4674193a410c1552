"""Several orientations of a cloud: exact at the source, and less dependent on the octree."""

import pytest
import torch
from references import lumpy, packed, shaken

from riemlayer.ops import ViewedSurface, encode_views

FIELD = shaken("tiny", strength=0.2)


def tangents(p: torch.Tensor, k: int, length: float) -> torch.Tensor:
    """(S, k, 3) vectors of that length, roughly tangent at p (S, 3) on a lumpy sphere."""
    generator = torch.Generator().manual_seed(k)
    v = torch.randn(len(p), k, 3, generator=generator, dtype=p.dtype)
    v = torch.linalg.cross(v, p[:, None].expand_as(v))
    return length * torch.nn.functional.normalize(v, dim=-1)


def test_one_view_is_the_cloud_as_it_is():
    points = lumpy(400)
    p, v = points[:5, None], tangents(points[:5], 7, 0.3)
    one, plain = encode_views(FIELD, points, views=1), FIELD.encode(points)
    assert torch.equal(one.exp(p, v), plain.exp(p, v))
    assert torch.equal(one.log(p, p + v), plain.log(p, p + v))


def test_answers_are_means_over_turned_clouds():
    points = lumpy(400)
    p, v = points[:5, None], tangents(points[:5], 7, 0.3)
    surface = encode_views(FIELD, points, views=3)
    exps, logs = [], []
    for turn in (torch.eye(3).double(), *(view.turn for view in surface.views)):
        torch.testing.assert_close(turn @ turn.T, torch.eye(3).double())
        assert torch.linalg.det(turn) > 0
        # beside a box of fixed size the cloud is encoded at the same scale in each orientation
        turned = (points - surface.centre) @ turn.T
        width = torch.maximum(surface.scale, turned.abs().max())
        plain = FIELD.encode_in_cube(turned / width, torch.zeros(400).long())
        own = (p - surface.centre) @ turn.T / width
        exps.append(plain.exp(own, v @ turn.T / width) @ turn * width + surface.centre)
        logs.append(plain.log(own, own + v @ turn.T / width) @ turn * width)
    torch.testing.assert_close(surface.exp(p, v), sum(exps) / 3)
    torch.testing.assert_close(surface.log(p, p + v), sum(logs) / 3)


def test_exact_at_the_source_with_the_identity_as_differential():
    points = lumpy(400)
    surface = encode_views(FIELD, points, views=3)
    p = points[:6]
    assert torch.equal(surface.exp(p, torch.zeros_like(p)), p)
    assert torch.equal(surface.log(p, p), torch.zeros_like(p))
    for J in (surface.jacobian_exp(p, torch.zeros_like(p))[1], surface.jacobian_log(p, p)[1]):
        torch.testing.assert_close(J, torch.eye(3).double().expand_as(J), rtol=0, atol=1e-9)


def test_a_turned_cloud_gets_more_similar_answers():
    """The weights are random, so answers differ with the orientation; their means differ less."""
    points = lumpy(600)
    p, v = points[:8, None], tangents(points[:8], 9, 0.35)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(9)).double())[
        0
    ]
    apart = []
    for views in (1, 6):
        here = encode_views(FIELD, points, views).exp(p, v)
        there = encode_views(FIELD, points @ turn.T, views).exp(p @ turn.T, v @ turn.T)
        apart.append(float((there @ turn - here).detach().norm(dim=-1).mean()))
    assert 0 < apart[1] < 0.75 * apart[0], apart


def test_a_batch_is_its_clouds_and_units_carry_through():
    a, b = lumpy(300), 1000 * lumpy(350) + 5
    points, batch = packed(a, b)
    both = encode_views(FIELD, points, 2, batch)
    for i, points in enumerate((a, b)):
        alone = encode_views(FIELD, points, views=2)
        assert isinstance(both[i], ViewedSurface)
        p, v = points[:4], tangents(points[:4] - points.mean(0), 1, 0.3 * float(alone.scale))[:, 0]
        torch.testing.assert_close(both[i].exp(p, v), alone.exp(p, v))
        torch.testing.assert_close(both[i].log(p, p + v), alone.log(p, p + v))


def test_gradients_reach_points_and_weights():
    points = lumpy(200).requires_grad_()
    surface = encode_views(FIELD, points, views=2)
    p = points.detach()[:4]
    FIELD.zero_grad()
    surface.exp(p, 0.3 * torch.ones_like(p)).square().sum().backward()
    assert points.grad is not None and points.grad.isfinite().all() and points.grad.any()
    assert FIELD.backbone.head.weight.grad is not None


def test_detached_and_moved_surfaces_keep_their_views():
    surface = encode_views(FIELD, lumpy(200).requires_grad_(), views=3)
    p = surface.points[:2].detach()
    v = torch.full_like(p, 0.1)
    for other in (surface.detach(), surface.to("cpu")):
        assert len(other.views) == 2
        torch.testing.assert_close(other.exp(p, v), surface.exp(p, v))
    known = [view.surface.embedding.z for view in surface.detach().views]
    assert not any(z.requires_grad for z in known)


@pytest.mark.parametrize("views", [0, -1, 1.5, "two", None, True])
def test_a_wrong_number_of_views_is_named(views):
    with pytest.raises(ValueError, match="`views` must be a whole number of at least 1"):
        encode_views(FIELD, lumpy(100), views)
