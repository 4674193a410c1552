"""Closed-form surfaces as `Calculus`: maps without error, to test what follows from them."""

import math

import torch
from torch import Tensor

from riemlayer.calculus import Calculus
from riemlayer.data.closed_form import Sphere


class Exact(Calculus):
    """A closed-form surface; what is beyond half a turn of the sphere is not valid."""

    def __init__(self, surface=None) -> None:
        self.surface = surface or Sphere()

    def decode_exp(self, p, v, shape=None) -> tuple[Tensor, Tensor]:
        return self.surface.exp(p, v), math.pi - v.norm(dim=-1)

    def decode_log(self, p, q, shape=None) -> tuple[Tensor, Tensor]:
        v = self.surface.log(p, q)
        return v, math.pi - 0.1 - v.norm(dim=-1)

    def normal(self, p, *, shape=None) -> Tensor:
        return self.surface.normal(p)

    def snap(self, p, *, shape=None) -> Tensor:
        return torch.nn.functional.normalize(p, dim=-1) if isinstance(self.surface, Sphere) else p

    def radius_at(self, p, shape=None) -> Tensor:
        return torch.full_like(p[..., 0], 0.5)


def sphere_points(*size: int) -> Tensor:
    """Random points of the unit sphere, float64."""
    return torch.nn.functional.normalize(torch.randn(*size, 3, dtype=torch.float64), dim=-1)


def tangents(surface: Exact, p: Tensor, length: float = 1.0) -> Tensor:
    """A random tangent vector of that length at each point."""
    v = surface.project(p, torch.randn_like(p))
    return length * v / v.norm(dim=-1, keepdim=True)


def unit(*x: float) -> Tensor:
    """A direction, float64."""
    return torch.nn.functional.normalize(torch.tensor(x, dtype=torch.float64), dim=-1)
