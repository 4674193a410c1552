"""The two branches of Fig. 2: ExpHead and LogHead."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor, nn

from riemlayer.config import HeadConfig
from riemlayer.geometry import LocalPlanes, lay_flat, walk
from riemlayer.heads.siren import SirenDecoder
from riemlayer.heads.triplane import TriplaneDecoder, TriplaneHypernetwork
from riemlayer.numerics import in_columns, outer6, safe_norm
from riemlayer.octree import Level, interpolate, interpolate_or_zero

TRAINED = 1.06
"""Longest vectors of the training data, in radii."""
STEEPNESS = 50.0
"""Fall of the validity's logit a radius beyond that."""


class Embedding(NamedTuple):
    """What the heads read: the embedding field of a packed batch of clouds, and its planes."""

    z: Tensor
    """(n, C) embeddings of the leaves."""
    narrow: Tensor | None
    """(n, narrow) a few channels of them, read at end points."""
    level: Level
    planes: LocalPlanes

    def map(self, change: Callable[[Tensor], Tensor]) -> Embedding:
        """The same with `change` applied to every tensor that depends on the cloud."""
        narrow = None if self.narrow is None else change(self.narrow)
        return Embedding(change(self.z), narrow, self.level.map(change), self.planes.map(change))


class MapOutput(NamedTuple):
    """Answer of a head, in the normalised cube."""

    vector: Tensor
    """(S, K, 3): q - p for Exp, v for Log."""
    validity: Tensor
    """(S, K) logit: the query lies before the cut locus."""


class Prepared(NamedTuple):
    """What a head looked up in the field: all that its decoder needs to answer K queries a source.

    Of an anchored head the first of the 1 + K rows is the source itself, x = 0.
    """

    z: Tensor
    """(S, C) embeddings at the sources."""
    x: Tensor
    """(S, 1 + K, 3): v for Exp, q - p for Log; (S, K, 3) where the head is not anchored."""
    prior: Tensor | None = None
    """(S, 1 + K, 3) what the answer would be without learning; None: not anchored."""
    told: tuple[Tensor, ...] = ()
    """(S, 1 + K, ...) what else the decoder is told."""

    @property
    def first(self) -> int:
        """Row of the first query."""
        return 0 if self.prior is None else 1


class MapHead(nn.Module):
    """What both branches share: modulated decoder, and a validity read from its hidden features.

    `prepare` looks up in the field, octree and planes; `answer` is a function of what it found.
    Validity does not disturb the maps: it sees the hidden features without a gradient.
    """

    def __init__(self, embedding: int, told: int, radius: float, config: HeadConfig) -> None:
        super().__init__()
        self.config, self.radius = config, radius
        if config.decoder == "siren":
            self.planes, self.decoder = nn.Identity(), SirenDecoder(embedding, 3 + told, config)
        else:
            self.planes = TriplaneHypernetwork(embedding, config.resolution, config.channels)
            self.decoder = TriplaneDecoder(3 + told, config)
        self.valid = nn.Linear(config.hidden, 1)

    def forward(self, field: Embedding, p: Tensor, x: Tensor, shape: Tensor) -> MapOutput:
        """Answer to K queries (S, K, 3), v for Exp and q for Log, at each of the sources (S, 3)."""
        prepared = self.prepare(field, p, x, shape)
        vector, validity = self.answer(*prepared)
        return MapOutput(vector[:, prepared.first :], validity[:, prepared.first :])

    def prepare(self, field: Embedding, p: Tensor, x: Tensor, shape: Tensor) -> Prepared:
        """What `answer` takes."""
        raise NotImplementedError

    def answer(
        self, z: Tensor, x: Tensor, prior: Tensor | None = None, told: tuple[Tensor, ...] = ()
    ) -> MapOutput:
        """prior + |x| (f(x) - f(0)), or f(x) where not anchored, and validity, of all rows."""
        vector, logit = self.decode(z, x, *told)
        if prior is not None:
            vector = prior + safe_norm(x) * (vector - vector[:, :1])
        return MapOutput(vector, self.validity(logit, self.tangent(x, vector)))

    def tangent(self, x: Tensor, vector: Tensor) -> Tensor:
        """Which of query and answer is the tangent vector."""
        raise NotImplementedError

    def decode(self, z: Tensor, x: Tensor, *told: Tensor) -> tuple[Tensor, Tensor]:
        """The decoder, modulated by `z` (S, C), at `x` (S, K, 3), with what else it is told.

        Returns its answer (S, K, 3) and the validity's logit (S, K).
        """
        return self.decoder(self.planes(z), x / self.radius, told, self._logit)

    def _logit(self, hidden: Tensor) -> Tensor:
        return self.valid(hidden.detach()).squeeze(-1)

    def validity(self, logit: Tensor, v: Tensor) -> Tensor:
        """The logit (S, K), lowered where the tangent vector `v` (S, K, 3) is too long."""
        length = safe_norm(v.detach()).squeeze(-1) / self.radius
        return logit - STEEPNESS * (length - TRAINED).clamp_min(0)


class ExpHead(MapHead):
    """Exp_p(v) = walk(p, v) + |v| (f(v) - f(0)), with f told where the walk ended (ours).

    The walk over the cloud's planes is the prior; f sees the triplane of z(p) at v, the walked end
    point, direction and normal, the normal at p and the narrow embedding where the walk landed.
    Exp_p(0) = p and d(Exp_p)_0 = I by construction. With `anchored=False` it is the paper's ExpNet:
    q = p + f(v).
    """

    def __init__(self, embedding: int, radius: float, config: HeadConfig) -> None:
        super().__init__(embedding, 18 + config.narrow if config.anchored else 0, radius, config)

    def prepare(self, field: Embedding, p: Tensor, v: Tensor, shape: Tensor) -> Prepared:
        z, _ = interpolate(field.z, field.level, p, shape)  # (S, C)
        if not self.config.anchored:
            return Prepared(z, v)
        v = in_columns(torch.cat((torch.zeros_like(v[:, :1]), v), 1))  # (S, 1 + K, 3)
        moved, turned, normals = self.prior(field, p, v, shape)
        landed = read_narrow(field, p[:, None] + moved, shape)
        told = ((moved - v) / self.radius, turned / self.radius, normals, landed)
        return Prepared(z, v, moved, told)

    def tangent(self, x: Tensor, vector: Tensor) -> Tensor:
        return x

    def prior(
        self, field: Embedding, p: Tensor, v: Tensor, shape: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Where the prior ends (S, K, 3), v carried there, the normals at both ends (S, K, 12)."""
        normal = field.planes.normal(p, shape)
        here = outer6(normal)[:, None].expand(-1, v.shape[1], -1)
        if not self.config.walk_steps:
            return v, v, torch.cat((here, here), -1)
        start, normal = (y[:, None].expand_as(v).reshape(-1, 3) for y in (p, normal))
        index = shape[:, None].expand(v.shape[:2]).flatten()
        end = walk(field.planes, start, v.flatten(0, 1), index, self.config.walk_steps, normal)
        there = outer6(end.normal).unflatten(0, v.shape[:2])
        moved, turned = (end.point - start).view_as(v), end.vector.view_as(v)
        return moved, turned, torch.cat((there, here), -1)


class LogHead(MapHead):
    """Log_p(q) = flat(x) + |x| (h(x) - h(0)) with x = q - p (ours).

    The prior lays the chord flat on the tangent plane of the cloud at p; h sees the triplane of
    z(p) at x, the prior, the normal at p, and the narrow embedding at q and half-way. Log_p(p) = 0
    and d(Log_p)_p = I by construction. With `anchored=False` it is the paper's LogNet: v = h(x).
    """

    def __init__(self, embedding: int, radius: float, config: HeadConfig) -> None:
        told = 9 + 2 * config.narrow if config.anchored else 0
        super().__init__(embedding, told, radius, config)

    def prepare(self, field: Embedding, p: Tensor, q: Tensor, shape: Tensor) -> Prepared:
        z, _ = interpolate(field.z, field.level, p, shape)  # (S, C)
        x = q - p[:, None]
        if not self.config.anchored:
            return Prepared(z, x)
        x = in_columns(torch.cat((torch.zeros_like(x[:, :1]), x), 1))  # (S, 1 + K, 3)
        normal = field.planes.normal(p, shape)
        flat = lay_flat(field.planes, normal, x)
        here = outer6(normal)[:, None].expand(-1, x.shape[1], -1)
        passed = (read_narrow(field, p[:, None] + t * x, shape) for t in (0.5, 1.0))
        return Prepared(z, x, flat, ((flat - x) / self.radius, here, *passed))

    def tangent(self, x: Tensor, vector: Tensor) -> Tensor:
        return vector


def read_narrow(field: Embedding, x: Tensor, shape: Tensor) -> Tensor:
    """Narrow embedding (S, K, narrow) at points (S, K, 3) of the cube; 0 where there is none."""
    if field.narrow is None:
        return x.new_zeros(*x.shape[:2], 0)
    index = shape[:, None].expand(x.shape[:2]).flatten()
    value = interpolate_or_zero(field.narrow, field.level, x.flatten(0, 1), index)
    return value.unflatten(0, x.shape[:2])
