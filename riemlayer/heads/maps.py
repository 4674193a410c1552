"""The two branches of Fig. 2: ExpHead and LogHead."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from riemlayer.config import SCALES, WALKS, HeadConfig
from riemlayer.geometry import (
    MET,
    FanLog,
    LocalPlanes,
    Shell,
    Walked,
    bend,
    fade_in,
    fan_of,
    lay_flat,
    log_on_fan,
    walk,
)
from riemlayer.heads.branch import (
    SITE,
    Embedding,
    Gate,
    MapHead,
    Prepared,
    at_sources,
    beside,
    read_narrow,
    sites,
)
from riemlayer.heads.fans import JointFan, fan_share
from riemlayer.heads.tangent import TangentPlane
from riemlayer.numerics import in_columns, outer6, recomputed, safe_norm
from riemlayer.octree import interpolate

LEAN = 2.0
"""Logit of the fan's share in Log until it is trained, and less of the bent chord's."""
ON_SHELL = 2
"""Steps of a walk on a shell, in those of one over planes."""
PIECE = 1 << 13
"""Vectors that are walked at once: what more need is returned to the system at every step."""
WALK = 13 + MET
"""Channels that Exp's decoder is told of a walk: 3 + 1 + 3 + 6, and what it met."""
FAN = 13 + MET
"""Channels that Log's decoder is told of a fan: 3 + 1 + 6 + 3, and what its walks met."""
BENT = 12
"""Channels that it is told of a bent chord: 3, and of the planes at its end 6 + 3."""


class ExpHead(MapHead):
    """Exp_p(v) = walk(p, v) + t |v| (f(v) - f(0)), with f told where the walk ended (ours).

    Walks over the cloud's planes are the priors: one over planes half as large as the leaves, which
    turns back at the rims of sheets; one over finer planes, which see detail; one over wider ones,
    which noise and gaps between points disturb less. By what the planes are like and what the walks
    met, a gate decides between their ends, whether to go where a walk on the shell that p lies on
    ends instead, whether to lift the end to the height that p has above its plane, and what the
    correction counts, t. f sees the triplane of z(p) at v, the same of the walks, the planes at p
    and the narrow embedding where the first walk landed. Exp_p(0) = p and d(Exp_p)_0 = I by
    construction. With `anchored=False` it is the paper's ExpNet, p + f(v).
    """

    def __init__(self, embedding: int, radius: float, config: HeadConfig) -> None:
        walks = config.walks
        self.scales, self.shells = min(walks, SCALES), walks == WALKS
        told = 2 + WALK * max(1, walks) + config.narrow + 3 * (walks > 0)
        told = told + SITE * max(1, self.scales) if config.anchored else 0
        super().__init__(embedding, told, radius, config)
        ways = (*([0] * self.shells), *([walks - 1] * (walks > 0)))
        self.gate = Gate(told, walks, ways) if config.anchored else None

    def prepare(self, field: Embedding, p: Tensor, v: Tensor, shape: Tensor) -> Prepared:
        z, _ = interpolate(field.z, field.level, p, shape)  # (S, C)
        if self.gate is None:
            return Prepared(z, v)
        v = in_columns(torch.cat((torch.zeros_like(v[:, :1]), v), 1))  # (S, 1 + K, 3)
        seen = at_sources(field.planes, p, shape)
        first, *others = self.walks(field, p, v, shape, seen[0])
        told = [safe_norm(v) / self.radius, self.says(first, v, first.point - p[:, None] - v)]
        told += [self.says(end, v, end.point - first.point) for end in others]
        told.append(read_narrow(field, first.point, shape))
        ends = [end.point - p[:, None] for end in (first, *others)]
        if self.scales:
            square = v.square().sum(-1, keepdim=True)
            high = fade_in(square, field.planes.fine.level.cell_size) * seen[0][1][:, None]
            lift = high * first.normal
            told.append(lift / self.radius)
            ends.append(lift)
        if self.shells:
            share = beside(field, seen)
            way, says = self.on_shells(field, p, v, shape, first, share)
            told.append(says)
            ends.insert(1, way)
        site = sites(field, p, shape, seen)
        prior, trust = self.gate(ends, told, site)
        return Prepared(z, v, prior, tuple(told), site, trust)

    def walks(
        self, field: Embedding, p: Tensor, v: Tensor, shape: Tensor, plane: Sequence[Tensor]
    ) -> list[Walked]:
        """Where walks over the planes of each scale end (S, K, ...); a straight one without any."""
        if not self.scales:
            normal, met = plane[0][:, None].expand_as(v), v.new_zeros(*v.shape[:2], MET)
            return [Walked(p[:, None] + v, v, normal, met)]
        places = field.planes.places(shape, self.scales)
        p, v, *plane = (torch.cat([y] * self.scales) for y in (p, v, *plane))
        end = _walked(field.planes, self.config.walk_steps, p, v, places, plane)
        return [Walked(*y) for y in zip(*(y.chunk(self.scales) for y in end), strict=True)]

    def on_shells(
        self, field: Embedding, p: Tensor, v: Tensor, shape: Tensor, first: Walked, share: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The way (S, K, 3) from the ends of the first walks to those on the shells that sources
        beside the cloud lie on, and what these say (S, K, WALK); 0 for sources on the cloud."""
        rows = share.detach().squeeze(-1).nonzero().squeeze(-1)
        way, says = torch.zeros_like(v), v.new_zeros(*v.shape[:2], WALK)
        if not len(rows):
            return way, says
        start, source, share = p[rows], torch.arange(len(rows), device=p.device), share[rows, None]
        shell = Shell.through(field.planes, start, shape[rows])
        plane = shell.plane(start, source)
        end = _walked(shell, ON_SHELL * self.config.walk_steps, start, v[rows], source, plane)
        away = end.point - first.point[rows]
        way = way.index_copy(0, rows, share * away)
        return way, says.index_copy(0, rows, share * self.says(end, v[rows], away))

    def says(self, end: Walked, v: Tensor, away: Tensor) -> Tensor:
        """What the decoder is told of a walk (S, K, WALK) that ended `away` from another."""
        bend = safe_norm(away) / (safe_norm(v) + 0.01 * self.radius)
        where = away / self.radius, bend, end.vector / self.radius
        return torch.cat((*where, outer6(end.normal), end.met), -1)


class LogHead(MapHead):
    """Log_p(q) = prior(x) + t |x| (h(x) - h(0)) with x = q - p (ours).

    A first prior lays the chord flat on the tangent plane of the cloud. Others agree with it close
    to p: one is read from fans of geodesics, walked from p where those of Exp walk; the last one
    bends the chord as the finest planes at both its ends say. A gate decides between them, and what
    the correction counts, t. h sees the triplane of z(p) at x, the priors, the planes at p and at
    q, and the narrow embedding at q and half-way. Log_p(p) = 0 and d(Log_p)_p = I by construction.
    With `anchored=False` it is the paper's LogNet: v = h(x).
    """

    def __init__(self, embedding: int, radius: float, config: HeadConfig) -> None:
        scales = max(1, min(config.walks, SCALES))
        self.fans = min(config.walks, SCALES) if config.fan_rays else 0
        self.shells = bool(self.fans) and config.walks == WALKS
        self.bends = scales > 1
        fans = bool(self.fans) + self.shells
        told = 4 + FAN * fans + BENT * self.bends + 2 * config.narrow + SITE * scales
        super().__init__(embedding, told if config.anchored else 0, radius, config)
        self.joint = JointFan(self.fans, SITE * scales + 1) if self.fans else None
        ways = (0,) * self.shells
        lean = (0.0,) * self.shells + (LEAN,) * bool(self.fans) + (-LEAN,) * self.bends
        self.gate = Gate(told, fans + self.bends, ways, lean) if config.anchored else None
        self.tangent_plane = TangentPlane(scales) if config.anchored else None

    def prepare(self, field: Embedding, p: Tensor, q: Tensor, shape: Tensor) -> Prepared:
        z, _ = interpolate(field.z, field.level, p, shape)  # (S, C)
        x = q - p[:, None]
        if self.gate is None or self.tangent_plane is None:
            return Prepared(z, x)
        x = in_columns(torch.cat((torch.zeros_like(x[:, :1]), x), 1))  # (S, 1 + K, 3)
        seen = at_sources(field.planes, p, shape)
        site = sites(field, p, shape, seen)
        normal = self.tangent_plane(field, p, shape, site, seen)
        flat = lay_flat(normal, x, field.planes.fine.level.cell_size)
        passed = (read_narrow(field, p[:, None] + t * x, shape) for t in (0.5, 1.0))
        told, priors = [(flat - x) / self.radius, *passed], [flat]
        share = fan_share(x / self.radius)
        if self.fans:
            places = field.planes.places(shape, self.fans)
            asked = p, x, flat, share, normal, site
            log, says = self.on_fan(field.planes, places, self.config.walk_steps, *asked)
            priors.append(log)
            told.append(says)
        if self.shells:
            share = share * beside(field, seen)[:, None]
            way, says = self.on_shells(field, p, x, flat, shape, share)
            priors.insert(1, way)
            told.append(says)
        if self.bends:
            bent, says = self.bent(field.planes, p, x, flat, shape, normal)
            priors.append(bent)
            told.append(says)
        prior, trust = self.gate(priors, told, site)
        return Prepared(z, x, prior, tuple(told), site, trust)

    def on_fan(
        self,
        ground: LocalPlanes | Shell,
        place: Tensor,
        steps: int,
        p: Tensor,
        x: Tensor,
        flat: Tensor,
        share: Tensor,
        *seen: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Logs on fans over planes or shells (S, K, 3), and what is told of them (S, K, FAN).

        At each source there is a fan for every `place` (fans S,). Only sources and queries in which
        they have a share are looked at; others stay `flat`. `seen` is the tangent plane's normal
        and the site, which `read_fans` may be told.
        """
        asked = share.detach().squeeze(-1) > 0
        rows, columns = (asked.any(i).nonzero().squeeze(-1) for i in (1, 0))
        known = x.new_zeros(*x.shape[:2], FAN)
        if not len(rows):
            return flat, known
        part = rows[:, None], columns
        chords, share, start = x[part], share[part], flat[part]
        place = place.view(-1, len(p)).T
        size = max(1, PIECE // (place.shape[1] * self.config.fan_rays))
        sources = (y[rows].split(size) for y in (place, p, *seen))
        each = zip(chords.split(size), *sources, strict=True)
        reads = [self.read_fans(ground, steps, *piece) for piece in each]
        read = FanLog(*(torch.cat(y) for y in zip(*reads, strict=True)))
        away = share * (read.vector - start)
        longer = read.length - safe_norm(read.vector)
        told = torch.cat((longer / self.radius, read.normal, read.gap / self.radius, read.met), -1)
        told = torch.cat((away / self.radius, share * told), -1)
        return flat.index_put(part, start + away), known.index_put(part, told)

    def read_fans(
        self,
        ground: LocalPlanes | Shell,
        steps: int,
        x: Tensor,
        place: Tensor,
        p: Tensor,
        normal: Tensor | None = None,
        site: Tensor | None = None,
    ) -> FanLog:
        """Logs of chords (S, K, 3) on the fans of places (S, fans), which are one by the `site`."""
        at = (y.repeat_interleave(place.shape[1], 0) for y in (p, normal) if y is not None)
        p, *tangent = at
        rays = self.config.fan_rays
        fan = recomputed(fan_of, ground, p, place.flatten(), rays, self.radius, steps, *tangent)
        if self.joint is not None and site is not None:
            fan = self.joint(fan, site)
        return log_on_fan(fan, x)

    def on_shells(
        self, field: Embedding, p: Tensor, x: Tensor, flat: Tensor, shape: Tensor, share: Tensor
    ) -> tuple[Tensor, Tensor]:
        """`on_fan` over the shells that sources beside the cloud lie on; the way from `flat`."""
        rows = share.detach().flatten(1).any(-1).nonzero().squeeze(-1)
        way, says = torch.zeros_like(x), x.new_zeros(*x.shape[:2], FAN)
        if not len(rows):
            return way, says
        shell = Shell.through(field.planes, p[rows], shape[rows])
        source = torch.arange(len(rows), device=p.device)
        asked = (y[rows] for y in (p, x, flat, share))
        log, told = self.on_fan(shell, source, ON_SHELL * self.config.walk_steps, *asked)
        way = way.index_copy(0, rows, log - flat[rows])
        return way, says.index_copy(0, rows, told)

    def bent(
        self, planes: LocalPlanes, p: Tensor, x: Tensor, flat: Tensor, shape: Tensor, normal: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Bent chords (S, K, 3), and what is told of them and of the planes at q (S, K, BENT)."""
        q, place = (p[:, None] + x).flatten(0, 1), shape + planes.fine.level.batch_size
        site = planes.site(place).repeat_interleave(x.shape[1])
        end, gap = planes.plane(q, site, normal.repeat_interleave(x.shape[1], 0))
        gap, through = gap * end, outer6(end)
        end, gap, through = (y.unflatten(0, x.shape[:2]) for y in (end, gap, through))
        bent = bend(normal, x, end, planes.scales[1].fine.level.cell_size)
        told = (bent - flat) / self.radius, through, gap / self.radius
        return bent, torch.cat(told, -1)


def _walked(
    ground: LocalPlanes | Shell,
    steps: int,
    p: Tensor,
    v: Tensor,
    place: Tensor,
    plane: Sequence[Tensor],
) -> Walked:
    """Where walks of S sources along v (S, K, 3) end (S, K, ...); of what they met the mean."""
    start, place, normal, height = (y.repeat_interleave(v.shape[1], 0) for y in (p, place, *plane))
    rows = (y.split(PIECE) for y in (start, v.flatten(0, 1), place, normal, height))
    each = zip(*rows, strict=True)
    ends = [walk(ground, x, w, at, steps, (n, h)) for x, w, at, n, h in each]
    end = Walked(*(torch.cat(y) for y in zip(*ends, strict=True)))
    end = end._replace(met=end.met / steps)
    return Walked(*(y.unflatten(0, v.shape[:2]) for y in end))
