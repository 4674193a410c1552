"""Streams, gate and linear layer; what they do to frames is in test_frames.py."""

import pytest
import torch
from nn.geometry import sphere
from torch.autograd import gradcheck

from riemlayer.nn import HarmonicConv, HarmonicGate, HarmonicLinear, magnitudes, to_streams


def test_real_features_are_stream_zero():
    x = torch.randn(5, 3)
    streams = to_streams(x, 3)
    assert streams.shape == (5, 3, 3) and torch.equal(streams[:, 0].real, x)
    assert not bool(streams[:, 1:].any()) and not bool(streams.imag.any())
    torch.testing.assert_close(magnitudes(streams)[:, :3], x.abs())


def test_the_convolution_is_that_of_a_loop():
    g, layer = sphere(9, 4).geometry, HarmonicConv(2, 3, orders=2, rings=1).double()
    x = torch.randn(9, 2, 2, dtype=torch.complex128)
    profile = torch.view_as_complex(layer.profile)[:, :, 0]  # (m, n, C, D)
    weight = torch.view_as_complex(layer.centre.weight)
    expected = torch.einsum("imc,mcd->imd", x, weight)
    expected[:, 0] += torch.view_as_complex(layer.centre.bias)
    for e, (j, i) in enumerate(g.edge_index.T.tolist()):
        depth = g.r[e] / g.radius[i]
        for m in range(2):
            for n in range(2):
                matrix = depth * profile[m, n] + (1 - depth) * (weight[m] if m == n else 0)
                turn = torch.exp(1j * ((n - m) * g.theta[e] + m * g.transport[e]))
                expected[i, n] = expected[i, n] + g.weight[e] * turn * (x[j, m] @ matrix)
    torch.testing.assert_close(layer(x, g), expected)


def test_the_gate_changes_lengths_and_not_directions():
    gate = HarmonicGate(3, orders=2).double()
    x = torch.randn(7, 2, 3, dtype=torch.complex128)
    y = gate(x)
    torch.testing.assert_close(y / y.abs(), x / x.abs())
    torch.testing.assert_close(y.abs(), x.abs() * x.abs().sigmoid())


@pytest.mark.parametrize("layer", [HarmonicGate(3, 2), HarmonicLinear(3, 4, 2)])
def test_gradients_agree_with_differences(layer):
    layer = layer.double()
    x = torch.randn(4, 2, 3, dtype=torch.complex128, requires_grad=True)
    names = dict(layer.named_parameters())

    def f(x, *values):
        y = torch.func.functional_call(layer, dict(zip(names, values, strict=True)), (x,))
        return torch.view_as_real(y)

    assert gradcheck(f, (x, *names.values()))


def test_gradients_are_finite_where_features_are_zero():
    x = torch.zeros(4, 2, 3, dtype=torch.complex64, requires_grad=True)
    magnitudes(HarmonicGate(3, 2)(x)).sum().backward()
    assert x.grad is not None and bool(torch.view_as_real(x.grad).isfinite().all())


def test_what_streams_are_not_is_said():
    with pytest.raises(ValueError, match="orders must be at least 1, got 0"):
        to_streams(torch.zeros(4, 3), 0)
    for layer in (HarmonicGate(3, 2), HarmonicLinear(3, 4, 2)):
        with pytest.raises(ValueError, match=r"x must be complex, got torch\.float32"):
            layer(torch.zeros(4, 2, 3))
        with pytest.raises(ValueError, match="`x` must have shape"):
            layer(to_streams(torch.zeros(4, 3), 3))
