"""Geodesic walking over the local planes of a cloud (appendix D), vectorised and differentiable."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from riemlayer.geometry.planes import LocalPlanes
from riemlayer.geometry.shell import Shell
from riemlayer.geometry.site import Place
from riemlayer.numerics import in_columns, normalise

ANCHOR = 0.3
"""Length, in cells, within which a walk leaves p along v itself, to first order."""
RIM = 0.5
"""Distance, in cells, beside the mean of the centroids around it from which on a walk has left a
sheet."""
AHEAD = (1.0, 2.0)
"""Distances, in cells, at which it looks whether the sheet goes on."""
MET = 4
"""Channels of what a walk met."""
NEGLIGIBLE = 0.05
"""Length, in cells, below which a vector has less and less of a direction."""


class Walked(NamedTuple):
    """Where a walk is, or where it ended."""

    point: Tensor
    """(Q, 3) point on the planes."""
    vector: Tensor
    """(Q, 3) v carried along by parallel transport: |v| times the direction there."""
    normal: Tensor
    """(Q, 3) unit normal there; its sign is arbitrary at the start and kept along the walk."""
    met: Tensor
    """(Q, MET) what it met on its way, which says how far it can be trusted; sums over its steps:
    distances from the planes ahead in cells, turning of the normal, support, and turning back."""

    @classmethod
    def starting(cls, p: Tensor, v: Tensor, normal: Tensor) -> Walked:
        """Before the first step."""
        p, v, normal = (in_columns(y) for y in (p, v, normal))
        return cls(p, v, normal, p.new_zeros(len(p), MET))


def walk(
    planes: LocalPlanes | Shell,
    p: Tensor,
    v: Tensor,
    place: Tensor,
    steps: int = 8,
    plane: tuple[Tensor, Tensor] | None = None,
) -> Walked:
    """Walk from `p` along `v` over the local planes in `steps` steps (appendix D).

    Each step goes ahead, drops onto the plane found there, and turns the direction by the smallest
    rotation that takes the last normal to the new one: parallel transport, where the paper projects
    and renormalises. Ahead is the chord of a geodesic that bends as in the last step, where the
    paper goes straight on; so does the walk where no plane is near.

    The length is that of a walk at the height of `p` above its plane, as on a shell around the
    cloud: what turns at that height take of it is not walked (ours).

    Exact at the origin: walk(p, 0) = p with the identity as its differential, because the departure
    from p + v is faded in with |v|^2 over `ANCHOR` cells.

    Args:
        planes: of the cloud, or a shell around it.
        p: (Q, 3) starts, in the cube.
        v: (Q, 3) tangent vectors.
        place: (Q,) int64, shape and scale of each start; its source on a shell.
        steps: number of steps; 8 for the trained radius, |v| over half the spacing for a fine walk.
        plane: what `planes.plane` answers at `p`, where it is known already.
    """
    site = planes.site(place)
    normal, height = plane or planes.plane(p, site)
    square = v.square().sum(-1, keepdim=True)
    cell = planes.cell(site)
    negligible = (NEGLIGIBLE * cell) ** 2
    tilt = (normal * v).sum(-1, keepdim=True) / square.clamp_min(negligible)
    normal = normalise(normal - tilt * v)
    at = Walked.starting(p, v, normal)
    rest, before = torch.ones_like(square), at.vector
    for left in range(steps, 0, -1):
        share = rest.clamp_min(0) / left
        chord, before = chord_ahead(before, at, square.clamp_min(negligible)), at.vector
        at, turned = advance(planes, at, site, share, chord)
        rest = rest - share - height * turned / square.clamp_min(negligible)
    x = torch.addcmul(at.point, rest, at.vector)
    return at._replace(point=p + v + fade_in(square, cell) * (x - p - v))


def chord_ahead(before: Tensor, at: Walked, square: Tensor) -> Tensor:
    """Vectors (Q, 3) along the chords of geodesics that bend on as in the last step (ours).

    They lean from the carried vectors by half the angle that these turned by: two-step
    Adams-Bashforth, at no further look at the planes.

    Args:
        before: (Q, 3) the carried vectors before that step.
        square: (Q, 1) their squared lengths, above 0.
    """
    bend = (at.normal * before).sum(-1, keepdim=True)
    chord = torch.addcmul(at.vector, bend, at.normal, value=-0.5)
    return chord / (1 + 0.25 * bend.square() / square).sqrt()


def advance(
    planes: LocalPlanes | Shell,
    at: Walked,
    site: Place,
    share: Tensor,
    chord: Tensor | None = None,
    halves: int = 2,
) -> tuple[Walked, Tensor]:
    """One step of a walk, by a share (Q, 1) of `chord` (Q, 3), or else of the carried vector.

    A step that ends in the air, beyond all planes, is taken in `halves` instead, which land nearer
    to the rim or the edge that it left.

    Also how the normal turned towards that vector (Q, 1): times |v| in radians, and above 0 where
    the surface bends away from the normal.
    """
    x = torch.addcmul(at.point, share, at.vector if chord is None else chord)
    ahead, gap, support, beside = planes.look(x, site, at.normal)
    turned = ((ahead - at.normal) * at.vector).sum(-1, keepdim=True)
    x = torch.addcmul(x, gap, ahead, value=-1)
    off, cosine = gap.abs() / planes.cell(site), (at.normal * ahead).sum(-1, keepdim=True)
    met = torch.cat((off, 1 - cosine, support, torch.zeros_like(gap)), -1)
    there = Walked(x, turn(at.vector, at.normal, ahead), ahead, at.met + met)
    if isinstance(planes, Shell):
        return there, turned
    there = turn_back(planes, there, site, share, beside)
    lost = (beside.detach() == 0).all(-1) & planes.has_rims(site)
    rows = lost.nonzero().squeeze(-1)
    if halves == 1 or not len(rows):
        return there, turned
    again, total = Walked(*(y[rows] for y in at)), torch.zeros_like(turned[rows])
    for _ in range(halves):
        again, bent = advance(planes, again, site[rows], share[rows] / halves, halves=1)
        total = total + bent
    parts = (y.index_copy(0, rows, z) for y, z in zip(there, again, strict=True))
    return Walked(*parts), turned.index_copy(0, rows, total)


def turn_back(
    planes: LocalPlanes, at: Walked, site: Place, share: Tensor, beside: Tensor
) -> Walked:
    """Reflects walks at the rims of sheets: they go on at the other side (ours).

    Points do not tell the two sides of a thin sheet apart, and at its rim its planes end. A
    geodesic goes round the rim, and back below: that is, flattened out, a reflection at the rim,
    with the normal turned over. A walk is at a rim if it has come from the sheet, if the sheet may
    end there, and there is no plane further ahead either.

    Args:
        planes, site: as for `walk`.
        at: walks after a step by `share` of their vectors.
        beside: (Q, 3) see `Sight`.
    """
    leaves = (beside * at.vector).sum(-1) > 0
    leaves &= beside.square().sum(-1) > (RIM * planes.cell(site)).square().squeeze(-1)
    rows = (leaves & planes.has_rims(site)).nonzero().squeeze(-1)
    if len(rows):
        rows = rows[planes.may_end(at.point[rows], site[rows])]
    if not len(rows):
        return at
    x, vector, normal, beside, share = (y[rows] for y in (*at[:3], beside, share))
    site = site[rows]
    beside, ends = _rim(planes, x, site, normal, beside)
    cell, outward = planes.cell(site), normalise(beside)
    speed = ends * (vector * outward).sum(-1, keepdim=True).clamp_min(0)
    over = ((beside * outward).sum(-1, keepdim=True) - RIM * cell).clamp_min(0)
    over = torch.minimum(ends * over, speed * share)
    return Walked(
        at.point.index_add(0, rows, -2 * over * outward),
        at.vector.index_add(0, rows, -2 * speed * outward),
        at.normal.index_copy(0, rows, normal * (1 - 2 * ends)),
        at.met.index_add(0, rows, F.pad(ends, (MET - 1, 0))),
    )


def _rim(
    planes: LocalPlanes, x: Tensor, site: Place, normal: Tensor, beside: Tensor
) -> tuple[Tensor, Tensor]:
    """How far beside a sheet places `x` (R, 3) lie, and 1 (R, 1) where it ends there, else 0.

    The first is a mean of what is seen there and to both sides along the rim: a few centroids alone
    say little about the rim's direction.
    """
    cell, outward = planes.cell(site), normalise(beside)
    along = torch.linalg.cross(normal, outward)
    places = [x + cell * way for way in (along, -along, *(k * outward for k in AHEAD))]
    repeats = len(places)
    seen = planes.look(torch.cat(places), site.repeat(repeats), normal.repeat(repeats, 1)).beside
    left, right, *ahead = seen.chunk(repeats)
    goes_on = [
        (y != 0).any(-1, keepdim=True) & ((y * outward).sum(-1, keepdim=True) < k * cell)
        for k, y in zip(AHEAD, ahead, strict=True)
    ]
    ends = ~torch.stack(goes_on).any(0)
    known = 1 + (left != 0).any(-1, keepdim=True).to(x.dtype) + (right != 0).any(-1, keepdim=True)
    return (beside + left + right) / known, ends.to(x.dtype)


def fade_in(square: Tensor, cell: float | Tensor) -> Tensor:
    """0 at the source with zero slope, 1 beyond `ANCHOR` cells, from squared lengths."""
    return square / (square + (ANCHOR * cell) ** 2)


def turn(w: Tensor, n: Tensor, m: Tensor) -> Tensor:
    """Rotate vectors `w`, orthogonal to `n`, by the smallest rotation that takes `n` to `m`.

    Length is kept. Between opposite normals, where the rotation is undefined, the denominator is
    held above 0.2.
    """
    cosine = (n * m).sum(-1, keepdim=True)
    length = (w * m).sum(-1, keepdim=True) / (1 + cosine).clamp_min(0.2)
    return torch.addcmul(w, length, n + m, value=-1)
