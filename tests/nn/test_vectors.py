"""Transport of coordinates against transport of ambient vectors, and means of parallel fields."""

import torch
from nn.geometry import packed, permuted, plane, sphere
from torch.autograd import gradcheck

from riemlayer.nn import ParallelTransport, VectorPool


def coordinates(frame, v):
    """(N, 2) of ambient vectors (N, 3)."""
    return (v[:, None] @ frame[..., :2]).squeeze(1)


def ambient(frame, x):
    """(N, 3) of coordinates (N, 2)."""
    return (frame[..., :2] @ x[..., None]).squeeze(-1)


def test_coordinates_are_carried_as_the_sphere_carries_vectors():
    case = sphere()
    points, g = case.cloud.points, case.geometry
    sender, receiver = g.edge_index
    x = torch.randn(40, 2, dtype=torch.float64)
    v = ambient(g.frame, x)[sender]
    expected = case.cloud.transport(points[sender], points[receiver], v)
    carried = ParallelTransport()(x[:, None], g).squeeze(1)
    torch.testing.assert_close(ambient(g.frame[receiver], carried), expected)


def test_a_parallel_field_is_its_own_mean():
    case = plane()
    field = torch.tensor([[0.3, -1.2, 0.0]], dtype=torch.float64).expand(40, 3)
    x = coordinates(case.geometry.frame, field)[:, None]
    torch.testing.assert_close(VectorPool()(x, case.geometry), x)


def test_the_mean_is_half_the_receiver_and_half_its_carried_neighbours():
    case = sphere()
    x = torch.randn(40, 3, 2, dtype=torch.float64)
    carried = ParallelTransport()(x, case.geometry)
    weighted = (case.geometry.weight[:, None, None] * carried).view(40, 7, 3, 2).sum(1)
    torch.testing.assert_close(VectorPool()(x, case.geometry), (x + weighted) / 2)


def test_means_of_a_random_field_shrink_it():
    x = torch.randn(200, 1, 2, dtype=torch.float64)
    y = VectorPool()(x, sphere(200).geometry)
    assert float(y.norm(dim=-1).mean()) < 0.75 * float(x.norm(dim=-1).mean())


def test_carrying_is_told_of_edges_in_any_order_of_the_points():
    case, order = sphere(), torch.randperm(40)
    other = permuted(case, order)
    x = torch.randn(40, 3, 2, dtype=torch.float64)
    carried, again = (
        ParallelTransport()(x, case.geometry),
        ParallelTransport()(x[order], other.geometry),
    )
    ends, others = case.geometry.edge_index, order[other.geometry.edge_index]
    place = [(40 * b + a).argsort() for a, b in (ends, others)]
    torch.testing.assert_close(again[place[1]], carried[place[0]])


def test_carrying_in_a_packed_batch_is_that_of_its_clouds_one_by_one():
    together, alone = packed(20, 33, 12)
    x = torch.randn(65, 3, 2, dtype=torch.float64)
    parts = zip(x.split((20, 33, 12)), alone, strict=True)
    expected = torch.cat([ParallelTransport()(y, case.geometry) for y, case in parts])
    torch.testing.assert_close(ParallelTransport()(x, together.geometry), expected)


def test_gradients_of_carrying_agree_with_differences():
    g = sphere(5, 3).geometry
    x = torch.randn(5, 2, 2, dtype=torch.float64, requires_grad=True)
    angle = g.transport.clone().requires_grad_()
    carry = ParallelTransport()
    assert gradcheck(lambda x, t: carry(x, g._replace(transport=t)), (x, angle))
