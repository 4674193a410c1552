"""Transport of coordinates against transport of ambient vectors, and means of parallel fields."""

import torch
from nn.geometry import plane, sphere

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
