"""The two branches of Fig. 2: ExpHead and LogHead."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor, nn

from riemlayer.config import HeadConfig
from riemlayer.geometry import LocalPlanes, fan_of, lay_flat, log_on_fan, walk
from riemlayer.heads.siren import SirenDecoder
from riemlayer.heads.triplane import TriplaneDecoder, TriplaneHypernetwork, linear_with_site
from riemlayer.numerics import in_columns, outer6, safe_norm
from riemlayer.octree import Level, interpolate, interpolate_or_zero

TRAINED = 1.06
"""Longest vectors of the training data, in radii."""
STEEPNESS = 50.0
"""Fall of the validity's logit a radius beyond that."""


NEAR, MIDDLE = 0.2, 0.4
"""Chords, in radii, up to which fans have no share in Log, and from which they have a full one."""
FAN = 13
"""Channels that Log's decoder is told of a fan: 3 + 1 + 6 + 3."""


class Embedding(NamedTuple):
    """What the heads read: the embedding field of a packed batch of clouds, and its planes."""

    z: Tensor
    """(n, C) embeddings of the leaves."""
    narrow: Tensor | None
    """(n, narrow) a few channels of them, read at end points."""
    level: Level
    planes: LocalPlanes
    finer: tuple[LocalPlanes, ...] = ()
    """Planes of half the size, a quarter, and so on, for further walks."""

    def map(self, change: Callable[[Tensor], Tensor]) -> Embedding:
        """The same with `change` applied to every tensor that depends on the cloud."""
        narrow = None if self.narrow is None else change(self.narrow)
        planes, *finer = (x.map(change) for x in (self.planes, *self.finer))
        return Embedding(change(self.z), narrow, self.level.map(change), planes, tuple(finer))


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
    """(S, 1 + K, 3) what the answer would be without the decoder; None: not anchored."""
    told: tuple[Tensor, ...] = ()
    """(S, 1 + K, ...) what else the decoder is told."""
    site: Tensor | None = None
    """(S, ...) what it is told of the sources."""

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
        self,
        z: Tensor,
        x: Tensor,
        prior: Tensor | None = None,
        told: tuple[Tensor, ...] = (),
        site: Tensor | None = None,
    ) -> MapOutput:
        """prior + |x| (f(x) - f(0)), or f(x) where not anchored, and validity, of all rows."""
        vector, logit = self.decode(z, x, told, z[:, :0] if site is None else site)
        if prior is not None:
            vector = prior + safe_norm(x) * (vector - vector[:, :1])
        return MapOutput(vector, self.validity(logit, self.tangent(x, vector)))

    def tangent(self, x: Tensor, vector: Tensor) -> Tensor:
        """Which of query and answer is the tangent vector."""
        raise NotImplementedError

    def decode(
        self, z: Tensor, x: Tensor, told: tuple[Tensor, ...], site: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The decoder, modulated by `z` (S, C), at `x` (S, K, 3), with what else it is told.

        Returns its answer (S, K, 3) and the validity's logit (S, K).
        """
        return self.decoder(self.planes(z), x / self.radius, told, site, self._logit)

    def _logit(self, hidden: Tensor) -> Tensor:
        return self.valid(hidden.detach()).squeeze(-1)

    def validity(self, logit: Tensor, v: Tensor) -> Tensor:
        """The logit (S, K), lowered where the tangent vector `v` (S, K, 3) is too long."""
        length = safe_norm(v.detach()).squeeze(-1) / self.radius
        return logit - STEEPNESS * (length - TRAINED).clamp_min(0)


class Gate(nn.Module):
    """Moves the first prior towards each of the others, by a share read from what is told (ours).

    All priors agree with the map to first order at the source, so whatever it says is anchored.

    Shapes: priors (S, K, 3) each, told (S, K, ...), site (S, ...) -> (S, K, 3).
    """

    def __init__(self, told: int, others: int, hidden: int = 64) -> None:
        super().__init__()
        self.first = nn.Linear(told, hidden)
        self.body = nn.Sequential(
            nn.GELU(), nn.Linear(hidden, hidden), nn.GELU(), nn.Linear(hidden, others)
        )

    def forward(self, priors: list[Tensor], told: list[Tensor], site: Tensor) -> Tensor:
        prior, *others = priors
        rows = torch.cat(told, -1).flatten(0, 1)
        source = torch.arange(len(site), device=site.device)[:, None].expand(prior.shape[:2])
        hidden = linear_with_site(self.first, site, rows, source.flatten())
        shares = self.body(hidden).sigmoid().to(prior.dtype).unflatten(0, prior.shape[:2])
        for other, share in zip(others, shares.split(1, -1), strict=True):
            prior = prior + share * (other - prior)
        return prior


class ExpHead(MapHead):
    """Exp_p(v) = walk(p, v) + |v| (f(v) - f(0)), with f told where the walk ended (ours).

    Walks over the cloud's planes are the priors: one over wide planes, which noise does not
    disturb, one over planes of half the size, which see detail. A gate decides between their ends
    by what the planes are like. f sees the triplane of z(p) at v, the ends, directions and normals
    of the walks, the planes at p and the narrow embedding where the first walk landed. Exp_p(0) = p
    and d(Exp_p)_0 = I by construction. With `anchored=False` it is the paper's ExpNet, p + f(v).
    """

    def __init__(self, embedding: int, radius: float, config: HeadConfig) -> None:
        priors = max(1, len(config.walk_steps))
        told = 1 + 25 * priors + config.narrow if config.anchored else 0
        super().__init__(embedding, told, radius, config)
        self.gate = Gate(told, priors - 1) if priors > 1 else None

    def prepare(self, field: Embedding, p: Tensor, v: Tensor, shape: Tensor) -> Prepared:
        z, _ = interpolate(field.z, field.level, p, shape)  # (S, C)
        if not self.config.anchored:
            return Prepared(z, v)
        v = in_columns(torch.cat((torch.zeros_like(v[:, :1]), v), 1))  # (S, 1 + K, 3)
        normal = field.planes.normal(p, shape)
        site, length = sites(field, p, normal, shape), safe_norm(v)
        told, ends = [length / self.radius], []
        for moved, turned, there in self.walks(field, p, v, shape, normal):
            away = moved - (ends[0] if ends else v)
            bend = safe_norm(away) / (length + 0.01 * self.radius)
            told += [away / self.radius, bend, turned / self.radius, there]
            ends.append(moved)
        told.append(read_narrow(field, p[:, None] + ends[0], shape))
        prior = ends[0] if self.gate is None else self.gate(ends, told, site)
        return Prepared(z, v, prior, tuple(told), site)

    def tangent(self, x: Tensor, vector: Tensor) -> Tensor:
        return x

    def walks(
        self, field: Embedding, p: Tensor, v: Tensor, shape: Tensor, normal: Tensor
    ) -> list[tuple[Tensor, Tensor, Tensor]]:
        """Of each prior: where it ends (S, K, 3), v carried there, and the normal (S, K, 6)."""
        start, normal = (y[:, None].expand_as(v).reshape(-1, 3) for y in (p, normal))
        if not self.config.walk_steps:
            return [(v, v, outer6(normal).unflatten(0, v.shape[:2]))]
        index = shape[:, None].expand(v.shape[:2]).flatten()
        walks = []
        for planes, steps in zip((field.planes, *field.finer), self.config.walk_steps, strict=True):
            end = walk(planes, start, v.flatten(0, 1), index, steps, normal)
            there = outer6(end.normal).unflatten(0, v.shape[:2])
            walks.append(((end.point - start).view_as(v), end.vector.view_as(v), there))
        return walks


class LogHead(MapHead):
    """Log_p(q) = prior(x) + |x| (h(x) - h(0)) with x = q - p (ours).

    The first prior lays the chord flat on the tangent plane of the cloud at p. Beyond `NEAR` the
    logs on fans of geodesics, walked from p over the same planes as those of Exp, are further
    ones, and a gate decides between them. h sees the triplane of z(p) at x, the priors, the planes
    at p, and the narrow embedding at q and half-way. Log_p(p) = 0 and d(Log_p)_p = I by
    construction. With `anchored=False` it is the paper's LogNet: v = h(x).
    """

    def __init__(self, embedding: int, radius: float, config: HeadConfig) -> None:
        scales = max(1, len(config.walk_steps))
        fans = len(config.walk_steps) if config.fan_rays else 0
        told = 3 + FAN * fans + 2 * config.narrow + 12 * scales if config.anchored else 0
        super().__init__(embedding, told, radius, config)
        self.gate = Gate(told, fans) if config.anchored and fans else None

    def prepare(self, field: Embedding, p: Tensor, q: Tensor, shape: Tensor) -> Prepared:
        z, _ = interpolate(field.z, field.level, p, shape)  # (S, C)
        x = q - p[:, None]
        if not self.config.anchored:
            return Prepared(z, x)
        x = in_columns(torch.cat((torch.zeros_like(x[:, :1]), x), 1))  # (S, 1 + K, 3)
        normal = field.planes.normal(p, shape)
        flat = lay_flat(field.planes, normal, x)
        passed = (read_narrow(field, p[:, None] + t * x, shape) for t in (0.5, 1.0))
        told, priors = [(flat - x) / self.radius, *passed], [flat]
        site = sites(field, p, normal, shape)
        if self.gate is None:
            return Prepared(z, x, flat, tuple(told), site)
        for planes in (field.planes, *field.finer):
            fan, known = self.on_fan(planes, p, x, flat, shape)
            priors.append(fan)
            told.append(known)
        return Prepared(z, x, self.gate(priors, told, site), tuple(told), site)

    def on_fan(
        self, planes: LocalPlanes, p: Tensor, x: Tensor, flat: Tensor, shape: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Logs on the fans of one scale (S, K, 3), and what is told of them (S, K, FAN).

        Sources whose queries all lie within `NEAR` need no fan.
        """
        share = far_share(x / self.radius)
        far = (share > 0).any(1).squeeze(-1).nonzero().squeeze(-1)
        known = x.new_zeros(*x.shape[:2], FAN)
        if not len(far):
            return flat, known
        own, there, chords = p[far], shape[far], x[far]
        fan = fan_of(
            planes, own, planes.normal(own, there), there, self.config.fan_rays, self.radius
        )
        read = log_on_fan(fan, chords)
        away = share[far] * (read.vector - flat[far])
        longer = read.length - safe_norm(read.vector)
        told = torch.cat((longer / self.radius, read.normal, read.gap / self.radius), -1)
        told = torch.cat((away / self.radius, share[far] * told), -1)
        known = known.index_put((far,), told)
        return flat.index_put((far,), flat[far] + away), known

    def tangent(self, x: Tensor, vector: Tensor) -> Tensor:
        return vector


def far_share(x: Tensor) -> Tensor:
    """0 for chords (..., 3) within `NEAR`, 1 beyond `MIDDLE`, and smooth in between: (..., 1)."""
    t = ((safe_norm(x) - NEAR) / (MIDDLE - NEAR)).clamp(0, 1)
    return t * t * (3 - 2 * t)


def sites(field: Embedding, p: Tensor, normal: Tensor, shape: Tensor) -> Tensor:
    """What the planes of every scale say at the sources (S, 12 scales): spectra and normals."""
    parts = [field.planes.fine.spectra(p, shape), outer6(normal)]
    for planes in field.finer:
        parts += [planes.fine.spectra(p, shape), outer6(planes.normal(p, shape))]
    return torch.cat(parts, -1)


def read_narrow(field: Embedding, x: Tensor, shape: Tensor) -> Tensor:
    """Narrow embedding (S, K, narrow) at points (S, K, 3) of the cube; 0 where there is none."""
    if field.narrow is None:
        return x.new_zeros(*x.shape[:2], 0)
    index = shape[:, None].expand(x.shape[:2]).flatten()
    value = interpolate_or_zero(field.narrow, field.level, x.flatten(0, 1), index)
    return value.unflatten(0, x.shape[:2])
