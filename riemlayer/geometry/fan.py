"""A fan of walked geodesics around a source, and the log map that is read from it (ours)."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from riemlayer.geometry.frames import frame_of
from riemlayer.geometry.planes import LocalPlanes
from riemlayer.geometry.shell import Shell
from riemlayer.geometry.walk import MET, Walked, advance
from riemlayer.numerics import normalise, outer6, product

LENGTHS = 16
"""Points kept along each geodesic of a fan."""
REACH = 1.04
"""Length of a fan's geodesics, in trained radii."""
WIDTH = 0.024
"""Distance in the cube over which a fan's points share in an answer: those of a geodesic are 0.033
apart, and two geodesics of a fan of 48 0.065 at the rim. Less is better where surfaces bend, more
under noise."""
ABOVE = 3.0
"""What the square of a height above a point's plane counts more than one along it: it is what tells
the two sides of a thin sheet apart."""
SHORTER = 0.15
"""What a squared length counts beside a squared distance: of two sheets that are as near, the one
that is reached sooner prevails."""
WALKED = 1 + MET
"""Channels that say how a point was reached."""


class Fan(NamedTuple):
    """F points on geodesics from each of S sources, and the affine log map around each point."""

    takes: Tensor
    """(S, F, 1) constant of the polynomial in a query's coordinates that tells a point's share."""
    key: Tensor
    """(S, F, 9) its factors of the coordinates (3), and of their products (6)."""
    values: Tensor
    """(S, F, 18 + MET): matrix A (2 x 3) and offset b (2) of log(x) = A x + b in `axes`, products
    of the normal (6), the point again (3), |v|, and what the walk there met, a step."""
    axes: Tensor
    """(S, 3, 2) of the tangent planes at the sources, as columns."""

    @property
    def walked(self) -> Tensor:
        """(S, F, WALKED) how each point was reached."""
        return self.values[..., -WALKED:]

    def counting(self, count: Tensor) -> Fan:
        """The same points, of which each counts exp(count) times as much (S, F, 1)."""
        return self._replace(takes=self.takes + WIDTH**2 * count)

    def joined(self, fans: int) -> Fan:
        """(S / fans, fans F, ...) of `fans` fans, one after the other, at each source; they share a
        tangent plane."""
        takes, key, values = (y.unflatten(0, (-1, fans)).flatten(1, 2) for y in self[:3])
        return Fan(takes, key, values, self.axes[::fans])


class FanLog(NamedTuple):
    """What a fan answers to K queries at each of S sources."""

    vector: Tensor
    """(S, K, 3) logs."""
    length: Tensor
    """(S, K, 1) mean length of the geodesics that had a share: above |vector| where they differ."""
    normal: Tensor
    """(S, K, 6) mean of their normals' products."""
    gap: Tensor
    """(S, K, 3) from the mean of their points to the query."""
    met: Tensor
    """(S, K, MET) mean of what their walks met."""


def fan_of(
    planes: LocalPlanes | Shell,
    p: Tensor,
    place: Tensor,
    rays: int,
    radius: float,
    steps: int = 16,
    tangent: Tensor | None = None,
) -> Fan:
    """Walk from each source along `rays` directions, and keep `LENGTHS` points of each geodesic.

    Around a point x_i = Exp_p(v_i) the log map is v_i plus the tangent part of x - x_i, carried
    back along the geodesic: A_i takes the direction and the normal there to those at p. Points and
    lengths are those of a walk at the height of p above its plane, as on a shell.

    Args:
        planes: of the cloud, or a shell around it.
        p: (S, 3) sources in the cube.
        place: (S,) int64, shape and scale of each source; on a shell 0 to S - 1.
        rays: number of geodesics.
        radius: trained radius; they are `REACH` times as long.
        steps: of their walks, at least; as many from each point that is kept to the next.
        tangent: (S, 3) unit normals, of any sign, of the tangent planes that they leave along and
            that logs lie in, as those of `walk` along tangent vectors; by default of the planes.
    """
    n, height = planes.plane(p, place)
    normal = n if tangent is None else tangent
    side = torch.where(_along(n, normal) < 0, -torch.ones_like(height), torch.ones_like(height))
    axes = frame_of(normal)[..., :2]
    angle = torch.arange(rays, dtype=p.dtype, device=p.device) * (2 * math.pi / rays)
    turn = torch.stack((angle.cos(), angle.sin()), -1)
    v = product(turn, axes.mT).flatten(0, 1)  # (S rays, 3)
    start, n, height, place = (y.repeat_interleave(rays, 0) for y in (p, n, height, place))
    n = normalise(n - _along(n, v) * v)
    at, site = Walked.starting(start, v, n), planes.site(place)
    each = math.ceil(steps / LENGTHS)
    stride = torch.full_like(height, REACH * radius / (LENGTHS * each))
    length, parts = torch.zeros_like(height), []
    for i in range(1, LENGTHS * each + 1):
        at, turned = advance(planes, at, site, stride)
        length = length + stride + height * turned
        if i % each == 0:
            lifted = at.point + height * at.normal - start
            parts.append(torch.cat((lifted, at.vector, at.normal, length, at.met / i), -1))
    parts = torch.stack(parts, 1).unflatten(0, (len(p), rays))  # (S, rays, LENGTHS, ...)
    x, carried, n, length, met = parts.split((3, 3, 3, 1, MET), -1)
    across = side[:, None, None] * torch.linalg.cross(n, carried)
    cosine, sine = turn[:, None].split(1, -1)
    first, second = cosine * carried - sine * across, sine * carried + cosine * across
    offset = length * turn[:, None] - torch.cat((_along(first, x), _along(second, x)), -1)
    through, up = outer6(n), _along(n, x)
    takes = -0.5 * (_along(x, x) + ABOVE * up.square() + SHORTER * length.square())
    key = torch.cat((x + ABOVE * up * n, -0.5 * ABOVE * through), -1)
    values = torch.cat((first, second, offset, through, x, length, met), -1)
    return Fan(takes.flatten(1, 2), key.flatten(1, 2), values.flatten(1, 2), axes)


def log_on_fan(fan: Fan, x: Tensor) -> FanLog:
    """Logs of chords (S, K, 3): the affine log maps around a fan's points, blended.

    Shares are softmax(-(|x - x_i|^2 + ABOVE (n_i . (x - x_i))^2 + SHORTER |v_i|^2) / (2 WIDTH^2)):
    attention of the queries to the fan's points, in full precision always.
    """
    products = outer6(x) * x.new_tensor([1.0, 1, 1, 2, 2, 2])
    query = torch.cat((torch.ones_like(x[..., :1]), x, products), -1) / WIDTH**2
    with torch.autocast(x.device.type, enabled=False):
        read = attention(query, torch.cat((fan.takes, fan.key), -1), fan.values)
    matrix, offset, normal, point, length, met = read.split((6, 2, 6, 3, 1, MET), -1)
    log = (matrix.unflatten(-1, (2, 3)) * x[..., None, :]).sum(-1) + offset
    return FanLog(product(log, fan.axes.mT), length, normal, x - point, met)


def attention(query: Tensor, key: Tensor, values: Tensor) -> Tensor:
    """softmax(query key^T) values: (S, K, a), (S, F, a), (S, F, c) -> (S, K, c), a <= c.

    Fused, without the (S, K, F) products in memory, but in forward mode, which has no fused form.
    """
    missing = values.shape[-1] - key.shape[-1]  # the fused form wants equal widths
    q, k, v = (y[:, None] for y in (F.pad(query, (0, missing)), F.pad(key, (0, missing)), values))
    try:
        return F.scaled_dot_product_attention(q, k, v, scale=1.0).squeeze(1)
    except NotImplementedError:
        return (query @ key.mT).softmax(-1) @ values


def _along(n: Tensor, x: Tensor) -> Tensor:
    """n . x (..., 1)."""
    return (n * x).sum(-1, keepdim=True)
