"""Surfaces whose Exp and Log are known exactly: plane, sphere, cylinder; the torus by its ODE.

All methods are differentiable torch functions of points `p`, `q` (..., 3) on the surface and of
vectors `v` (..., 3) tangent at `p`; they broadcast, and work in the dtype of their arguments. The
formulas are the textbook ones; nothing here is from the paper.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from riemlayer.numerics import safe_norm


class Surface(ABC):
    """A surface in space with its unit normal and its exponential map."""

    @abstractmethod
    def sample(
        self, n: int, generator: torch.Generator | None = None, dtype: torch.dtype = torch.float64
    ) -> Tensor:
        """n points uniform by area, (n, 3)."""

    @abstractmethod
    def normal(self, p: Tensor) -> Tensor:
        """Unit normal at p, (..., 3), outward where there is an outside."""

    @abstractmethod
    def exp(self, p: Tensor, v: Tensor) -> Tensor:
        """Exp_p(v), (..., 3)."""

    def project_to_tangent(self, p: Tensor, v: Tensor) -> Tensor:
        """The part of any vector v (..., 3) that is tangent at p."""
        normal = self.normal(p)
        return v - (v * normal).sum(-1, keepdim=True) * normal


@dataclass(frozen=True)
class Plane(Surface):
    """The plane z = 0; sampled in a square.

    Example:
        >>> plane = Plane()
        >>> plane.exp(torch.tensor([1.0, 0, 0]), torch.tensor([0.5, 2, 0]))
        tensor([1.5000, 2.0000, 0.0000])
    """

    half: float = 1.0
    """Half the side of the sampled square."""

    def sample(
        self, n: int, generator: torch.Generator | None = None, dtype: torch.dtype = torch.float64
    ) -> Tensor:
        xy = (2 * torch.rand(n, 2, generator=generator, dtype=dtype) - 1) * self.half
        return torch.cat([xy, torch.zeros(n, 1, dtype=dtype)], -1)

    def normal(self, p: Tensor) -> Tensor:
        return p.new_tensor([0.0, 0.0, 1.0]).expand(p.shape)

    def exp(self, p: Tensor, v: Tensor) -> Tensor:
        return p + v

    def log(self, p: Tensor, q: Tensor) -> Tensor:
        """Log_p(q) = q - p."""
        return q - p


@dataclass(frozen=True)
class Sphere(Surface):
    """The sphere of a radius about the origin; cut locus at distance pi * radius.

    Example:
        >>> north, east = torch.eye(3, dtype=torch.float64)[[2, 0]]
        >>> Sphere().exp(north, math.pi / 2 * east).round(decimals=12).abs()
        tensor([1., 0., 0.], dtype=torch.float64)
        >>> Sphere().log(north, east)
        tensor([1.5708, 0.0000, 0.0000], dtype=torch.float64)
    """

    radius: float = 1.0

    def sample(
        self, n: int, generator: torch.Generator | None = None, dtype: torch.dtype = torch.float64
    ) -> Tensor:
        direction = torch.randn(n, 3, generator=generator, dtype=dtype)
        return self.radius * direction / safe_norm(direction)

    def normal(self, p: Tensor) -> Tensor:
        return p / self.radius

    def exp(self, p: Tensor, v: Tensor) -> Tensor:
        """cos(|v| / R) p + sinc(|v| / R) v."""
        angle = safe_norm(v) / self.radius
        return angle.cos() * p + torch.sinc(angle / math.pi) * v

    def log(self, p: Tensor, q: Tensor) -> Tensor:
        """Log_p(q); at the antipode of p every direction is right and rounding chooses one."""
        n, m = self.normal(p), self.normal(q)
        cosine = (n * m).sum(-1, keepdim=True)
        ahead = m - cosine * n
        sine = safe_norm(ahead)
        return self.radius * torch.atan2(sine, cosine) / sine * ahead


@dataclass(frozen=True)
class Cylinder(Surface):
    """The infinite cylinder of a radius about the z axis; sampled where |z| <= half.

    Example:
        >>> cylinder = Cylinder()
        >>> p = torch.tensor([1.0, 0, 0], dtype=torch.float64)
        >>> q = cylinder.exp(p, torch.tensor([0, math.pi / 2, 3], dtype=torch.float64))
        >>> q.round(decimals=12).abs()
        tensor([0., 1., 3.], dtype=torch.float64)
    """

    radius: float = 1.0
    half: float = 1.0

    def sample(
        self, n: int, generator: torch.Generator | None = None, dtype: torch.dtype = torch.float64
    ) -> Tensor:
        angle, height = torch.rand(2, n, generator=generator, dtype=dtype)
        angle, height = 2 * math.pi * angle, self.half * (2 * height - 1)
        return torch.stack([self.radius * angle.cos(), self.radius * angle.sin(), height], -1)

    def normal(self, p: Tensor) -> Tensor:
        return torch.stack([p[..., 0], p[..., 1], torch.zeros_like(p[..., 2])], -1) / self.radius

    def exp(self, p: Tensor, v: Tensor) -> Tensor:
        """Turns p about the axis by the angle v_around / R and shifts it by v_z."""
        p, v = torch.broadcast_tensors(p, v)
        x, y, z = p.unbind(-1)
        angle = (x * v[..., 1] - y * v[..., 0]) / self.radius**2
        c, s = angle.cos(), angle.sin()
        return torch.stack([c * x - s * y, s * x + c * y, z + v[..., 2]], -1)

    def log(self, p: Tensor, q: Tensor) -> Tensor:
        """Log_p(q), the shorter way round."""
        p, q = torch.broadcast_tensors(p, q)
        x, y, z = p.unbind(-1)
        angle = torch.atan2(x * q[..., 1] - y * q[..., 0], x * q[..., 0] + y * q[..., 1])
        return torch.stack([-angle * y, angle * x, q[..., 2] - z], -1)


@dataclass(frozen=True)
class Torus(Surface):
    """The torus about the z axis; Exp by Runge-Kutta steps of the geodesic equation, no Log.

    In the angles t (about the axis) and f (about the tube), with w = R + r cos f:
    t'' = 2 (r / w) sin f t' f' and f'' = -(w / r) sin f t'^2.

    Example:
        >>> p, around = torch.tensor([[1.0, 0, 0], [0, 2 * math.pi, 0]], dtype=torch.float64)
        >>> Torus().exp(p, around).round(decimals=8).abs()  # once around the outer equator
        tensor([1., 0., 0.], dtype=torch.float64)
    """

    major: float = 0.7
    """R, from the axis to the middle of the tube."""
    minor: float = 0.3
    """r, of the tube."""
    steps: int = 64
    """Runge-Kutta steps of fourth order a geodesic."""

    def sample(
        self, n: int, generator: torch.Generator | None = None, dtype: torch.dtype = torch.float64
    ) -> Tensor:
        kept = torch.empty(0, 2, dtype=dtype)
        while len(kept) < n:  # area is proportional to w: accept with probability w / (R + r)
            angles = torch.rand(2 * n + 8, 3, generator=generator, dtype=dtype)
            turns = 2 * math.pi * angles[:, :2]
            width = self.major + self.minor * turns[:, 1].cos()
            kept = torch.cat([kept, turns[angles[:, 2] * (self.major + self.minor) < width]])
        return self._place(*kept[:n].unbind(-1))

    def normal(self, p: Tensor) -> Tensor:
        return (p - self._middle(p)) / self.minor

    def exp(self, p: Tensor, v: Tensor) -> Tensor:
        p, v = torch.broadcast_tensors(p, v)
        width = safe_norm(p[..., :2]).squeeze(-1)
        t, f = torch.atan2(p[..., 1], p[..., 0]), torch.atan2(p[..., 2], width - self.major)
        around = (p[..., 0] * v[..., 1] - p[..., 1] * v[..., 0]) / width
        outward = (p[..., 0] * v[..., 0] + p[..., 1] * v[..., 1]) / width
        rolling = f.cos() * v[..., 2] - f.sin() * outward
        state = torch.stack([t, f, around / width, rolling / self.minor], -1)
        h = 1 / self.steps
        for _ in range(self.steps):
            a = self._flow(state)
            b = self._flow(state + h / 2 * a)
            c = self._flow(state + h / 2 * b)
            d = self._flow(state + h * c)
            state = state + h / 6 * (a + 2 * b + 2 * c + d)
        return self._place(state[..., 0], state[..., 1])

    def _flow(self, state: Tensor) -> Tensor:
        _, f, t_rate, f_rate = state.unbind(-1)
        width, sine = self.major + self.minor * f.cos(), f.sin()
        t_force = 2 * (self.minor / width) * sine * t_rate * f_rate
        f_force = -(width / self.minor) * sine * t_rate.square()
        return torch.stack([t_rate, f_rate, t_force, f_force], -1)

    def _middle(self, p: Tensor) -> Tensor:
        flat = torch.cat([p[..., :2], torch.zeros_like(p[..., 2:])], -1)
        return self.major * flat / safe_norm(flat)

    def _place(self, t: Tensor, f: Tensor) -> Tensor:
        width = self.major + self.minor * f.cos()
        return torch.stack([width * t.cos(), width * t.sin(), self.minor * f.sin()], -1)
