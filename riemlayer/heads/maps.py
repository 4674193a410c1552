"""The two branches of Fig. 2: ExpHead and LogHead."""

from __future__ import annotations

import torch
from torch import Tensor

from riemlayer.config import HeadConfig
from riemlayer.geometry import MET, LocalPlanes, fade_in, fan_of, lay_flat, log_on_fan, walk
from riemlayer.heads.branch import (
    SITE,
    TRAINED,
    Embedding,
    Gate,
    MapHead,
    Prepared,
    read_narrow,
    sites,
)
from riemlayer.numerics import in_columns, outer6, safe_norm
from riemlayer.octree import interpolate

NEAR, MIDDLE, BEYOND = 0.02, 0.1, 1.3
"""Chords, in radii, up to which fans have no share in Log, from which they have a full one, and
beyond which none again: no geodesic is shorter than its chord."""
WALK = 13 + MET
"""Channels that Exp's decoder is told of a walk: 3 + 1 + 3 + 6, and what it met."""
FAN = 13 + MET
"""Channels that Log's decoder is told of a fan: 3 + 1 + 6 + 3, and what its walks met."""


class ExpHead(MapHead):
    """Exp_p(v) = walk(p, v) + t |v| (f(v) - f(0)), with f told where the walk ended (ours).

    Walks over the cloud's planes are the priors: one over planes half as large as the leaves, which
    turns back at the rims of sheets; one over finer planes, which see detail; one over wider ones,
    which noise and gaps between points disturb less. By what the planes are like and what the walks
    met, a gate decides between their ends, whether to lift them to the height that p has above its
    plane, as on a shell around the cloud, and what the correction counts, t. f sees the triplane of
    z(p) at v, the same of the walks, the planes at p and the narrow embedding where the first walk
    landed. Exp_p(0) = p and d(Exp_p)_0 = I by construction. With `anchored=False` it is the paper's
    ExpNet, p + f(v).
    """

    def __init__(self, embedding: int, radius: float, config: HeadConfig) -> None:
        walks = len(config.walk_steps)
        told = 2 + (WALK + SITE) * max(1, walks) + config.narrow + 3 * (walks > 0)
        told = told if config.anchored else 0
        super().__init__(embedding, told, radius, config)
        self.gate = Gate(told, walks, lifts=walks > 0) if config.anchored else None

    def prepare(self, field: Embedding, p: Tensor, v: Tensor, shape: Tensor) -> Prepared:
        z, _ = interpolate(field.z, field.level, p, shape)  # (S, C)
        if self.gate is None:
            return Prepared(z, v)
        v = in_columns(torch.cat((torch.zeros_like(v[:, :1]), v), 1))  # (S, 1 + K, 3)
        normal, height = plane = field.planes.plane(p, shape)
        site, length = sites(field, p, plane, shape), safe_norm(v)
        told, ends, normals = [length / self.radius], [], []
        for moved, turned, there, met in self.walks(field, p, v, shape, normal, height):
            away = moved - (ends[0] if ends else v)
            bend = safe_norm(away) / (length + 0.01 * self.radius)
            told += [away / self.radius, bend, turned / self.radius, outer6(there), met]
            ends.append(moved)
            normals.append(there)
        told.append(read_narrow(field, p[:, None] + ends[0], shape))
        if self.config.walk_steps:
            square = v.square().sum(-1, keepdim=True)
            lift = fade_in(square, field.planes) * height[:, None] * normals[0]
            told.append(lift / self.radius)
            ends.append(lift)
        prior, trust = self.gate(ends, told, site)
        return Prepared(z, v, prior, tuple(told), site, trust)

    def tangent(self, x: Tensor, vector: Tensor) -> Tensor:
        return x

    def walks(
        self, field: Embedding, p: Tensor, v: Tensor, shape: Tensor, *plane: Tensor
    ) -> list[tuple[Tensor, Tensor, Tensor, Tensor]]:
        """Of each walk: where it ends, v carried there, the normal there (S, K, 3), and what it met
        (S, K, MET), a step."""
        start, normal, height = (y.repeat_interleave(v.shape[1], 0) for y in (p, *plane))
        if not self.config.walk_steps:
            return [(v, v, normal.view_as(v), v.new_zeros(*v.shape[:2], MET))]
        index = shape[:, None].expand(v.shape[:2]).flatten()
        walks, scales = [], (field.planes, *field.others)
        for planes, steps in zip(scales, self.config.walk_steps, strict=True):
            end = walk(planes, start, v.flatten(0, 1), index, steps, (normal, height))
            parts = (end.point - start, end.vector, end.normal, end.met / steps)
            walks.append(tuple(y.unflatten(0, v.shape[:2]) for y in parts))
        return walks


class LogHead(MapHead):
    """Log_p(q) = prior(x) + t |x| (h(x) - h(0)) with x = q - p (ours).

    A first prior lays the chord flat on the tangent plane of the cloud. Others, which agree with it
    close to p, are read from fans of geodesics, walked from p over the same planes as those of Exp.
    A gate decides between them, and what the correction counts, t. h sees the triplane of z(p) at
    x, the priors, the planes at p, and the narrow embedding at q and half-way. Log_p(p) = 0 and
    d(Log_p)_p = I by construction. With `anchored=False` it is the paper's LogNet: v = h(x).
    """

    def __init__(self, embedding: int, radius: float, config: HeadConfig) -> None:
        scales = max(1, len(config.walk_steps))
        self.fans = len(config.walk_steps) if config.fan_rays else 0
        told = 4 + FAN * self.fans + 2 * config.narrow + SITE * scales if config.anchored else 0
        super().__init__(embedding, told, radius, config)
        self.gate = Gate(told, self.fans) if config.anchored else None

    def prepare(self, field: Embedding, p: Tensor, q: Tensor, shape: Tensor) -> Prepared:
        z, _ = interpolate(field.z, field.level, p, shape)  # (S, C)
        x = q - p[:, None]
        if self.gate is None:
            return Prepared(z, x)
        x = in_columns(torch.cat((torch.zeros_like(x[:, :1]), x), 1))  # (S, 1 + K, 3)
        plane = field.planes.plane(p, shape)
        flat = lay_flat(field.planes, plane[0], x)
        passed = (read_narrow(field, p[:, None] + t * x, shape) for t in (0.5, 1.0))
        told, priors = [(flat - x) / self.radius, *passed], [flat]
        scales = (field.planes, *field.others)[: self.fans]
        for planes, steps in zip(scales, self.config.walk_steps, strict=False):
            fan, known = self.on_fan(planes, steps, p, x, flat, shape)
            priors.append(fan)
            told.append(known)
        site = sites(field, p, plane, shape)
        prior, trust = self.gate(priors, told, site)
        return Prepared(z, x, prior, tuple(told), site, trust)

    def on_fan(
        self, planes: LocalPlanes, steps: int, p: Tensor, x: Tensor, flat: Tensor, shape: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Logs on the fans of one scale (S, K, 3), and what is told of them (S, K, FAN).

        Only sources and queries in which fans have a share are looked at; others stay `flat`.
        """
        share = fan_share(x / self.radius)
        asked = share.detach().squeeze(-1) > 0
        rows, columns = (asked.any(i).nonzero().squeeze(-1) for i in (1, 0))
        known = x.new_zeros(*x.shape[:2], FAN)
        if not len(rows):
            return flat, known
        fan = fan_of(planes, p[rows], shape[rows], self.config.fan_rays, self.radius, steps)
        part = rows[:, None], columns
        chords, share, start = x[part], share[part], flat[part]
        read = log_on_fan(fan, chords)
        away = share * (read.vector - start)
        longer = read.length - safe_norm(read.vector)
        told = (longer / self.radius, read.normal, read.gap / self.radius, read.met)
        told = torch.cat(told, -1)
        told = torch.cat((away / self.radius, share * told), -1)
        return flat.index_put(part, start + away), known.index_put(part, told)

    def tangent(self, x: Tensor, vector: Tensor) -> Tensor:
        return vector


def fan_share(x: Tensor) -> Tensor:
    """Share (..., 1) that fans have in Log at chords (..., 3) in radii, without a kink."""
    length = safe_norm(x)
    near = ((length - NEAR) / (MIDDLE - NEAR)).clamp(0, 1)
    far = ((BEYOND - length) / (BEYOND - TRAINED)).clamp(0, 1)
    return near.square() * (3 - 2 * near) * far.square() * (3 - 2 * far)
