"""The polar grid: values at nodes, between them, and what constant features become."""

import math

import pytest
import torch
from nn.geometry import sphere

from riemlayer.nn import GeodesicConv, TangentConv
from riemlayer.nn.polar import angular_max, polar_shares


def single(r: float, theta: float):
    """Point 0 with one neighbour, point 1, at a polar place; the radius is 1."""
    g = sphere(2, k=1).geometry
    one = torch.ones(1, dtype=torch.float64)
    return g._replace(
        edge_index=torch.tensor([[1], [0]]),
        r=r * one,
        theta=theta * one,
        weight=one,
        valid=g.valid[:1],
        radius=torch.ones(2, dtype=torch.float64),
    )


def shares(r: float, theta: float, rings: int = 2, count: int = 4) -> dict[int, float]:
    index, share = polar_shares(single(r, theta), rings, count)
    out: dict[int, float] = {}
    for i, s in zip(index[0].tolist(), share[0].tolist(), strict=True):
        out[i] = out.get(i, 0) + s
    return {i: s for i, s in out.items() if s > 1e-12}


def test_shares_at_nodes_and_halfway():
    quarter = math.pi / 2
    assert shares(0, 1.23) == pytest.approx({0: 1})
    assert shares(0.5, 0) == pytest.approx({1: 1})
    assert shares(1, quarter) == pytest.approx({6: 1})
    assert shares(7, quarter) == pytest.approx({6: 1})  # beyond the border: on it
    assert shares(0.25, 0) == pytest.approx({0: 0.5, 1: 0.5})
    assert shares(0.75, quarter / 2) == pytest.approx({1: 0.25, 2: 0.25, 5: 0.25, 6: 0.25})
    assert shares(0.5, -quarter / 4) == pytest.approx({4: 0.25, 1: 0.75})


def test_shares_have_no_seam():
    both = shares(0.7, math.pi - 1e-9, count=5), shares(0.7, -math.pi + 1e-9, count=5)
    assert both[0] == pytest.approx(both[1], abs=1e-7)


def test_shares_of_an_edge_sum_to_one_and_name_nodes():
    index, share = polar_shares(sphere().geometry, 3, 5)
    torch.testing.assert_close(share.sum(-1), torch.ones(280, dtype=torch.float64))
    assert bool((share >= 0).all()) and int(index.min()) >= 0 and int(index.max()) == 15


def test_a_neighbour_at_a_node_meets_the_matrix_there():
    layer = TangentConv(3, 4, rings=2, angles=4).double()
    x = torch.randn(2, 3, dtype=torch.float64)
    y = layer(x, single(1.0, math.pi / 2))
    torch.testing.assert_close(y[0], layer.centre(x[0]) + x[1] @ layer.kernel[1, 1])
    torch.testing.assert_close(y[1], layer.centre(x[1]))


def test_a_coincident_neighbour_meets_the_matrix_of_the_receiver():
    layer = TangentConv(3, 4).double()
    x = torch.randn(2, 3, dtype=torch.float64)
    y = layer(x, single(0.0, 0.3))
    torch.testing.assert_close(y[0], layer.centre(x[0] + x[1]))


@pytest.mark.parametrize("kind", [TangentConv, GeodesicConv])
def test_with_one_matrix_everywhere_it_is_a_weighted_mean(kind):
    layer, g = kind(3, 4).double(), sphere().geometry
    with torch.no_grad():
        layer.kernel.copy_(layer.centre.weight.T.expand_as(layer.kernel))
    x = torch.randn(40, 3, dtype=torch.float64)
    sender = g.edge_index[0]
    mean = (g.weight[:, None] * x[sender]).view(40, 7, 3).sum(1)
    torch.testing.assert_close(layer(x, g), layer.centre(x + mean))
    constant = torch.ones_like(x)
    torch.testing.assert_close(layer(constant, g), layer(constant, g)[:1].expand(40, 4))


def test_the_angular_maximum_is_that_of_a_loop():
    patch, kernel = torch.randn(6, 2 * 5 * 3), torch.randn(2, 5, 3, 4)
    expected = torch.full((6, 4), -torch.inf)
    for s in range(5):
        response = torch.zeros(6, 4)
        for k in range(2):
            for a in range(5):
                response += patch.view(6, 2, 5, 3)[:, k, a] @ kernel[k, (a - s) % 5]
        expected = torch.maximum(expected, response)
    torch.testing.assert_close(angular_max(patch, kernel), expected)
