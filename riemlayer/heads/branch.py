"""What the two branches of Fig. 2 share: modulated decoder, validity, gate, look-ups."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from riemlayer.config import HeadConfig
from riemlayer.geometry import LocalPlanes, Points, on_shell
from riemlayer.heads.siren import SirenDecoder
from riemlayer.heads.triplane import TriplaneDecoder, TriplaneHypernetwork, linear_with_site
from riemlayer.numerics import outer6, safe_norm
from riemlayer.octree import Level, interpolate_or_zero

TRAINED = 1.06
"""Longest vectors of the training data, in radii."""
HIGH = 0.1
"""Height of a source above a plane, in cells, that counts as half of high."""
SITE = 13
"""Channels that the planes of each scale say at a source; one more of them all."""
LIKELY = 2.0
"""Logit of the validity until it is trained: most queries within the radius are valid."""
STEEPNESS = 50.0
"""Fall of the validity's logit a radius beyond that."""
SURE = 10.0
"""Largest logit before that: a quarter of a radius further on nothing is valid."""


class Embedding(NamedTuple):
    """What the heads read: the embedding field of a packed batch of clouds, and its planes."""

    z: Tensor
    """(n, C) embeddings of the leaves."""
    narrow: Tensor | None
    """(n, narrow) a few channels of them, read at end points."""
    level: Level
    planes: LocalPlanes
    """Half as large as the leaves; for further walks a quarter as large, and as large."""
    points: Points
    """The cloud itself."""

    def map(self, change: Callable[[Tensor], Tensor]) -> Embedding:
        """The same with `change` applied to every tensor that depends on the cloud."""
        narrow = None if self.narrow is None else change(self.narrow)
        planes, points = self.planes.map(change), self.points.map(change)
        return Embedding(change(self.z), narrow, self.level.map(change), planes, points)


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
    trust: Tensor | None = None
    """(S, 1 + K, 1) what its correction of the prior counts, from 0 to 1."""

    @property
    def first(self) -> int:
        """Row of the first query."""
        return 0 if self.prior is None else 1


class MapHead(nn.Module):
    """What both branches share: modulated decoder, and a validity read from its hidden features.

    `prepare` looks up in the field, octree and planes; `answer` is a function of what it found.
    Validity does not disturb the maps: it sees the hidden features without a gradient.
    """

    gate: Gate | None
    """Of an anchored head."""

    def __init__(self, embedding: int, told: int, radius: float, config: HeadConfig) -> None:
        super().__init__()
        self.config, self.radius = config, radius
        if config.decoder == "siren":
            self.planes, self.decoder = None, SirenDecoder(embedding, 3 + told, config)
        else:
            self.planes = TriplaneHypernetwork(embedding, config.resolution, config.channels)
            self.decoder = TriplaneDecoder(3 + told, config)
        self.valid = nn.Linear(config.hidden, 1)
        nn.init.zeros_(self.valid.weight)
        nn.init.constant_(self.valid.bias, LIKELY)

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
        trust: Tensor | None = None,
    ) -> MapOutput:
        """prior + trust |x| (f(x) - f(0)), or f(x) where not anchored, and validity."""
        vector, logit = self.decode(z, x, told, z[:, :0] if site is None else site)
        if prior is not None and trust is not None:
            length = safe_norm(x) * (x != 0).any(-1, keepdim=True)  # 0 at 0, to the bit
            vector = prior + trust * length * (vector - vector[:, :1])
        return MapOutput(vector, self.validity(logit, x, vector))

    def decode(
        self, z: Tensor, x: Tensor, told: tuple[Tensor, ...], site: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The decoder, modulated by `z` (S, C), at `x` (S, K, 3), with what else it is told.

        Returns its answer (S, K, 3) and the validity's logit (S, K).
        """
        x = x / self.radius
        modulation = z if self.planes is None else self.planes(z, x)
        return self.decoder(modulation, x, told, site, self._logit)

    def _logit(self, hidden: Tensor) -> Tensor:
        return self.valid(hidden.detach()).squeeze(-1)

    def validity(self, logit: Tensor, x: Tensor, vector: Tensor) -> Tensor:
        """The logit (S, K), lowered where query or answer (S, K, 3), of which one is the tangent
        vector and the other its chord, is too long: no geodesic is shorter than its chord."""
        lengths = (safe_norm(y.detach()).squeeze(-1) for y in (x, vector))
        length = torch.maximum(*lengths) / self.radius
        return logit.clamp_max(SURE) - STEEPNESS * (length - TRAINED).clamp_min(0)


class Gate(nn.Module):
    """Moves the first prior towards each of the others, and says what a correction counts (ours).

    Its shares, from 0 to 1, are read from what is told. All priors agree with the map to first
    order at the source and corrections vanish there, so whatever it says is anchored.

    Args:
        told: channels of all that is told.
        others: priors beside the first.
        ways: which of these are no ends but ways to go from wherever one is, such as to the height
            of the source.
        lean: logits of the others' shares until they are trained; 0 for those that are not named.

    Shapes: priors (S, K, 3) each, told (S, K, ...), site (S, ...) -> prior (S, K, 3), trust
    (S, K, 1).
    """

    def __init__(
        self,
        told: int,
        others: int,
        ways: tuple[int, ...] = (),
        lean: tuple[float, ...] = (),
        hidden: int = 64,
    ) -> None:
        super().__init__()
        self.ways = ways
        self.first = nn.Linear(told, hidden)
        self.body = nn.Sequential(
            nn.GELU(),
            nn.Linear(hidden, hidden),
            nn.GELU(),
            last := nn.Linear(hidden, others + 1),
        )
        with torch.no_grad():
            last.bias[: len(lean)] += torch.tensor(lean)

    def forward(
        self, priors: list[Tensor], told: list[Tensor], site: Tensor
    ) -> tuple[Tensor, Tensor]:
        prior, *others = priors
        rows = torch.cat(told, -1).flatten(0, 1)
        source = torch.arange(len(site), device=site.device)[:, None].expand(prior.shape[:2])
        hidden = linear_with_site(self.first, site, rows, source.flatten())
        shares = self.body(hidden).sigmoid().to(prior.dtype).unflatten(0, prior.shape[:2])
        *shares, trust = shares.split(1, -1)
        for i, (share, other) in enumerate(zip(shares, others, strict=True)):
            prior = prior + share * (other if i in self.ways else other - prior)
        return prior, trust


def at_sources(planes: LocalPlanes, p: Tensor, shape: Tensor) -> list[tuple[Tensor, Tensor]]:
    """What `LocalPlanes.plane` answers at the sources (S, 3) on each scale."""
    scales = len(planes.scales)
    normal, height = planes.plane(p.repeat(scales, 1), planes.places(shape, scales))
    return list(zip(normal.chunk(scales), height.chunk(scales), strict=True))


def beside(field: Embedding, seen: Sequence[tuple[Tensor, Tensor]]) -> Tensor:
    """Share (S, 1) that shells have at the sources: 0 on the cloud, 1 well beside it.

    By the heights above the finest planes, which sharp edges hardly raise; above the first ones
    where there are none. `seen` is what `at_sources` answers.
    """
    (_, wide), (_, finest), *_ = seen
    height = torch.where(finest == 0, wide, finest)
    return on_shell(height, field.planes.fine.level.cell_size)


def sites(
    field: Embedding, p: Tensor, shape: Tensor, seen: Sequence[tuple[Tensor, Tensor]]
) -> Tensor:
    """What the planes say at the sources (S, 13 scales + 1), given `LocalPlanes.plane` there.

    Of every scale the spectra, the normal and how high the source lies above the plane: over a hull
    around the cloud far at every scale, over noise a little, at a sharp edge less the finer they
    are. Then how dense the cloud is.
    """
    parts, heights = [], []
    for scale, (normal, height) in zip(field.planes.scales, seen, strict=True):
        square = height.square()
        heights.append(square / (square + (HIGH * scale.fine.level.cell_size) ** 2))
        parts += [scale.fine.spectra(p, shape), outer6(normal)]
    dense = 1 / (1 + field.planes.fine.spacing(p, shape))[:, None]
    return torch.cat((*parts, *heights, dense), -1)


def read_narrow(field: Embedding, x: Tensor, shape: Tensor) -> Tensor:
    """Narrow embedding (S, K, narrow) at points (S, K, 3) of the cube; 0 where there is none."""
    if field.narrow is None:
        return x.new_zeros(*x.shape[:2], 0)
    index = shape[:, None].expand(x.shape[:2]).flatten()
    value = interpolate_or_zero(field.narrow, field.level, x.flatten(0, 1), index)
    return value.unflatten(0, x.shape[:2])
