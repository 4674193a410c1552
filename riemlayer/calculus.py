"""What follows from Exp and Log: distances, frames, geodesics, transport, refinement.

`Calculus` is mixed into `EncodedSurface`; it asks a surface for its maps and its normals alone, so
the laws it obeys are tested on closed-form surfaces whose maps are exact.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import torch
from torch import Tensor
from torch.func import jvp

from riemlayer import checks
from riemlayer.abstract import AbstractSurface
from riemlayer.geometry import frame_of, nearest_isometry
from riemlayer.numerics import normalise, product, safe_norm
from riemlayer.queries import value_and_jacobian

STRIDE = 0.5
"""Longest step of `shoot`, in trained radii: short steps are the accurate ones."""
RUNG = 0.25
"""Length of the vectors that a pole ladder carries, in trained radii."""
MISS = 0.4
"""Where Exp_p(Log_p(q)) ends farther from q than this, in chords |q - p|, Log is not believed."""


class Shot(NamedTuple):
    """A long geodesic."""

    point: Tensor
    """(..., 3) where it ends."""
    vector: Tensor
    """(..., 3) v carried along: |v| times the direction at the end."""
    path: Tensor
    """(steps + 1, ..., 3) from p to the end."""


class Calculus(AbstractSurface):
    """Tangent-space operators of a surface that has Exp and Log; names and order of geoopt.

    Points and vectors are (..., 3) in the user's units and broadcast; `shape` is needed for packed
    batches only. Tangent vectors are ambient; `to_2d` and `from_2d` change to coordinates.

    Every operator raises TypeError or ValueError, naming the argument, for points or vectors that
    are no (..., 3) tensors, not finite, of another dtype than the surface, or do not broadcast.
    From points off the surface, and between pieces that nothing connects, answers are finite and
    `valid_mask` is False.
    """

    def dist(self, p: Tensor, q: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Geodesic distance d(p, q) (...): |Log_p(q)|, but never below the chord |q - p| (ours).

        The gradient is finite at p = q. Symmetric as far as Log is: average with `dist(q, p)` where
        that matters.
        """
        self.check(p=p, q=q)
        along = safe_norm(self.decode_log(p, q, shape)[0])
        return torch.maximum(along, safe_norm(q - p)).squeeze(-1)

    def cdist(self, p: Tensor, q: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Distances (P, Q) from every p (P, 3) to every q (Q, 3), one source for each p (ours)."""
        self.check(p=p)
        self.check(q=q)
        checks.check_shapes(p=(p, "P 3"), q=(q, "Q 3"))
        return self.dist(p[:, None], q[None], shape=None if shape is None else shape[:, None])

    def inner(self, p: Tensor, u: Tensor, v: Tensor | None = None) -> Tensor:
        """Riemannian inner product <u, v>_p (...): that of the ambient vectors; |u|^2 without v."""
        v = u if v is None else v
        self.check(p=p, u=u, v=v)
        return (u * v).sum(-1)

    def norm(self, p: Tensor, u: Tensor) -> Tensor:
        """Length |u|_p (...) of tangent vectors, with a finite gradient at 0."""
        self.check(p=p, u=u)
        return safe_norm(u).squeeze(-1)

    def frame(self, p: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Right-handed orthonormal frames (..., 3, 3), columns e1, e2 and the normal (appendix A).

        A function of the normal alone: see `frame_of`.
        """
        return frame_of(self.normal(p, shape=shape))

    def project(self, p: Tensor, v: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Part (..., 3) of ambient vectors in the tangent plane at p."""
        self.check(p=p, v=v)
        normal = self.normal(p, shape=shape)
        return v - (v * normal).sum(-1, keepdim=True) * normal

    def to_2d(self, p: Tensor, v: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Coordinates (..., 2) of tangent vectors in the frame at p (appendix A)."""
        self.check(p=p, v=v)
        return product(v[..., None, :], self.frame(p, shape=shape)[..., :2]).squeeze(-2)

    def from_2d(self, p: Tensor, x: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Ambient tangent vectors (..., 3) of coordinates x (..., 2) in the frame at p."""
        self.check(p=p)
        checks.check_vectors("x", x, like=p, width=2)
        checks.check_broadcast(p=p[..., 0], x=x[..., 0])
        return product(self.frame(p, shape=shape)[..., :2], x[..., None]).squeeze(-1)

    def geodesic(self, p: Tensor, q: Tensor, t: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Point at t (...) in [0, 1] of the geodesic from p to q: Exp_p(t Log_p(q)) (ours).

        What Exp misses q by is given back in proportion to t, so both ends are exact.
        """
        self.check(p=p, q=q)
        checks.check_tensor("t", t)
        checks.check_vectors("t", t[..., None], like=p, width=1)
        checks.check_broadcast(p=p, q=q, t=t[..., None])
        v = self.decode_log(p, q, shape)[0]
        ahead, whole = (
            self.decode_exp(p, t[..., None] * v, shape)[0],
            self.decode_exp(p, v, shape)[0],
        )
        return ahead + t[..., None] * (q - whole)

    def advance(
        self, p: Tensor, v: Tensor, *, shape: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Exp_p(v) and v carried there: |v| times the direction of d/dt Exp_p(t v) at 1 (ours)."""
        self.check(p=p, v=v)

        def end(x: Tensor) -> Tensor:
            return self.decode_exp(p, x, shape)[0]

        v = v.contiguous()
        q, velocity = jvp(end, (v,), (v,))[:2]
        q = self.snap(q, shape=shape)
        normal = self.normal(q, shape=shape)
        velocity = velocity - (velocity * normal).sum(-1, keepdim=True) * normal
        return q, normalise(velocity) * safe_norm(v)

    def shoot(
        self, p: Tensor, v: Tensor, steps: int | None = None, *, shape: Tensor | None = None
    ) -> Shot:
        """Long geodesic from p along v, beyond the trained radius, in short learned steps (ours).

        Args:
            p, v: (..., 3) of one shape.
            steps: how many; by default as many as keep each within half a trained radius.
            shape: (...) as everywhere.

        Raises:
            ValueError: steps is not positive.
        """
        self.check(p=p, v=v)
        p, v = torch.broadcast_tensors(p, v)
        if steps is None:
            reach = STRIDE * self.radius_at(p, shape)
            longest = float((v.detach().norm(dim=-1) / reach).max()) if v.numel() else 0.0
            steps = max(1, math.ceil(longest))
        if steps < 1:
            raise ValueError(f"steps must be at least 1, got {steps}")
        step, path = v / steps, [p]
        for _ in range(steps):
            q, step = self.advance(path[-1], step, shape=shape)
            path.append(q)
        return Shot(path[-1], step * steps, torch.stack(path))

    def transport(
        self,
        p: Tensor,
        q: Tensor,
        v: Tensor,
        *,
        method: Literal["differential", "ladder"] = "differential",
        shape: Tensor | None = None,
    ) -> Tensor:
        """Parallel transport of tangent vectors v (..., 3) at p along the geodesic to q (ours).

        "differential": the rotation nearest to d(Exp_p) at Log_p(q), exact where curvature is
        constant. "ladder": the pole ladder, by three geodesics and their middle. The tangent part
        keeps its length; transport from p to p is the identity.

        Raises:
            ValueError: the method is another.
        """
        self.check(p=p, q=q, v=v)
        if method == "differential":
            return self._carry(p, q, v, shape)
        if method == "ladder":
            return self._ladder(p, q, v, shape)
        raise ValueError(f"method must be 'differential' or 'ladder', got {method!r}")

    def log_refined(
        self, p: Tensor, q: Tensor, steps: int = 2, *, shape: Tensor | None = None
    ) -> Tensor:
        """Log_p(q) (..., 3) after Gauss-Newton steps on |Exp_p(v) - q| from Log's answer (ours).

        Consistent with Exp rather than with the truth. A step that does not bring Exp_p(v) nearer
        to q is not taken.
        """
        self.check(p=p, q=q)
        v = self.decode_log(p, q, shape)[0]
        axes = self.frame(p, shape=shape)[..., :2]
        miss = safe_norm(q - self.decode_exp(p, v, shape)[0])
        eye = torch.eye(2, dtype=v.dtype, device=v.device)
        for _ in range(steps):
            end, J = value_and_jacobian(lambda x: self.decode_exp(p, x, shape)[0], v)
            A = product(J, axes)
            normal = product(A.mT, A)
            damping = 1e-4 + 1e-6 * normal.diagonal(dim1=-2, dim2=-1).sum(-1)  # never singular
            normal = normal + damping[..., None, None] * eye
            x = torch.linalg.solve(normal, product(A.mT, (q - end)[..., None]))
            ahead = v + product(axes, x).squeeze(-1)
            left = safe_norm(q - self.decode_exp(p, ahead, shape)[0])
            v, miss = torch.where(left < miss, ahead, v), torch.minimum(left, miss)
        return v

    def valid_mask(
        self, p: Tensor, q: Tensor, threshold: float = 0.5, *, shape: Tensor | None = None
    ) -> Tensor:
        """(...) bool: Log_p(q) is to be believed (ours), at the cost of one Exp.

        p lies on the surface, q before the cut locus of p with more than that probability, and
        `comes_back` holds.
        """
        self.check(p=p, q=q)
        v, logit = self.decode_log(p, q, shape)
        back = self.comes_back(p, q, v, shape=shape)
        return (logit.sigmoid() > threshold) & back & self.in_support(p, shape=shape)

    def comes_back(self, p: Tensor, q: Tensor, v: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """(...) bool: Exp_p(v) ends nearer to q than `MISS` chords (ours); not across a gap."""
        miss = (self.decode_exp(p, v, shape)[0] - q).norm(dim=-1)
        return miss <= MISS * (q - p).norm(dim=-1) + 1e-3 * self.radius_at(p, shape)

    def injectivity_radius(
        self,
        p: Tensor,
        directions: int = 16,
        steps: int = 16,
        *,
        shape: Tensor | None = None,
    ) -> Tensor:
        """Distance (...) from p at which its cut locus begins, at most the trained radius (ours).

        The shortest vector of a fan whose validity is below one half; 0 off the surface.

        Raises:
            ValueError: directions or steps is not positive.
        """
        self.check(p=p)
        if directions < 1 or steps < 1:
            raise ValueError(f"directions and steps must be at least 1, got {directions}, {steps}")
        longest = self.radius_at(p, shape)[..., None]  # (..., 1)
        angle = torch.arange(directions, device=p.device) * (2 * math.pi / directions)
        length = torch.arange(1, steps + 1, device=p.device) / steps
        fan = torch.stack((angle.cos(), angle.sin()), -1)[:, None] * length[:, None]
        fan = fan.flatten(0, 1).to(p.dtype)  # (F, 2)
        axes = self.frame(p, shape=shape)[..., :2]
        v = longest[..., None] * product(fan, axes.mT)
        wide = None if shape is None else shape[..., None]
        logit = self.decode_exp(p[..., None, :], v, wide)[1]
        reach = fan.norm(dim=-1) * longest
        reach = torch.where(logit < 0, reach, longest).amin(-1)
        return torch.where(self.in_support(p, shape=shape), reach, 0)

    def _carry(self, p: Tensor, q: Tensor, v: Tensor, shape: Tensor | None) -> Tensor:
        w = self.decode_log(p, q, shape)[0]
        _, J = value_and_jacobian(lambda x: self.decode_exp(p, x, shape)[0], w)
        here, there = (self.frame(x, shape=shape)[..., :2] for x in (p, q))
        carried = nearest_isometry(product(there.mT, J, here))
        return product(there, carried, here.mT, v[..., None]).squeeze(-1)

    def _ladder(self, p: Tensor, q: Tensor, v: Tensor, shape: Tensor | None) -> Tensor:
        v = self.project(p, v, shape=shape)
        length = safe_norm(v)
        rung = RUNG * self.radius_at(p, shape)[..., None] / length
        middle = self.geodesic(p, q, torch.full_like(p[..., 0], 0.5), shape=shape)
        top = self.decode_exp(p, rung * v, shape)[0]
        mirrored = self.decode_exp(middle, -self.decode_log(middle, top, shape)[0], shape)[0]
        w = self.project(q, -self.decode_log(q, mirrored, shape)[0], shape=shape)
        return normalise(w) * length
