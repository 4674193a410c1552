"""What turning the frames does to each layer: nothing, a known turn, or something else."""

import math

import pytest
import torch
from nn.geometry import Case, angles, plane, rotated, sphere, steps
from torch import Tensor, nn

from riemlayer.nn import (
    AdaptiveGeodesicConv,
    GeodesicConv,
    HarmonicConv,
    HarmonicGate,
    HarmonicLinear,
    ParallelTransport,
    TangentConv,
    VectorPool,
    magnitudes,
    to_streams,
)


def turned(case: Case, angle: Tensor) -> Case:
    return Case(case.cloud, case.geometry.turned(angle))


def gradients(layer: nn.Module, y: Tensor) -> list[Tensor]:
    """Of a loss that treats all outputs differently."""
    generator = torch.Generator().manual_seed(5)
    target = torch.randn(y.shape, generator=generator, dtype=torch.float64)
    loss = (y - target).square().sum()
    return list(torch.autograd.grad(loss, list(layer.parameters())))


def change(y: Tensor, z: Tensor) -> float:
    """Mean |y - z| over mean |y|."""
    return float(((y - z).abs().mean() / y.abs().mean()).detach())


# ------------------------------------------------------------------------------ TangentConv


def test_tangent_convolution_depends_on_the_frames():
    case, layer = sphere(), TangentConv(3, 4).double()
    x = torch.randn(40, 3, dtype=torch.float64)
    y, z = (layer(x, c.geometry) for c in (case, turned(case, angles(40))))
    assert change(y, z) > 0.1


def test_turning_all_frames_turns_the_tangent_kernel():
    """Frames turned by s steps see the world turned by -s: the kernel has to go with them."""
    case, layer = sphere(), TangentConv(3, 4, angles=6).double()
    x = torch.randn(40, 3, dtype=torch.float64)
    y = layer(x, case.geometry)
    with torch.no_grad():
        layer.kernel.copy_(layer.kernel.roll(-2, 1))
    angle = torch.full((40,), 2 * 2 * math.pi / 6, dtype=torch.float64)
    torch.testing.assert_close(layer(x, case.geometry.turned(angle)), y)


# ----------------------------------------------------------------------------- GeodesicConv


@pytest.mark.parametrize("count", [1, 5, 8])
def test_geodesic_convolution_ignores_turns_by_its_own_steps(count):
    case, layer = sphere(), GeodesicConv(3, 4, angles=count).double()
    x = torch.randn(40, 3, dtype=torch.float64)
    y, z = (layer(x, c.geometry) for c in (case, turned(case, steps(40, count))))
    torch.testing.assert_close(y, z)
    for a, b in zip(gradients(layer, y), gradients(layer, z), strict=True):
        torch.testing.assert_close(a, b)


def departure(count: int) -> float:
    """Mean change under random turns of a convolution with a smooth kernel, sampled at `count`."""
    generator = torch.Generator().manual_seed(3)
    layer = GeodesicConv(3, 4, rings=2, angles=count).double()
    waves = torch.randn(3, 2, 2, 3, 4, generator=generator, dtype=torch.float64)
    phi = torch.arange(count, dtype=torch.float64) * (2 * math.pi / count)
    kernel = torch.zeros(2, count, 3, 4, dtype=torch.float64)
    for m in range(3):
        for wave, part in zip(waves[m], ((m * phi).cos(), (m * phi).sin()), strict=True):
            kernel += part[:, None, None] * wave[:, None]
    with torch.no_grad():
        layer.kernel.copy_(kernel)
    torch.manual_seed(0)
    case, x = sphere(200), torch.randn(200, 3, dtype=torch.float64)
    y, z = (layer(x, c.geometry) for c in (case, turned(case, angles(200))))
    return change(y, z)


def test_any_other_turn_matters_the_less_the_more_angles():
    coarse, fine = departure(8), departure(32)
    assert 0 < fine < coarse / 10  # 16 for order 2


# ----------------------------------------------------------------------------- HarmonicConv


class Harmonic(nn.Module):
    """Two convolutions, a gate and a linear layer."""

    def __init__(self, orders: int) -> None:
        super().__init__()
        self.first = HarmonicConv(3, 5, orders)
        self.gate = HarmonicGate(5, orders)
        self.linear = HarmonicLinear(5, 4, orders)
        self.last = HarmonicConv(4, 2, orders)
        for parameter in self.parameters():
            nn.init.normal_(parameter)

    def forward(self, x: Tensor, geometry) -> Tensor:
        x = self.linear(self.gate(self.first(x, geometry)))
        return self.last(x, geometry)


@pytest.mark.parametrize("orders", [1, 2, 3])
def test_harmonic_streams_turn_at_their_own_rates(orders):
    case, net, angle = sphere(), Harmonic(orders).double(), angles(40)
    x = to_streams(torch.randn(40, 3, dtype=torch.float64), orders)
    y, z = net(x, case.geometry), net(x, case.geometry.turned(angle))
    m = torch.arange(orders)
    factor = torch.exp(-1j * m * angle[:, None])[..., None]
    torch.testing.assert_close(z, factor * y)
    assert float(y.detach().abs().mean()) > 0.1


def test_harmonic_outputs_and_gradients_ignore_the_frames():
    case, net, angle = sphere(), Harmonic(2).double(), angles(40)
    x = torch.randn(40, 3, dtype=torch.float64)

    def invariants(geometry):
        y = net(to_streams(x, 2), geometry)
        return torch.cat((torch.view_as_real(y[:, 0]).flatten(1), magnitudes(y)), 1)

    y, z = invariants(case.geometry), invariants(case.geometry.turned(angle))
    torch.testing.assert_close(y, z)
    for a, b in zip(gradients(net, y), gradients(net, z), strict=True):
        torch.testing.assert_close(a, b)


def test_a_harmonic_net_without_transport_would_depend_on_the_frames():
    """The test above can fail: with the wrong transport the second layer mixes frames."""
    case, net, angle = sphere(), Harmonic(2).double(), angles(40)
    x = to_streams(torch.randn(40, 3, dtype=torch.float64), 2)

    def forgetful(geometry):
        return net(x, geometry._replace(transport=torch.zeros_like(geometry.transport)))

    y, z = forgetful(case.geometry), forgetful(case.geometry.turned(angle))
    assert change(y[:, 0], z[:, 0]) > 0.1


def test_tangent_vectors_are_stream_one():
    case, net, angle = sphere(), Harmonic(2).double(), angles(40)
    v = torch.randn(40, 3, 2, dtype=torch.float64)

    def streams(v):
        x = to_streams(torch.zeros(40, 3, dtype=torch.float64), 2)
        x[:, 1] = torch.view_as_complex(v)
        return x

    y = net(streams(v), case.geometry)
    z = net(streams(rotated(v, -angle).contiguous()), case.geometry.turned(angle))
    torch.testing.assert_close(z[:, 0], y[:, 0])
    vectors = torch.view_as_real(y[:, 1])
    torch.testing.assert_close(torch.view_as_real(z[:, 1]), rotated(vectors, -angle))


def test_on_constant_streams_of_order_zero_only_the_gradient_of_position_is_seen():
    """Neighbours evenly around a receiver: order 1 of a constant vanishes, order 0 does not."""
    case, layer = plane(), HarmonicConv(1, 1, orders=2).double()
    g = case.geometry
    even = torch.arange(7, dtype=torch.float64) * (2 * math.pi / 7)
    even = (even.repeat(40) + angles(40).repeat_interleave(7) + math.pi) % (2 * math.pi) - math.pi
    g = g._replace(
        r=torch.ones_like(g.r),
        radius=torch.full_like(g.radius, 1.5),
        theta=even,
        weight=torch.full_like(g.weight, 1 / 7),
    )
    y = layer(to_streams(torch.ones(40, 1, dtype=torch.float64), 2), g)
    torch.testing.assert_close(y[:, 1], torch.zeros_like(y[:, 1]))
    assert float(y[:, 0].detach().abs().min()) > 1e-3
    torch.testing.assert_close(y[:, 0], y[:1, 0].expand(40, 1))


# --------------------------------------------------------------------- AdaptiveGeodesicConv


def test_adaptive_convolution_ignores_turns_by_its_own_steps():
    case, layer = sphere(), AdaptiveGeodesicConv(3, 4, rings=2, angles=6).double()
    x = torch.randn(40, 3, dtype=torch.float64)
    y, z = (layer(x, c.geometry, c.cloud) for c in (case, turned(case, steps(40, 6))))
    torch.testing.assert_close(y, z)
    for a, b in zip(gradients(layer, y), gradients(layer, z), strict=True):
        torch.testing.assert_close(a, b)


def test_adaptive_convolution_notices_other_turns():
    case, layer = sphere(), AdaptiveGeodesicConv(3, 4, angles=4).double()
    x = torch.randn(40, 3, dtype=torch.float64)
    y, z = (layer(x, c.geometry, c.cloud) for c in (case, turned(case, angles(40))))
    assert change(y, z) > 1e-3


# ---------------------------------------------------------------------------------- vectors


def test_carried_and_averaged_vectors_turn_with_the_frames():
    case, angle = sphere(), angles(40)
    x = torch.randn(40, 3, 2, dtype=torch.float64)
    g, h = case.geometry, case.geometry.turned(angle)
    y, z = (VectorPool()(x, g), VectorPool()(rotated(x, -angle), h))
    torch.testing.assert_close(z, rotated(y, -angle))
    y, z = (ParallelTransport()(x, g), ParallelTransport()(rotated(x, -angle), h))
    torch.testing.assert_close(z, rotated(y, -angle[g.edge_index[1]]))
