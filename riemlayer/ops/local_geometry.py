"""One record of a cloud's local geometry that feeds every layer of `riemlayer.nn`."""

from __future__ import annotations

from typing import NamedTuple, Self

import torch
from torch import Tensor

from riemlayer.checks import check_shapes
from riemlayer.geometry import angle_of, frame_of, turn
from riemlayer.numerics import falloff, normalise, product, safe_norm
from riemlayer.octree import build_octree, knn, radius_search
from riemlayer.ops.pieces import NEAR, pieces
from riemlayer.surface import EncodedSurface

MARGIN = 1.25
"""Where the window of a receiver ends, in distances of its farthest neighbour."""


class LocalGeometry(NamedTuple):
    """Edges of a cloud with log-map coordinates.

    **Direction: edge e goes from the neighbour `edge_index[0, e]` to the receiver
    `edge_index[1, e]`; the receiver is the base point of `log`.** This is PyG's
    "source_to_target". Edges are sorted by receiver.
    """

    edge_index: Tensor
    """(2, E) int64: neighbour, receiver."""
    log: Tensor
    """(E, 2) Log_receiver(neighbour) in the receiver's frame, user's units."""
    r: Tensor
    """(E,) geodesic distance |log|."""
    theta: Tensor
    """(E,) angle of log in (-pi, pi]."""
    transport: Tensor
    """(E,) angle that turns the neighbour's coordinates of a tangent vector into the receiver's."""
    weight: Tensor
    """(E,) Eq. (9) of r over the neighbourhood's radius; sums to 1 over a receiver's valid edges,
    and is 0 on others."""
    valid: Tensor
    """(E,) bool: the neighbour lies before the receiver's cut locus, and on the same piece of the
    cloud: a chord across a gap is no geodesic."""
    frame: Tensor
    """(N, 3, 3) frames, columns e1, e2, normal; normals agree between neighbours."""
    radius: Tensor
    """(N,) distance of each receiver's farthest valid neighbour; 0 where it has none."""
    batch: Tensor
    """(N,) int64, cloud of each point."""

    @property
    def points(self) -> int:
        """N."""
        return len(self.frame)

    def to(self, device: torch.device | str) -> Self:
        """The same on another device."""
        return self._make(x.to(device) for x in self)

    def turned(self, angle: Tensor) -> Self:
        """The same geometry told in frames turned by `angle` (N,) about their normals.

        What layers that claim to be independent of the frames are tested with.

        Raises:
            ValueError: there is not one angle for each point.
        """
        check_shapes(angle=(angle, str(self.points)))
        sender, receiver = self.edge_index
        theta = self.theta - angle[receiver]
        theta = torch.atan2(theta.sin(), theta.cos())
        log = self.r[:, None] * torch.stack((theta.cos(), theta.sin()), -1)
        c, s, zero = angle.cos(), angle.sin(), torch.zeros_like(angle)
        rows = (c, -s, zero, s, c, zero, zero, zero, zero + 1)
        turn_by = torch.stack(rows, -1).unflatten(-1, (3, 3))
        return self._replace(
            log=log,
            theta=theta,
            transport=self.transport + angle[sender] - angle[receiver],
            frame=product(self.frame, turn_by),
        )


def local_geometry(
    surface: EncodedSurface, k: int = 16, radius: float | None = None
) -> LocalGeometry:
    """Log-map coordinates, transport and weights between each point and its neighbours (ours).

    Differentiable through `log`. Points of a packed batch only meet points of their own cloud.

    Args:
        surface: an encoded surface; its own points are the base points.
        k: nearest neighbours of each point, itself not among them.
        radius: all neighbours within this geodesic distance (user's units) instead.

    Raises:
        ValueError: k is not in [1, points of the smallest cloud), or the radius is not positive.

    >>> from riemlayer import ExpLogField
    >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
    >>> geometry = local_geometry(ExpLogField.from_preset("tiny").encode(points), k=8)
    >>> geometry.edge_index.shape, geometry.log.shape
    (torch.Size([2, 2400]), torch.Size([2400, 2]))
    """
    if k < 1:
        raise ValueError(f"k must be at least 1, got {k}")
    if radius is not None and not radius > 0:
        raise ValueError(f"radius must be positive, got {radius}")
    points, shape = surface.points, surface.batch
    batch = shape - (surface.only or 0)
    near, piece = _nearest(surface, points, batch, shape, k, radius)  # (N, K), -1: there is none
    here = torch.arange(len(points), device=points.device)[:, None]
    filled = torch.where(near < 0, here, near)
    log, logit = surface.decode_log(points[:, None], points[filled], shape[:, None])
    normal = orient(surface.normal(points, shape=shape), points, filled, batch)
    frame = frame_of(normal)
    x = product(log, frame[..., :2])  # (N, K, 2)
    r = safe_norm(x).squeeze(-1)
    kept = near >= 0 if radius is None else (near >= 0) & (r <= radius)
    valid = (logit > 0) & (piece[:, None] == piece[filled])
    reach = torch.where(kept & valid, r, 0).amax(-1).detach()
    window = MARGIN * reach if radius is None else torch.full_like(reach, radius)
    weight = falloff(r / window[:, None].clamp_min(1e-12))
    weight = torch.where(kept & valid, weight, 0)
    weight = weight / weight.sum(-1, keepdim=True).clamp_min(1e-12)
    sender, receiver = near[kept], here.expand_as(near)[kept]
    carried = turn(frame[sender, :, 0], normal[sender], normal[receiver])
    transport = angle_of(product(carried[:, None], frame[receiver, :, :2]).squeeze(1))
    x = x[kept]
    return LocalGeometry(
        edge_index=torch.stack((sender, receiver)),
        log=x,
        r=r[kept],
        theta=angle_of(x),
        transport=transport,
        weight=weight[kept],
        valid=valid[kept],
        frame=frame,
        radius=reach,
        batch=batch,
    )


def _nearest(
    surface: EncodedSurface,
    points: Tensor,
    batch: Tensor,
    shape: Tensor,
    k: int,
    radius: float | None,
) -> tuple[Tensor, Tensor]:
    """Indices (N, K) of each point's neighbours, itself not among them; -1 where there is none.

    And the connected piece (N,) that each point belongs to.
    """
    count = batch.bincount()
    least = int(count[count > 0].min()) if len(batch) else 0
    others = k if radius is None else 1
    if least <= others:
        raise ValueError(
            f"k must be less than the points of a cloud, got {others} where one has {least}; "
            "ask for fewer, or sample more densely"
        )
    depth = surface.field.config.backbone.depth + 1
    x = ((points - surface.centre[shape]) / surface.scale[shape][:, None]).detach().clamp(-1, 1)
    octree = build_octree(x, batch, depth, coarsest=max(0, depth - 4))
    here = torch.arange(len(x), device=x.device)
    wanted = NEAR if radius is not None else max(k, NEAR)
    index = knn(octree, x, x, min(wanted + 1, least), batch)[0]
    other = (index != here[:, None]).byte()
    order = torch.sort(other, stable=True, dim=-1, descending=True)[1][:, :-1]
    near = index.gather(-1, order)
    piece = pieces(points.detach(), near)
    if radius is None:
        return near[:, :k], piece
    widest = radius / float(surface.scale.min())
    query, point, _ = radius_search(octree, x, x, widest, batch)
    chord = (points[query] - points[point]).detach().norm(dim=-1)
    kept = (query != point) & (chord <= radius)
    query, point = query[kept], point[kept]
    count = query.bincount(minlength=len(x))
    place = torch.arange(len(query), device=x.device) - (count.cumsum(0) - count)[query]
    index = query.new_full((len(x), max(1, int(count.max()))), -1)
    index[query, place] = point
    return index, piece


@torch.no_grad()
def orient(normal: Tensor, points: Tensor, neighbours: Tensor, batch: Tensor) -> Tensor:
    """Normals (N, 3) with signs that agree between neighbours as far as they can (ours).

    Signs spread from each cloud's highest point, where the normal points up, to the neighbours of
    those that have one; each takes the sign that most neighbours agree with. Neighbours across a
    thin sheet, whose chord runs along the normal, have no say. Which side is outside stays open.
    Normals of points that nobody has a say in point up.

    Args:
        normal, points: (N, 3).
        neighbours: (N, K) indices.
        batch: (N,) cloud of each point.
    """
    chord = normalise(points[neighbours] - points[:, None])
    there = normal[neighbours]
    flat = 1 - product(chord, normal[..., None]).squeeze(-1).abs()
    flat = flat * (1 - (chord * there).sum(-1).abs())
    vote = product(there, normal[..., None]).squeeze(-1) * flat  # (N, K)
    itself = neighbours == torch.arange(len(points), device=points.device)[:, None]
    vote = torch.where(itself, 0, vote)
    told = vote.new_zeros(len(vote)).index_add(0, neighbours.flatten(), vote.abs().flatten())
    sign = torch.where(told + vote.abs().sum(-1) == 0, _upward(normal), 0)
    heard = torch.zeros_like(sign)  # from those who count a point among their neighbours
    while bool((sign == 0).any()):
        unknown = sign == 0
        sign = _seeded(sign, normal, points, batch)
        new = (unknown & (sign != 0)).nonzero().squeeze(-1)
        while len(new):
            says = vote[new] * sign[new, None]
            heard.index_add_(0, neighbours[new].flatten(), says.flatten())
            unknown = (sign == 0).nonzero().squeeze(-1)
            votes = heard[unknown] + (vote[unknown] * sign[neighbours[unknown]]).sum(-1)
            new = unknown[votes != 0]
            sign[new] = votes[votes != 0].sign()
    return normal * sign[:, None]


def _seeded(sign: Tensor, normal: Tensor, points: Tensor, batch: Tensor) -> Tensor:
    """Signs with one more known in each cloud: at the highest point that had none, upwards."""
    height = torch.where(sign == 0, points[:, 2], -torch.inf)
    top = height.new_full((int(batch[-1]) + 1,), -torch.inf)
    top = top.scatter_reduce(0, batch, height, "amax")
    first = (sign == 0) & (height == top[batch])
    return torch.where(first, _upward(normal), sign)


def _upward(normal: Tensor) -> Tensor:
    """Signs (N,) that make normals point up."""
    return torch.where(normal[:, 2] < 0, -1.0, 1.0).to(normal.dtype)
