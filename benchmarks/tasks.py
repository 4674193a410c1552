"""What the speed benchmarks run: each function sets a task up and returns a call that does it once.

    python -m benchmarks.tasks edges --weights base --points 15000

runs one task once in this process and prints its peak memory in megabytes above the interpreter
with torch and riemlayer imported: weights, cloud and everything the task makes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from benchmarks.measure import memory
from riemlayer import ExpLogField
from riemlayer.config import FieldConfig
from riemlayer.field import bounding_cubes
from riemlayer.losses import LossWeights, Truth, explog_losses
from riemlayer.octree import build_octree, knn
from riemlayer.ops import local_geometry

Run = Callable[[], Any]
NEIGHBOURS = 16
SOURCES = 13
"""Of a training step: 13 sources with 768 queries each are the paper's 10,000."""
TRAINED_WITH = LossWeights(geo=0, cyc=0, pairs=0.05, relative=True)
"""What the packaged weights are trained with; the defaults are all terms of Eq. (1)."""


def torus(count: int, seed: int = 0) -> Tensor:
    """Raw cloud (count, 3) of a torus: twice the occupied leaves of most real shapes."""
    generator = torch.Generator().manual_seed(seed)
    a, b = 2 * torch.pi * torch.rand(2, count, generator=generator)
    return torch.stack(((2 + b.cos()) * a.cos(), (2 + b.cos()) * a.sin(), b.sin()), -1) / 3


def load_field(weights: str) -> ExpLogField:
    """Field of a packaged name, a directory, a hub id, or untrained of `preset:NAME`."""
    kind, _, name = weights.partition(":")
    if kind == "preset":
        return ExpLogField.from_preset(name).eval()
    return ExpLogField.from_pretrained(weights).eval()


def without_walk(field: ExpLogField) -> ExpLogField:
    """A field of the same size whose Exp starts from p + v; untrained."""
    config = field.config
    return ExpLogField(replace(config, head=replace(config.head, walks=0))).eval()


def encode(field: ExpLogField, clouds: int, points: int) -> Run:
    """Octree, local planes and backbone of `clouds` tori of `points` points in one packed batch."""
    x = torch.cat([torus(points, seed) for seed in range(clouds)])
    batch = torch.arange(clouds).repeat_interleave(points)
    return lambda: field.encode(x, batch)


def log(field: ExpLogField, points: Tensor, count: int = 10_000) -> Run:
    """Log from one source to `count` points."""
    surface = field.encode(points)
    p, q = points[:1], points[:count]
    return lambda: surface.log(p, q)


def exp(field: ExpLogField, points: Tensor, count: int = 1_000) -> Run:
    """Exp of `count` vectors of up to the trained radius from one source."""
    surface = field.encode(points)
    p = points[:1]
    v = tangent_vectors(p, count, float(surface.radius)).squeeze(0)
    return lambda: surface.exp(p, v)


def edges(field: ExpLogField, points: Tensor) -> Run:
    """Log vectors of each point to its nearest neighbours, the search for them included."""
    surface = field.encode(points)

    def run() -> Tensor:
        return surface.log(points[:, None], points[neighbours(points)])

    return run


def record(field: ExpLogField, points: Tensor) -> Run:
    """`local_geometry` of a cloud that is encoded: what feeds the layers of `riemlayer.nn`."""
    surface = field.encode(points)
    return lambda: local_geometry(surface, min(NEIGHBOURS, len(points) - 1))


def neighbours(points: Tensor) -> Tensor:
    """Indices (N, 16) of the nearest points of each point of a cloud, its own first."""
    batch = torch.zeros(len(points), dtype=torch.long)
    centre, scale = bounding_cubes(points, batch)
    x = (points - centre) / scale
    depth = FieldConfig.base().backbone.depth + 1
    octree = build_octree(x, batch, depth, coarsest=depth - 4)
    return knn(octree, x, x, min(NEIGHBOURS, len(points)))[0]


def training_step(
    field: ExpLogField, points: Tensor, queries: int = 768, losses: LossWeights = TRAINED_WITH
) -> Run:
    """Encode, losses of `SOURCES` sources with `queries` vectors, backward, AdamW."""
    field = ExpLogField(field.config).train()
    optimizer = torch.optim.AdamW(field.parameters(), 1e-4, fused=True)
    batch = torch.zeros(len(points), dtype=torch.long)
    truth = truth_like(points, queries, field.config.radius)

    def run() -> None:
        surface = field.encode_in_cube(points, batch)
        optimizer.zero_grad(set_to_none=True)
        explog_losses(surface, truth, losses)["total"].backward()
        optimizer.step()

    return run


def truth_like(points: Tensor, queries: int, radius: float) -> Truth:
    """Something of the form of ground truth: speed does not depend on what is true."""
    p = points[:SOURCES]
    v = tangent_vectors(p, queries, radius)
    known = torch.ones(SOURCES, queries, dtype=torch.bool)
    return Truth(p, v, p[:, None] + v, known, known, torch.zeros(SOURCES, dtype=torch.long))


def tangent_vectors(p: Tensor, count: int, radius: float) -> Tensor:
    """Vectors (S, count, 3), up to `radius` long, tangent to the torus at `p` (S, 3)."""
    ring = 2 / 3 * torch.nn.functional.normalize(p * p.new_tensor([1, 1, 0]), dim=-1)
    normal = torch.nn.functional.normalize(p - ring, dim=-1)[:, None]
    generator = torch.Generator().manual_seed(1)
    v = torch.randn(len(p), count, 3, generator=generator)
    v = torch.nn.functional.normalize(v - (v * normal).sum(-1, keepdim=True) * normal, dim=-1)
    return radius * v * torch.rand(len(p), count, 1, generator=generator)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description="Peak memory of one task.")
    parser.add_argument("task", choices=("encode", "edges", "record"))
    parser.add_argument("--weights", default="base")
    parser.add_argument("--points", type=int, default=15_000, help="of each cloud")
    parser.add_argument("--clouds", type=int, default=1, help="to encode in one packed batch")
    options = parser.parse_args()
    before = memory("VmRSS")
    field = load_field(options.weights)
    with torch.inference_mode():
        if options.task == "encode":
            encode(field, options.clouds, options.points)()
        else:
            task = edges if options.task == "edges" else record
            task(field, torus(options.points))()
    print(json.dumps({"megabytes": memory("VmHWM") - before}))


if __name__ == "__main__":
    main()
