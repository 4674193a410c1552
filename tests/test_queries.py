"""Laying out broadcast queries, chunks, and value-and-Jacobian."""

import pytest
import torch
from laws import autograd_jacobians
from torch import Tensor

from riemlayer.heads import MapOutput
from riemlayer.queries import in_chunks, lay_out, value_and_jacobian


@pytest.mark.parametrize(
    "p, x, shape, sources, queries",
    [
        ((3,), (3,), (), 1, 1),
        ((5, 3), (5, 3), (5,), 5, 1),
        ((5, 1, 3), (5, 7, 3), (5, 1), 5, 7),
        ((3,), (5, 7, 3), (), 1, 35),
        ((2, 5, 1, 3), (2, 5, 7, 3), (2, 5, 1), 10, 7),
        ((2, 1, 1, 3), (2, 5, 7, 3), (2, 1, 1), 2, 35),
        ((1, 5, 1, 3), (2, 1, 7, 3), (1, 5, 1), 10, 7),
        ((1, 3), (4, 3), (4,), 4, 1),
        ((5, 3), (3,), (5,), 5, 1),
        ((0, 3), (0, 3), (0,), 0, 1),
        ((5, 1, 3), (5, 0, 3), (5, 1), 5, 0),
    ],
)
def test_sources_and_queries_are_those_of_broadcasting(p, x, shape, sources, queries):
    p, x, shape = torch.rand(p), torch.rand(x), torch.randint(3, shape)
    ps, xs, shapes = lay_out(p, x, shape)
    assert ps.shape == (sources, 3) and xs.shape == (sources, queries, 3)
    wide_p, wide_x = torch.broadcast_tensors(p, x)
    batch = torch.broadcast_shapes(wide_p.shape[:-1], shape.shape)
    rows = ps[:, None].expand(xs.shape).reshape(*batch, 3)
    assert torch.equal(rows, wide_p.expand(*batch, 3))
    assert torch.equal(xs.reshape(*batch, 3), wide_x.expand(*batch, 3))
    of_row = shapes[:, None].expand(xs.shape[:2]).reshape(batch)
    assert torch.equal(of_row, shape.expand(batch))


def head(p: Tensor, x: Tensor, shape: Tensor) -> MapOutput:
    """Some function of each query, its source and its shape."""
    return MapOutput(x * p[:, None].cos() + shape[:, None, None], (x * p[:, None]).sum(-1))


@pytest.mark.parametrize("queries", [1, 3, 10, 1000])
@pytest.mark.parametrize("sources", [1, 2, 1000])
def test_chunks_change_nothing(queries, sources):
    p, x, shape = torch.rand(5, 3), torch.rand(5, 7, 3), torch.arange(5)
    sizes = []

    def watched(p: Tensor, x: Tensor, shape: Tensor) -> MapOutput:
        sizes.append(x.shape[:2])
        return head(p, x, shape)

    answer, expected = in_chunks(watched, p, x, shape, queries, sources), head(p, x, shape)
    assert torch.equal(answer.vector, expected.vector)
    assert torch.equal(answer.validity, expected.validity)
    assert all(s * k <= queries and s <= sources for s, k in sizes)


@pytest.mark.parametrize("s, k", [(0, 1), (5, 0)])
def test_no_queries_give_empty_answers(s, k):
    out = in_chunks(head, torch.rand(s, 3), torch.rand(s, k, 3), torch.zeros(s).long(), 10, 10)
    assert out.vector.shape == (s, k, 3) and out.validity.shape == (s, k)


def test_value_and_jacobian_are_those_of_autograd():
    turn = torch.randn(3, 3, dtype=torch.float64)

    def f(x: Tensor) -> Tensor:
        return (x @ turn).sin() * x.square().sum(-1, keepdim=True)

    x = torch.randn(4, 5, 3, dtype=torch.float64)
    value, jacobian = value_and_jacobian(f, x)
    expected = autograd_jacobians(lambda _, y: f(y), x.view(-1, 3), x.view(-1, 3))
    torch.testing.assert_close(value, f(x))
    torch.testing.assert_close(jacobian, expected.view(4, 5, 3, 3))


def test_jacobian_is_differentiable_in_the_weights():
    weight = torch.randn(3, dtype=torch.float64, requires_grad=True)

    def diagonal(weight: Tensor) -> Tensor:
        return value_and_jacobian(lambda x: (weight * x).sin(), torch.ones(2, 3).double())[1]

    assert torch.autograd.gradcheck(diagonal, weight)
