"""From a prepared shape to a training sample: what a scanner, a modeller or a user might hand over."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from riemlayer.losses import Truth

LONGEST = 0.53
"""Longer vectors, in the normalised cube, are not trained on."""


@dataclass(frozen=True)
class Augmentation:
    """How often and how strongly clouds are changed; all lengths in the normalised cube."""

    as_meshed: float = 0.35
    """Probability that the cloud is the mesh's vertices as they are."""
    soup: float = 0.6
    """Probability that samples of the raw surface are used where there are any."""
    uneven: float = 0.25
    """Probability of a density that varies about 10:1."""
    noise: float = 0.35
    """Probability of noise of up to `noise_size`."""
    noise_size: float = 0.02
    cut: float = 0.2
    """Probability of holes, or of an open patch seen from one side."""
    points: tuple[int, int] = (4000, 15000)
    """Range of the number of points that are sampled."""
    smallest: float = 0.6
    """Shapes are scaled by a factor in [smallest, 1]."""
    turn_freely: float = 0.5
    """Probability of a uniform rotation; otherwise axes are permuted, with a small tilt."""

    @classmethod
    def none(cls) -> Augmentation:
        """Vertices as they are, upright: for validation."""
        return cls(as_meshed=1, soup=0, uneven=0, noise=0, cut=0, smallest=1, turn_freely=-1)


@dataclass(frozen=True)
class TrainingSample:
    """A cloud in the cube, and the ground truth that goes with it."""

    points: Tensor
    """(N, 3)"""
    truth: Truth


def training_sample(
    sample: Mapping[str, Tensor], how: Augmentation, generator: torch.Generator,
    sources: int = 13, vectors: int = 768, tau: float = 0.5,
) -> TrainingSample:
    """Draw a cloud and `sources` x `vectors` queries from a prepared shape (Sec. 3.3).

    Args:
        sample: tensors of a sample file.
        how: what may happen to the cloud.
        generator: every draw comes from it.
        sources, vectors: S and K; pairs (i, i + K/2) stay pairs.
        tau: threshold of the filter, Eq. (8).
    """
    points = draw_points(sample, how, generator)
    s = torch.randperm(len(sample["p"]), generator=generator)[:sources]
    half = sample["v"].shape[1] // 2
    k = torch.randperm(half, generator=generator)[: vectors // 2]
    k = torch.cat((k, k + half))
    p, v, q = sample["p"][s], sample["v"][s][:, k], sample["q"][s][:, k]
    valid = sample["divergence"][s][:, k] < tau
    known = sample["complete"][s][:, k].bool()
    if _chance(how.cut, generator):
        points, kept = cut_open(points, torch.cat((p[:, None], q), 1), generator)
        known = known & kept[:, 1:] & kept[:, :1]
    turn = rotation(how.turn_freely, generator) if how.turn_freely >= 0 else torch.eye(3)
    points, p, v, q = (x @ turn.T for x in (points, p, v, q))
    low, high = points.amin(0), points.amax(0)
    centre, scale = (low + high) / 2, _uniform(how.smallest, 1, generator) * 2 / (high - low).max()
    points, p, q, v = ((points - centre) * scale, (p - centre) * scale, (q - centre) * scale, v * scale)
    known = known & (v.norm(dim=-1) <= LONGEST)
    return TrainingSample(points, Truth(p, v, q, valid, known, torch.zeros(len(p)).long()))


def draw_points(
    sample: Mapping[str, Tensor], how: Augmentation, generator: torch.Generator
) -> Tensor:
    """A cloud (N, 3) of the shape: vertices, surface samples or soup, uneven, noisy."""
    if "soup" in sample and _chance(how.soup, generator):
        points = sample["soup"]
    elif _chance(how.as_meshed, generator):
        points = sample["vertices"]
    else:
        n = int(_uniform(*how.points, generator))
        points = sample_surface(sample["vertices"], sample["faces"], 3 * n, generator)
        points = thin_out(points, n)
    if _chance(how.uneven, generator):
        points = points[uneven(points, generator)]
    if _chance(how.noise, generator):
        points = points + noise_like(points, _uniform(0, how.noise_size, generator), generator)
    return points


def sample_surface(
    vertices: Tensor, faces: Tensor, n: int, generator: torch.Generator
) -> Tensor:
    """(n, 3) independent points, uniform by area."""
    corners = vertices[faces.long()]                                               # (m, 3, 3)
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = normal.norm(dim=-1).double().cumsum(0)
    at = torch.searchsorted(area, torch.rand(n, generator=generator).double() * area[-1])
    a, b = torch.rand(2, n, 1, generator=generator)
    a = a.sqrt()
    c = corners[at.clamp_max(len(corners) - 1)]
    return (1 - a) * c[:, 0] + a * (1 - b) * c[:, 1] + a * b * c[:, 2]


def thin_out(points: Tensor, n: int) -> Tensor:
    """About `n` of the points, spread more evenly: at most one in each cell of a grid of that many."""
    low, high = 0.005, 0.2
    for _ in range(8):
        side = math.sqrt(low * high)
        _, cell = torch.unique((points / side).floor().long() @ _CELL, return_inverse=True)
        low, high = (side, high) if int(cell.max()) + 1 > n else (low, side)
    first = torch.full((int(cell.max()) + 1,), len(points)).scatter_reduce(
        0, cell, torch.arange(len(points)), "amin"
    )
    return points[first]


_CELL = torch.tensor([1, 1 << 12, 1 << 24])


def uneven(points: Tensor, generator: torch.Generator) -> Tensor:
    """(M,) indices of a subset whose density varies smoothly by about 10:1."""
    waves = torch.randn(4, 3, generator=generator) * 2
    phase = torch.rand(4, generator=generator) * (2 * math.pi)
    field = torch.sin(points @ waves.T + phase).sum(-1)
    rank = field.argsort().argsort() / len(field)
    keep = torch.rand(len(points), generator=generator) < 10 ** (-rank)
    return keep.nonzero().squeeze(-1)


def noise_like(points: Tensor, size: float, generator: torch.Generator) -> Tensor:
    """Displacements in random directions, of length uniform in [0, size] (Sec. 4.1)."""
    direction = torch.nn.functional.normalize(
        torch.randn(points.shape, generator=generator), dim=-1
    )
    return direction * torch.rand(len(points), 1, generator=generator) * size


def cut_open(
    points: Tensor, queries: Tensor, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Remove holes, or all that lies beyond a plane; also which `queries` (..., 3) remain.

    Geodesics that lead through what was removed are not looked for: only their ends are.
    """
    if _chance(0.5, generator):
        centre = points[torch.randint(len(points), (4,), generator=generator)]
        radius = _uniform(0.05, 0.25, generator)
        keep = torch.cdist(points, centre).amin(-1) > radius
        kept = torch.cdist(queries.flatten(0, -2), centre).amin(-1) > radius
    else:
        normal = torch.nn.functional.normalize(torch.randn(3, generator=generator), dim=0)
        level = torch.quantile(points @ normal, _uniform(0, 0.5, generator))
        keep, kept = points @ normal > level, queries.flatten(0, -2) @ normal > level
    if int(keep.sum()) < 500:
        return points, torch.ones(queries.shape[:-1], dtype=torch.bool)
    return points[keep], kept.view(queries.shape[:-1])


def rotation(freely: float, generator: torch.Generator) -> Tensor:
    """(3, 3) rotation: uniform with that probability, else of the cube's group with a small tilt."""
    if _chance(freely, generator):
        return _orthogonal(torch.randn(3, 3, generator=generator))
    turned = torch.eye(3)[torch.randperm(3, generator=generator)]
    flips = torch.randint(0, 2, (3,), generator=generator) * 2.0 - 1
    tilt = torch.eye(3) + 0.05 * torch.randn(3, 3, generator=generator)
    return _orthogonal(tilt) @ _proper(turned * flips)


def _orthogonal(m: Tensor) -> Tensor:
    q, r = torch.linalg.qr(m)
    return _proper(q * r.diagonal().sign())


def _proper(m: Tensor) -> Tensor:
    return m * torch.tensor([1.0, 1.0, float(torch.linalg.det(m).sign())])


def _chance(probability: float, generator: torch.Generator) -> bool:
    return float(torch.rand((), generator=generator)) < probability


def _uniform(low: float, high: float, generator: torch.Generator) -> float:
    return low + (high - low) * float(torch.rand((), generator=generator))
