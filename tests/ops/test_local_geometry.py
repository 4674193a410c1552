"""The record that feeds the layers: directions, frames, weights, and what it does not depend on."""

import math

import pytest
import torch
from references import fibonacci_sphere

from riemlayer import ExpLogField
from riemlayer.ops import local_geometry, orient


@pytest.fixture(scope="module")
def field():
    torch.manual_seed(0)
    return ExpLogField.from_preset("tiny").eval()


@pytest.fixture(scope="module")
def cloud():
    return fibonacci_sphere(700).float()


@pytest.fixture(scope="module")
def geometry(field, cloud):
    with torch.no_grad():
        return local_geometry(field.encode(cloud), k=10)


def test_edges_join_each_receiver_to_its_nearest_others(geometry, cloud):
    sender, receiver = geometry.edge_index
    assert torch.equal(receiver, torch.arange(700).repeat_interleave(10))
    assert bool((sender != receiver).all())
    distance = torch.cdist(cloud, cloud).fill_diagonal_(torch.inf)
    farthest = distance.topk(10, largest=False)[0][:, -1]
    chord = (cloud[sender] - cloud[receiver]).norm(dim=-1)
    assert bool((chord <= farthest[receiver] + 1e-6).all())


def test_log_is_that_of_the_receiver_in_its_frame(field, geometry, cloud):
    sender, receiver = geometry.edge_index
    with torch.no_grad():
        v = field.encode(cloud).log(cloud[receiver], cloud[sender])
    x = (v[:, None] @ geometry.frame[receiver, :, :2]).squeeze(1)
    torch.testing.assert_close(geometry.log, x, rtol=1e-4, atol=1e-4)
    polar = geometry.r[:, None] * torch.stack((geometry.theta.cos(), geometry.theta.sin()), -1)
    torch.testing.assert_close(geometry.log, polar, rtol=1e-5, atol=1e-5)


def test_weights_are_a_partition_of_unity_over_valid_edges(geometry):
    total = torch.zeros(700).index_add(0, geometry.edge_index[1], geometry.weight)
    has = torch.zeros(700).index_add(0, geometry.edge_index[1], geometry.valid.float()) > 0
    torch.testing.assert_close(total, has.float())
    assert bool((geometry.weight[~geometry.valid] == 0).all())


def test_normals_agree_all_over_a_closed_surface(geometry, cloud):
    outward = (geometry.frame[..., 2] * cloud).sum(-1)
    assert float(outward.abs().min()) > 0.95
    assert len(outward.sign().unique()) == 1
    torch.testing.assert_close(torch.linalg.det(geometry.frame), torch.ones(700))


def carried(geometry, v):
    """Ambient tangent vectors v (E, 3) at the neighbours, at the receivers after transport."""
    sender, receiver = geometry.edge_index
    x = (v[:, None] @ geometry.frame[sender, :, :2]).squeeze(1)
    c, s = geometry.transport.cos(), geometry.transport.sin()
    y = torch.stack((c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1]), -1)
    return (geometry.frame[receiver, :, :2] @ y[..., None]).squeeze(-1)


def tangents(geometry):
    """A random tangent vector (E, 3) at each edge's neighbour."""
    normal = geometry.frame[geometry.edge_index[0], :, 2]
    v = torch.randn_like(normal)
    return v - (v * normal).sum(-1, keepdim=True) * normal


def test_transport_is_the_smallest_turn_between_normals(geometry):
    sender, receiver = geometry.edge_index
    v, (n, m) = tangents(geometry), (geometry.frame[i, :, 2] for i in (sender, receiver))
    cosine = (n * m).sum(-1, keepdim=True)
    expected = v - (v * m).sum(-1, keepdim=True) / (1 + cosine) * (n + m)
    torch.testing.assert_close(carried(geometry, v), expected, rtol=1e-4, atol=1e-4)


def test_there_and_back_is_no_turn(geometry):
    sender, receiver = geometry.edge_index
    there = {(int(s), int(r)): float(t) for s, r, t in zip(sender, receiver, geometry.transport)}  # noqa: B905
    pairs = [(t, there[r, s]) for (s, r), t in there.items() if (r, s) in there]
    assert len(pairs) > 1000
    assert max(abs(math.sin((a + b) / 2)) for a, b in pairs) < 1e-4


def test_told_in_other_frames_it_is_the_same_geometry(geometry):
    angle = torch.rand(700) * 6
    turned = geometry.turned(angle)
    receiver = geometry.edge_index[1]

    def ambient(g):
        return (g.frame[receiver, :, :2] @ g.log[..., None]).squeeze(-1)

    torch.testing.assert_close(ambient(turned), ambient(geometry), rtol=1e-5, atol=1e-5)

    v = tangents(geometry)
    torch.testing.assert_close(carried(turned, v), carried(geometry, v), rtol=1e-4, atol=1e-4)
    assert not torch.allclose(turned.transport, geometry.transport)


def test_the_order_of_the_points_does_not_matter(field, geometry, cloud):
    order = torch.randperm(700)
    with torch.no_grad():
        mixed = local_geometry(field.encode(cloud[order]), k=10)
    back = {(int(order[s]), int(order[r])): i for i, (s, r) in enumerate(mixed.edge_index.T)}
    index = torch.tensor([back[int(s), int(r)] for s, r in geometry.edge_index.T])
    torch.testing.assert_close(mixed.r[index], geometry.r, rtol=1e-3, atol=1e-4)
    torch.testing.assert_close(mixed.weight[index], geometry.weight, rtol=1e-2, atol=1e-3)


def test_a_packed_batch_is_its_clouds_one_by_one(field, cloud):
    other = 2 * fibonacci_sphere(500).float() + 1
    batch = torch.cat((torch.zeros(700), torch.ones(500))).long()
    with torch.no_grad():
        surface = field.encode(torch.cat((cloud, other)), batch)
        both = local_geometry(surface, k=6)
        second = local_geometry(surface[1], k=6)
        alone = local_geometry(field.encode(other), k=6)
    mine = both.edge_index[1] >= 700
    assert torch.equal(both.edge_index[:, mine] - 700, alone.edge_index)
    assert torch.equal(second.edge_index, alone.edge_index)
    for name in ("log", "transport", "weight", "radius"):
        x = getattr(both, name)[mine if name != "radius" else slice(700, None)]
        torch.testing.assert_close(x, getattr(alone, name), rtol=1e-4, atol=1e-4)
        torch.testing.assert_close(
            getattr(second, name), getattr(alone, name), rtol=1e-4, atol=1e-4
        )


def test_a_radius_takes_all_within_a_geodesic_distance(field, cloud):
    with torch.no_grad():
        surface = field.encode(cloud)
        near = local_geometry(surface, radius=0.2)
        log = surface.cdist(cloud[:5], cloud)
    assert float(near.r.max()) <= 0.2
    for i in range(5):
        expected = (log[i] <= 0.2) & ((cloud - cloud[i]).norm(dim=-1) <= 0.2)
        expected[i] = False
        own = near.edge_index[0, near.edge_index[1] == i]
        assert sorted(own.tolist()) == expected.nonzero().squeeze(-1).tolist()


def test_an_empty_neighbourhood_is_flagged_and_nothing_is_nan(field, cloud):
    with torch.no_grad():
        geometry = local_geometry(field.encode(cloud), radius=1e-4)
    assert geometry.edge_index.shape == (2, 0)
    assert bool((geometry.radius == 0).all()) and bool(geometry.frame.isfinite().all())


def test_coincident_points_have_finite_answers_and_gradients(field, cloud):
    points = torch.cat((cloud, cloud[:5])).requires_grad_()
    geometry = local_geometry(field.encode(points), k=4)
    (geometry.theta.sum() + geometry.r.sum() + geometry.transport.sum()).backward()
    assert bool((geometry.r < 1e-6).any())
    assert all(bool(x.isfinite().all()) for x in geometry)
    assert points.grad is not None and bool(points.grad.isfinite().all())


def test_signs_do_not_leak_through_a_thin_plate():
    x = torch.linspace(-0.5, 0.5, 25)
    grid = torch.stack((*torch.meshgrid(x, x, indexing="ij"), torch.zeros(25, 25)), -1).view(-1, 3)
    points = torch.cat((grid + torch.tensor([0, 0, 0.01]), grid - torch.tensor([0, 0, 0.01])))
    normal = torch.tensor([0.0, 0, 1]) * torch.randn(1250, 1).sign()
    near = torch.cdist(points, points).topk(10, largest=False)[1][:, 1:]
    signed = orient(normal, points, near, torch.zeros(1250).long())[:, 2]
    assert len(signed[:625].unique()) == len(signed[625:].unique()) == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"k": 0}, "k must be at least 1, got 0"),
        ({"radius": -1.0}, "radius must be positive, got -1.0"),
        ({"k": 5000}, "fewer"),
    ],
)
def test_what_cannot_be_done_is_said(field, cloud, options, words):
    with pytest.raises(ValueError, match=words):
        local_geometry(field.encode(cloud), **options)
