"""Log maps of large regions from overlapping charts (Sec. 3.4, appendix F)."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from riemlayer.calculus import Calculus
from riemlayer.geometry import nearest_isometry
from riemlayer.numerics import falloff, product, safe_norm
from riemlayer.ops.arguments import check_cloud, check_point

SHELL = (0.75, 0.95)
"""Where in a chart new centres are looked for, in chart radii (appendix F)."""
BINS = 8
"""Angular bins of a chart, each of which offers one new centre."""
APART = 0.6
"""Least distance between centres, in chart radii."""
OVERLAP = 3
"""Least number of points that a chart shares with the atlas (appendix F)."""
MISFIT = 0.1
"""Root mean square misfit, in chart radii, at which a chart counts half; beyond three times that
it is left out."""


class Charts(NamedTuple):
    """The charts of an atlas, the source's own first."""

    centre: Tensor
    """(C, 3)"""
    rotation: Tensor
    """(C, 2, 2) from the frame at the centre to the atlas; a reflection where the normals' signs
    disagree."""
    offset: Tensor
    """(C, 2) of the centre in the atlas."""
    misfit: Tensor
    """(C,) root mean square distance to the atlas in the overlap, user's units."""


class Stitched(NamedTuple):
    """A log map beyond the trained radius."""

    coordinates: Tensor
    """(N, 2) in the frame at the source; 0 where not covered."""
    covered: Tensor
    """(N,) bool; not where charts that came round different ways contradict each other."""
    confidence: Tensor
    """(N,) in [0, 1]: the best chart's weight, Eq. (9), times how well that chart fits."""
    charts: Charts


@torch.no_grad()
def stitch_log(
    surface: Calculus,
    p: Tensor,
    points: Tensor,
    depth: int = 4,
    radius: float | None = None,
) -> Stitched:
    """Log_p of points far beyond the trained radius, by stitching local charts (Sec. 3.4, app. F).

    Breadth first: each round takes new centres from the boundary shells of the last round's charts,
    aligns all their charts to the atlas at once by weighted Kabsch-Umeyama, and blends them in with
    the weights (1 - d^2)^2 of Eq. (9). On a curved surface the answer depends on the way round, as
    any flattening does.

    Args:
        surface: an encoded surface of one shape.
        p: (3,) the source; nothing is covered where it is off the surface.
        points: (N, 3) on the surface; centres are taken from them.
        depth: rounds after the source's own chart; 0 is the plain log map.
        radius: of a chart, user's units; the trained radius by default.

    Raises:
        TypeError, ValueError: p is not one point or points are not (N, 3), one is not finite or of
            another dtype, depth is negative or the radius not positive.
    """
    check_cloud(surface, points)
    check_point(surface, p=p)
    if depth < 0:
        raise ValueError(f"depth must be at least 0, got {depth}")
    if radius is not None and not radius > 0:
        raise ValueError(f"radius must be positive, got {radius}")
    reach = float(surface.radius_at(p)) if radius is None else radius
    atlas = _Atlas(points, reach)
    local, weight = _charts(surface, p[None], points, reach)
    eye = torch.eye(2, dtype=points.dtype, device=points.device)[None]
    atlas.add(
        p[None], local, weight, eye, torch.zeros_like(local[:, 0]), torch.zeros_like(weight[:, 0])
    )
    for _ in range(depth):
        centres = atlas.new_centres(local, weight)
        if not len(centres):
            break
        local, weight = _charts(surface, points[centres], points, reach)
        kept, rotation, offset, misfit = atlas.align(local, weight)
        if not len(kept):
            break
        local, weight = local[kept], weight[kept]
        atlas.add(points[centres[kept]], local, weight, rotation, offset, misfit)
    return atlas.result()


def _charts(
    surface: Calculus, centres: Tensor, points: Tensor, reach: float
) -> tuple[Tensor, Tensor]:
    """Local coordinates (C, N, 2) and weights (C, N), Eq. (9); 0 outside of a chart."""
    log, logit = surface.decode_log(centres[:, None], points[None])
    local = product(log, surface.frame(centres)[:, :, :2])
    inside = (logit > 0) & ((points[None] - centres[:, None]).norm(dim=-1) < reach)
    inside &= surface.in_support(centres)[:, None]
    for i, centre in enumerate(centres):
        near = inside[i].nonzero().squeeze(-1)
        inside[i, near] = surface.comes_back(centre, points[near], log[i, near])
    d = safe_norm(local).squeeze(-1) / reach
    return local, torch.where(inside, falloff(d), 0)


class _Atlas:
    """Global coordinates of the points as far as they are known, and the charts they came from."""

    def __init__(self, points: Tensor, reach: float) -> None:
        self.points, self.reach = points, reach
        self.total = points.new_zeros(len(points), 2)
        self.weight, self.square, self.confidence = points.new_zeros(3, len(points))
        self.charts: list[Charts] = []

    def coordinates(self) -> Tensor:
        return self.total / self.weight.clamp_min(1e-12)[:, None]

    def add(
        self,
        centre: Tensor,
        local: Tensor,
        weight: Tensor,
        rotation: Tensor,
        offset: Tensor,
        misfit: Tensor,
    ) -> None:
        """Blend charts in, each as far as it fits."""
        fits = 1 / (1 + (misfit / (MISFIT * self.reach)).square())
        weight = weight * fits[:, None]
        placed = product(local, rotation.mT) + offset[:, None]
        self.total += (weight[..., None] * placed).sum(0)
        self.square += (weight * placed.square().sum(-1)).sum(0)
        self.weight += weight.sum(0)
        self.confidence = torch.maximum(self.confidence, weight.amax(0))
        self.charts.append(Charts(centre, rotation, offset, misfit))

    def align(self, local: Tensor, weight: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Weighted rigid alignment (Kabsch and Umeyama) of charts (C, N, 2) to the atlas.

        Returns:
            Which charts fit, and of these rotation (C', 2, 2), offset (C', 2) and misfit (C',).
        """
        w = weight * self.confidence * self.agreed()
        enough = (w > 0).sum(-1) >= OVERLAP
        share = (w / w.sum(-1, keepdim=True).clamp_min(1e-12))[..., None]
        target = self.coordinates()[None]
        mean, goal = (share * local).sum(1, keepdim=True), (share * target).sum(1, keepdim=True)
        rotation = nearest_isometry(product((share * (target - goal)).mT, local - mean))
        offset = goal - product(mean, rotation.mT)
        left = product(local, rotation.mT) + offset - target
        misfit = (share[..., 0] * left.square().sum(-1)).sum(-1).sqrt()
        kept = (enough & (misfit < 3 * MISFIT * self.reach)).nonzero().squeeze(-1)
        return kept, rotation[kept], offset[kept, 0], misfit[kept]

    def new_centres(self, local: Tensor, weight: Tensor) -> Tensor:
        """Points (C',) in the boundary shells of charts (C, N, 2), one an angular bin.

        Those nearest to the source come first, and ones too near to a centre are passed over.
        """
        d = safe_norm(local).squeeze(-1) / self.reach
        shell = (weight > 0) & (d > SHELL[0]) & (d < SHELL[1])
        angle = torch.atan2(local[..., 1], local[..., 0])
        bins = ((angle / (2 * math.pi) + 0.5) * BINS).long().clamp_max(BINS - 1)
        far = safe_norm(self.coordinates()).squeeze(-1)
        offered = []
        for i in range(BINS):
            distance = torch.where(shell & (bins == i), far, torch.inf)
            best = distance.argmin(-1)
            offered.append(best[distance.gather(-1, best[:, None]).squeeze(-1).isfinite()])
        candidates = torch.cat(offered).unique()
        centres = torch.cat([chart.centre for chart in self.charts])
        chosen = []
        for i in candidates[far[candidates].argsort()].tolist():
            if bool(((centres - self.points[i]).norm(dim=-1) > APART * self.reach).all()):
                chosen.append(i)
                centres = torch.cat((centres, self.points[i : i + 1]))
        return torch.tensor(chosen, dtype=torch.long, device=self.points.device)

    def agreed(self) -> Tensor:
        """(N,) bool: covered, and not by charts that came to it on different ways round."""
        mean = self.coordinates().square().sum(-1)
        spread = self.square / self.weight.clamp_min(1e-12) - mean
        return (self.weight > 0) & (spread < (3 * MISFIT * self.reach) ** 2)

    def result(self) -> Stitched:
        covered = self.agreed()
        coordinates = torch.where(covered[:, None], self.coordinates(), 0)
        charts = Charts(*(torch.cat(x) for x in zip(*self.charts, strict=True)))
        return Stitched(coordinates, covered, torch.where(covered, self.confidence, 0), charts)
