"""A small network on an encoded cloud learns, and its gradient reaches the field."""

from dataclasses import replace

import pytest
import torch
from references import fibonacci_sphere
from torch import Tensor, nn

from riemlayer import ExpLogField
from riemlayer.nn import (
    AdaptiveGeodesicConv,
    GeodesicConv,
    GeodesicPool,
    GeodesicUnpool,
    HarmonicConv,
    TangentConv,
    VectorPool,
    magnitudes,
    to_streams,
)
from riemlayer.ops import local_geometry


class Net(nn.Module):
    """Three convolutions, the middle one on a quarter of the points."""

    def __init__(self) -> None:
        super().__init__()
        self.first = TangentConv(3, 8)
        self.pool, self.unpool = GeodesicPool(ratio=0.25, reduce="max"), GeodesicUnpool()
        self.second = GeodesicConv(8, 8, rings=1, angles=4)
        self.third = HarmonicConv(16, 2, orders=2, rings=1)

    def forward(self, x: Tensor, surface) -> Tensor:
        geometry = local_geometry(surface, k=8)
        x = self.first(x, geometry).relu()
        y, cells = self.pool(x, geometry)
        coarse = replace(surface, points=surface.points[cells.index], batch=cells.batch)
        y = self.second(y, local_geometry(coarse, k=8)).relu()
        x = torch.cat((x, self.unpool(y, cells)), 1)
        return magnitudes(self.third(to_streams(x, 2), geometry))


def test_a_network_of_three_layers_learns_and_the_field_with_it():
    points = fibonacci_sphere(150).float()
    target = (points[:, 2] > 0).float() + points[:, 0].square()
    field, net = ExpLogField.from_preset("tiny"), Net()
    optimiser = torch.optim.Adam([*field.parameters(), *net.parameters()], lr=1e-2)
    losses = []
    for _ in range(16):
        out = net(points, field.encode(points))
        loss = (out[:, 0] - target).square().mean()
        optimiser.zero_grad()
        loss.backward()
        losses.append(float(loss.detach()))
        optimiser.step()
    assert losses[-1] < 0.6 * losses[0]
    gradients = [p.grad for p in field.backbone.parameters()]
    assert all(g is not None and bool(g.isfinite().all()) for g in gradients)
    assert sum(float(g.abs().sum()) for g in gradients if g is not None) > 0


@pytest.mark.parametrize("name", ["tangent", "geodesic", "harmonic", "adaptive", "pool"])
def test_coincident_points_give_finite_gradients_to_the_points_and_the_field(name):
    """Every point is there twice, so that a neighbour of each lies at distance 0."""
    field = ExpLogField.from_preset("tiny")
    points = fibonacci_sphere(60).float().repeat(2, 1).requires_grad_()
    surface = field.encode(points)
    geometry = local_geometry(surface, k=8)
    assert bool((geometry.r < 1e-6).any())
    layers = {
        "tangent": lambda: TangentConv(3, 2)(points, geometry),
        "geodesic": lambda: GeodesicConv(3, 2)(points, geometry),
        "harmonic": lambda: magnitudes(HarmonicConv(3, 2)(to_streams(points, 2), geometry)),
        "adaptive": lambda: AdaptiveGeodesicConv(3, 2)(points, geometry, surface),
        "pool": lambda: VectorPool()(geometry.log.view(120, -1, 2), geometry),
    }
    layers[name]().square().sum().backward()
    gradients = [points.grad, *(p.grad for p in field.backbone.parameters())]
    assert all(g is not None and bool(g.isfinite().all()) for g in gradients)
    assert all(float(g.abs().max()) > 0 for g in gradients[:2] if g is not None)


def test_a_frozen_field_gets_no_gradient():
    points = fibonacci_sphere(150).float()
    field, net = ExpLogField.from_preset("tiny").requires_grad_(False), Net()
    net(points, field.encode(points)).sum().backward()
    assert all(p.grad is None for p in field.parameters())
    assert all(p.grad is not None for p in net.first.parameters())
