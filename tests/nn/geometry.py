"""Local geometry of closed-form surfaces: exact logs and transport, random frames, float64."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from exact import Exact, sphere_points
from torch import Tensor

from riemlayer.calculus import frame_of
from riemlayer.data.closed_form import Plane
from riemlayer.geometry.walk import turn
from riemlayer.numerics import safe_norm
from riemlayer.ops import LocalGeometry
from riemlayer.ops.local_geometry import MARGIN, angle_of


class Cloud(Exact):
    """Points on a closed-form surface, with what a layer asks of an `EncodedSurface`.

    `unit` is the length of the surface's own unit.
    """

    def __init__(
        self, points: Tensor, batch: Tensor | None = None, surface=None, unit: float = 1.0
    ) -> None:
        super().__init__(surface)
        self.points, self.unit = points, unit
        self.batch = torch.zeros(len(points)).long() if batch is None else batch

    def decode_exp(self, p: Tensor, v: Tensor, shape=None) -> tuple[Tensor, Tensor]:
        q, logit = super().decode_exp(p / self.unit, v / self.unit, shape)
        return self.unit * q, logit

    def own_points(self) -> tuple[Tensor, Tensor, Tensor]:
        return self.points, self.batch, self.batch


@dataclass
class Case:
    """A cloud and its geometry."""

    cloud: Cloud
    geometry: LocalGeometry


def make(cloud: Cloud, k: int = 7) -> Case:
    """Exact edges from each point's k nearest; frames turned at random about the normals."""
    points, batch, _ = cloud.own_points()
    n = len(points)
    chord = torch.cdist(points, points).masked_fill(batch[:, None] != batch, math.inf)
    near = chord.fill_diagonal_(math.inf).topk(k, largest=False)[1]
    sender, receiver = near.flatten(), torch.arange(n).repeat_interleave(k)
    normal = cloud.normal(points)
    frame = frame_of(normal)
    v = cloud.decode_log(points[receiver], points[sender])[0]
    log = (v[:, None] @ frame[receiver, :, :2]).squeeze(1)
    r = safe_norm(log).squeeze(-1)
    radius = r.detach().view(n, k).amax(-1)
    weight = (1 - (r.view(n, k) / (MARGIN * radius[:, None])).square()).square()
    carried = turn(frame[sender, :, 0], normal[sender], normal[receiver])
    transport = angle_of((carried[:, None] @ frame[receiver, :, :2]).squeeze(1))
    geometry = LocalGeometry(
        edge_index=torch.stack((sender, receiver)),
        log=log,
        r=r,
        theta=angle_of(log),
        transport=transport,
        weight=(weight / weight.sum(-1, keepdim=True)).flatten(),
        valid=torch.ones_like(sender, dtype=torch.bool),
        frame=frame,
        radius=radius,
        batch=batch,
    )
    return Case(cloud, geometry.turned(angles(n)))


def sphere(n: int = 40, k: int = 7) -> Case:
    """Random points of the unit sphere."""
    return make(Cloud(sphere_points(n)), k)


def plane(n: int = 40, k: int = 7) -> Case:
    """Random points of a square."""
    return make(Cloud(Plane().sample(n), surface=Plane()), k)


def packed(*sizes: int) -> tuple[Case, list[Case]]:
    """Spheres packed into one cloud, and the same ones alone with the same frames."""
    alone = [sphere(n) for n in sizes]
    batch = torch.cat([torch.full((n,), i) for i, n in enumerate(sizes)])
    shift = [sum(sizes[:i]) for i in range(len(sizes))]
    edges = [case.geometry.edge_index + s for case, s in zip(alone, shift, strict=True)]
    fields = [case.geometry._replace(edge_index=e.T) for case, e in zip(alone, edges, strict=True)]
    together = LocalGeometry(*map(torch.cat, zip(*fields, strict=True)))
    together = together._replace(edge_index=together.edge_index.T, batch=batch)
    points = torch.cat([case.cloud.points for case in alone])
    return Case(Cloud(points, batch), together), alone


def permuted(case: Case, order: Tensor) -> Case:
    """The same with point `order[i]` as point i."""
    g, place = case.geometry, order.argsort()
    edges = place[g.edge_index]
    by_receiver = edges[1].argsort(stable=True)
    changes = {name: getattr(g, name)[by_receiver] for name in EDGE_FIELDS}
    changes |= {name: getattr(g, name)[order] for name in ("frame", "radius", "batch")}
    geometry = g._replace(edge_index=edges[:, by_receiver], **changes)
    return Case(Cloud(case.cloud.points[order], case.cloud.batch[order]), geometry)


def without_edges(case: Case) -> LocalGeometry:
    """The same points with no edge at all."""
    g = case.geometry
    changes = {name: getattr(g, name)[:0] for name in EDGE_FIELDS}
    return g._replace(edge_index=g.edge_index[:, :0], radius=torch.zeros_like(g.radius), **changes)


def with_invalid(case: Case, lost: Tensor) -> tuple[LocalGeometry, LocalGeometry]:
    """Edges `lost` (E,) marked as invalid, and the same without these edges."""
    g = case.geometry
    weight = torch.where(lost, 0, g.weight)
    radius = torch.where(lost, 0, g.r).view(g.points, -1).amax(-1)
    marked = g._replace(valid=~lost, weight=weight, radius=radius)
    kept = {name: getattr(marked, name)[~lost] for name in EDGE_FIELDS}
    return marked, marked._replace(edge_index=g.edge_index[:, ~lost], **kept)


def scaled(case: Case, factor: float) -> Case:
    """The same in another unit of length."""
    g, cloud = case.geometry, case.cloud
    g = g._replace(log=factor * g.log, r=factor * g.r, radius=factor * g.radius)
    return Case(Cloud(factor * cloud.points, cloud.batch, cloud.surface, factor), g)


def angles(n: int) -> Tensor:
    """Random angles (n,) in [0, 2 pi)."""
    return 2 * math.pi * torch.rand(n, dtype=torch.float64)


def steps(n: int, count: int) -> Tensor:
    """Random multiples (n,) of 2 pi / count."""
    return torch.randint(count, (n,)).double() * (2 * math.pi / count)


def rotated(x: Tensor, angle: Tensor) -> Tensor:
    """Vectors (n, C, 2) turned by angles (n,)."""
    c, s = angle.cos()[:, None], angle.sin()[:, None]
    a, b = x.unbind(-1)
    return torch.stack((c * a - s * b, s * a + c * b), -1)


EDGE_FIELDS = ("log", "r", "theta", "transport", "weight", "valid")
