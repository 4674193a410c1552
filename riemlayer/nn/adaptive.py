"""Geodesic convolution at points that Exp reaches, at radii that are learned."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from riemlayer.nn.arguments import check_features
from riemlayer.nn.polar import PolarConv, angular_max
from riemlayer.nn.sums import Sums
from riemlayer.numerics import falloff, product, safe_norm, segment_sum
from riemlayer.ops import LocalGeometry
from riemlayer.surface import EncodedSurface

LEAST = 1e-6
"""Share of the receiver in every reading, so that none is empty where Exp is poor."""


class AdaptiveGeodesicConv(PolarConv):
    """Geodesic convolution with learned radii (ours, after Verninas et al. 2026).

        q_ika = Exp_i(rho_k R_i (cos phi_a, sin phi_a)),    phi_a = 2 pi a / angles
        y_i = b + W x_i + max_s sum_{k, a} K[k, a - s] x(q_ika)

    x(q) is read between i and its valid neighbours with the weights of Eq. (9) of the distance to
    q over R_i, divided by their sum: constant features are read as they are. The radii rho_k in
    (0, 1), one a ring, are parameters; a gradient reaches them, and the field, through Exp. From
    Verninas et al. is the idea, a differentiable Exp inside a convolution; the rest is ours.

    **Frames**: as `GeodesicConv`, exactly invariant to turns by multiples of 2 pi / angles. A
    receiver without valid neighbours reads itself everywhere.

    Args:
        inputs, outputs: channels.
        rings, angles: points of the fan.

    Shapes: x (N, inputs) -> (N, outputs).

    Raises:
        TypeError, ValueError: a size is below 1, `x` has another shape or is not real, or
            `surface` is not that of `geometry`.

    >>> from riemlayer import ExpLogField
    >>> from riemlayer.ops import local_geometry
    >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
    >>> surface = ExpLogField.from_preset("tiny").encode(points)
    >>> conv = AdaptiveGeodesicConv(3, 16)
    >>> conv(points, local_geometry(surface, k=8), surface).shape
    torch.Size([300, 16])
    """

    def __init__(self, inputs: int, outputs: int, rings: int = 1, angles: int = 8) -> None:
        super().__init__(inputs, outputs, rings, angles)
        with torch.no_grad():  # here a node sees a whole reading, not a part of the neighbourhood
            self.kernel.div_(rings * angles)
        even = torch.arange(1, rings + 1) / (rings + 1)
        self.logit = nn.Parameter(torch.logit(even))

    @property
    def radii(self) -> Tensor:
        """(rings,) rho, in distances of the farthest neighbour."""
        return self.logit.sigmoid()

    def forward(self, x: Tensor, geometry: LocalGeometry, surface: EncodedSurface) -> Tensor:
        check_features(x, geometry, self.centre.in_features)
        points, shape = surface.points, surface.batch
        if len(points) != geometry.points:
            raise ValueError(
                f"surface must be the one that the geometry of {geometry.points} points was made "
                f"of, got one of {len(points)} points"
            )
        v = self.fan(geometry)  # (N, F, 3)
        q = surface.decode_exp(points[:, None], v, shape[:, None])[0]
        patch = read(x, q, points, geometry).flatten(1)
        return self.centre(x) + angular_max(patch, self.kernel)

    def fan(self, geometry: LocalGeometry) -> Tensor:
        """Tangent vectors (N, rings * angles, 3) to the places that are read."""
        angles = self.kernel.shape[1]
        phi = torch.arange(angles, device=self.logit.device, dtype=self.logit.dtype)
        phi = phi * (2 * math.pi / angles)
        fan = self.radii[:, None, None] * torch.stack((phi.cos(), phi.sin()), -1)
        return geometry.radius[:, None, None] * product(
            fan.flatten(0, 1), geometry.frame[..., :2].mT
        )


def read(x: Tensor, q: Tensor, points: Tensor, geometry: LocalGeometry) -> Tensor:
    """Features at places near each point, between it and its valid neighbours (Eq. (9)).

    Args:
        x: (N, C) features.
        q: (N, F, 3) places.
        points: (N, 3).
        geometry: of the points.

    Shapes: -> (N, F, C).
    """
    here = torch.arange(len(points), device=points.device)
    kept = geometry.valid
    sender, receiver = (torch.cat((y[kept], here)) for y in geometry.edge_index)
    chord = safe_norm(q[receiver] - points[sender][:, None]).squeeze(-1)  # (E + N, F)
    window = geometry.radius[receiver].clamp_min(1e-12)[:, None]
    weight = falloff(chord / window)
    weight = weight + LEAST * (sender == receiver)[:, None]
    weight = weight / segment_sum(weight, receiver, len(points))[receiver]
    fans = q.shape[1]
    row = receiver[:, None] * fans + torch.arange(fans, device=q.device)
    sums = Sums.of(sender[:, None].expand_as(row), row, len(points) * fans)
    return sums.weighted(x, weight).view(*q.shape[:2], -1)
