"""Harmonic layers: complex features in streams that turn with the frames at known rates."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from riemlayer.checks import check_shapes, check_tensor
from riemlayer.nn.arguments import check_sizes, check_streams
from riemlayer.nn.polar import ring_shares
from riemlayer.nn.sums import Sums
from riemlayer.numerics import safe_norm
from riemlayer.ops import LocalGeometry


def to_streams(x: Tensor, orders: int) -> Tensor:
    """Real features (N, C) as stream 0 of complex ones (N, orders, C); the others are 0.

    Tangent vectors make up stream 1: `torch.view_as_complex` of their coordinates (N, C, 2).

    Raises:
        TypeError, ValueError: orders is below 1, or `x` is not real or not (N, C).

    >>> to_streams(torch.ones(2, 3), orders=2)[0]
    tensor([[1.+0.j, 1.+0.j, 1.+0.j],
            [0.+0.j, 0.+0.j, 0.+0.j]])
    """
    check_sizes(orders=orders)
    check_tensor("x", x)
    check_shapes(x=(x, "N C"))
    rest = x.new_zeros(len(x), orders - 1, x.shape[1])
    x = torch.cat((x[:, None], rest), 1)
    return torch.complex(x, torch.zeros_like(x))


def magnitudes(x: Tensor) -> Tensor:
    """|x| of streams (N, orders, C) as real features (N, orders * C), independent of the frames.

    The gradient is finite at 0.
    """
    return safe_norm(torch.view_as_real(x)).flatten(1)


class HarmonicConv(nn.Module):
    """Harmonic surface convolution (Wiersma et al. 2020).

        y_i^n = b^n + W^n x_i^n
                + sum_m sum_j w_ij R^{mn}(r_ij / R_i) e^{i (n - m) theta_ij} e^{i m t_ij} x_j^m

    over the orders m, n = 0 ... orders - 1, with theta_ij the direction of Log_i(j), t_ij the angle
    of transport from j to i and w of Eq. (9). R^{mn} is complex, so the phase offset of Wiersma et
    al. is its argument, and may depend on the radius; it is given on `rings` circles and linear
    between them. At r = 0 it is W^n for m = n, and 0 for m != n. b^n is 0 but for n = 0. A receiver
    without valid edges gets b^n + W^n x_i^n.

    **Frames**: turning every frame by an angle alpha_i of its own turns stream m of the outputs
    by e^{-i m alpha_i} where the inputs turn so; stream 0 and the gradients of the weights stay
    the same, to rounding. Turning a normal over is another matter: it mirrors the frame.

    Args:
        inputs, outputs: channels of each stream.
        orders: number of streams; Wiersma et al. use 2.
        rings: circles that the radial profiles are given on.

    Shapes: x complex (N, orders, inputs) -> (N, orders, outputs).

    Raises:
        ValueError: a size is below 1, or `x` has another shape or is real.

    >>> from riemlayer import ExpLogField
    >>> from riemlayer.ops import local_geometry
    >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
    >>> geometry = local_geometry(ExpLogField.from_preset("tiny").encode(points), k=8)
    >>> x = HarmonicConv(3, 16, orders=2)(to_streams(points, 2), geometry)
    >>> magnitudes(HarmonicGate(16, 2)(x)).shape
    torch.Size([300, 32])
    """

    def __init__(self, inputs: int, outputs: int, orders: int = 2, rings: int = 2) -> None:
        super().__init__()
        check_sizes(inputs=inputs, outputs=outputs, orders=orders, rings=rings)
        self.centre = HarmonicLinear(inputs, outputs, orders)
        # real and imaginary parts on the last axis: complex parameters ignore `Module.double`
        scale = math.sqrt(rings / (2 * orders * inputs))
        self.profile = nn.Parameter(scale * torch.randn(orders, orders, rings, inputs, outputs, 2))

    def forward(self, x: Tensor, geometry: LocalGeometry) -> Tensor:
        orders, _, rings, inputs, outputs, _ = self.profile.shape
        check_streams(x, orders, inputs)
        check_shapes(x=(x, f"{geometry.points} {orders} {inputs}"))
        sender, receiver = geometry.edge_index
        ring, share = ring_shares(geometry, rings)
        row = receiver[:, None] * (rings + 1) + ring
        sums = Sums.of(sender[:, None].expand_as(row), row, geometry.points * (rings + 1))
        share = geometry.weight[:, None] * share
        profile = torch.view_as_complex(self.profile)
        centre, out = list(x.unbind(1)), list(x.new_zeros(orders, len(x), outputs).unbind())
        for m in range(orders):
            for n in range(orders):
                angle = (n - m) * geometry.theta + m * geometry.transport
                pooled = sums.weighted_complex(x[:, m], share, angle[:, None])
                pooled = pooled.view(len(x), rings + 1, inputs)
                out[n] = out[n] + pooled[:, 1:].flatten(1) @ profile[m, n].flatten(0, 1)
                if m == n:
                    centre[n] = centre[n] + pooled[:, 0]
        return self.centre(torch.stack(centre, 1)) + torch.stack(out, 1)

    def extra_repr(self) -> str:
        orders, _, rings, inputs, outputs, _ = self.profile.shape
        return f"{inputs} -> {outputs}, orders={orders}, rings={rings}"


class HarmonicLinear(nn.Module):
    """Complex linear map of each stream, y^m = W^m x^m, with a bias on stream 0.

    Turns with the frames as its input does, whatever the weights.

    Shapes: x complex (N, orders, inputs) -> (N, orders, outputs).

    Raises:
        ValueError: a size is below 1, or `x` has another shape or is real.

    >>> HarmonicLinear(3, 8, orders=2)(to_streams(torch.ones(5, 3), 2)).shape
    torch.Size([5, 2, 8])
    """

    def __init__(self, inputs: int, outputs: int, orders: int = 2) -> None:
        super().__init__()
        check_sizes(inputs=inputs, outputs=outputs, orders=orders)
        scale = 1 / math.sqrt(2 * inputs)
        self.weight = nn.Parameter(scale * torch.randn(orders, inputs, outputs, 2))
        self.bias = nn.Parameter(torch.zeros(outputs, 2))

    def forward(self, x: Tensor) -> Tensor:
        orders, inputs, outputs, _ = self.weight.shape
        check_streams(x, orders, inputs)
        y = torch.einsum("nmc,mcd->nmd", x, torch.view_as_complex(self.weight))
        bias = torch.view_as_complex(self.bias)
        return y + torch.cat((bias[None], bias.new_zeros(orders - 1, outputs)))

    def extra_repr(self) -> str:
        orders, inputs, outputs, _ = self.weight.shape
        return f"{inputs} -> {outputs}, orders={orders}"


class HarmonicGate(nn.Module):
    """Nonlinearity of the magnitude alone, y = sigmoid(a |x| + b) x (ours).

    Turns with the frames as its input does. Wiersma et al. 2020 have ReLU(|x| + b) x / |x|, which
    for b > 0 jumps at x = 0, where streams of empty neighbourhoods are.

    Shapes: x complex (N, orders, channels) -> the same.

    Raises:
        ValueError: a size is below 1, or `x` has another shape or is real.

    >>> HarmonicGate(3, orders=2)(to_streams(torch.zeros(1, 3), 2))[0, 0]
    tensor([0.+0.j, 0.+0.j, 0.+0.j], grad_fn=<SelectBackward0>)
    """

    def __init__(self, channels: int, orders: int = 2) -> None:
        super().__init__()
        check_sizes(channels=channels, orders=orders)
        self.slope = nn.Parameter(torch.ones(orders, channels))
        self.bias = nn.Parameter(torch.zeros(orders, channels))

    def forward(self, x: Tensor) -> Tensor:
        check_streams(x, *self.slope.shape)
        size = safe_norm(torch.view_as_real(x)).squeeze(-1)
        return x * torch.sigmoid(self.slope * size + self.bias)

    def extra_repr(self) -> str:
        return f"{self.slope.shape[1]}, orders={self.slope.shape[0]}"
