"""A tiny field trained for half a minute on exact planes, spheres and cylinders."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from riemlayer import ExpLogField
from riemlayer.data.closed_form import Cylinder, Plane, Sphere, Surface
from riemlayer.losses import LossWeights, Truth, explog_losses

POINTS, SOURCES, QUERIES = 2500, 12, 32


def tangents(surface: Surface, p: Tensor, k: int, longest: float, generator) -> Tensor:
    """(S, k, 3) tangent vectors at p (S, 3), uniform in length and direction."""
    v = torch.randn(len(p), k, 3, generator=generator, dtype=p.dtype)
    v = surface.project_to_tangent(p[:, None], v)
    length = longest * torch.rand(len(p), k, 1, generator=generator, dtype=p.dtype)
    return length * v / v.norm(dim=-1, keepdim=True)


def evenly(surface: Surface, n: int = POINTS) -> Tensor:
    """(n, 3) evenly spread points: a Fibonacci lattice in parameters that preserve area."""
    i = torch.arange(n, dtype=torch.float64)
    u, angle = 2 * (i + 0.5) / n - 1, 2 * math.pi * (i * (math.sqrt(5) - 1) / 2 % 1)
    if isinstance(surface, Plane):
        return surface.half * torch.stack((u, angle / math.pi - 1, 0 * u), -1)
    if isinstance(surface, Sphere):
        around, up = surface.radius * (1 - u * u).sqrt(), surface.radius * u
    else:
        around, up = surface.radius, surface.half * u
    return torch.stack((around * angle.cos(), around * angle.sin(), up), -1)


SURFACES = (Sphere(0.45), Cylinder(0.35, 0.6), Sphere(0.45), Cylinder(0.35, 0.6), Plane(0.6))
"""In turn; planes, which the prior knows, are there so that they are not forgotten."""


def inside(surface: Surface, q: Tensor) -> Tensor:
    """(...) bool: the point lies on the part of the surface that is sampled."""
    if isinstance(surface, Sphere):
        return torch.ones(q.shape[:-1], dtype=torch.bool)
    extent = q[..., 2:] if isinstance(surface, Cylinder) else q[..., :2]
    return (extent.abs() <= 0.95 * surface.half).all(-1)


def exercise(surface: Surface, generator: torch.Generator, turn: Tensor) -> tuple[Tensor, Truth]:
    """A turned cloud in the cube, and exact answers for random sources; pairs 0.03 apart."""
    cloud, p = evenly(surface), surface.sample(SOURCES, generator)
    v = tangents(surface, p, QUERIES, 0.5, generator)
    step = tangents(surface, p, QUERIES // 2, 0.05, generator)
    v[:, QUERIES // 2 :] = v[:, : QUERIES // 2] + step
    q = surface.exp(p[:, None], v)
    known = inside(surface, q) & inside(surface, p)[:, None] & (v.norm(dim=-1) < 0.52)
    cloud, p, v, q = ((x @ turn.T).float() for x in (cloud, p, v, q))
    shape = torch.zeros(SOURCES, dtype=torch.long)
    return cloud, Truth(p, v, q, torch.ones_like(known), known, shape)


def rotation(generator: torch.Generator) -> Tensor:
    """Random orthogonal matrix."""
    return torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))[0]


def train(steps: int = 300, seed: int = 0, lr: float = 2.5e-3) -> tuple[ExpLogField, list[float]]:
    """The trained field and its losses."""
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    field = ExpLogField.from_preset("tiny").train()
    weights = LossWeights(geo=0, cyc=0, validity=0)
    optimiser = torch.optim.AdamW(field.parameters(), fused=True)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, lr, steps, pct_start=0.1)
    losses = []
    for i in range(steps):
        cloud, truth = exercise(SURFACES[i % len(SURFACES)], generator, rotation(generator))
        surface = field.encode_in_cube(cloud, torch.zeros(len(cloud), dtype=torch.long))
        loss = explog_losses(surface, truth, weights)["total"]
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(field.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        losses.append(float(loss.detach()))
    return field.eval(), losses
