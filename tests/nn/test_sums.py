"""Fused sums against a loop."""

import torch
from torch.autograd import gradcheck

from riemlayer.nn.sums import Sums


def test_sums_are_those_of_a_loop():
    point, row = torch.randint(6, (20,)), torch.randint(5, (20,))
    x = torch.randn(6, 3, dtype=torch.complex128)
    size, angle = torch.rand(2, 20, dtype=torch.float64)
    expected = torch.zeros(5, 3, dtype=torch.complex128)
    for i, j, a, b in zip(point, row, size, angle, strict=True):
        expected[j] += a * torch.exp(1j * b) * x[i]
    sums = Sums.of(point, row, 5)
    torch.testing.assert_close(sums.weighted_complex(x, size, angle), expected)


def test_without_entries_every_row_is_zero():
    none = torch.zeros(0).long()
    y = Sums.of(none, none, 4).weighted(torch.ones(3, 2), torch.zeros(0))
    assert torch.equal(y, torch.zeros(4, 2))


def test_gradients_agree_with_differences():
    point, row = torch.randint(6, (20,)), torch.randint(5, (20,))
    x = torch.randn(6, 3, dtype=torch.float64, requires_grad=True)
    weight = torch.rand(20, dtype=torch.float64, requires_grad=True)
    assert gradcheck(Sums.of(point, row, 5).weighted, (x, weight))
