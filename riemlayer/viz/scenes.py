"""The pictures that papers on geodesics show, each from a surface in one call."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from riemlayer.surface import EncodedSurface
from riemlayer.viz.canvas import Canvas
from riemlayer.viz.drawing import Drawing
from riemlayer.viz.view import outward, tangent_coordinates, tangent_frame, to_numpy

Array = np.ndarray

TILES = 5
"""Tiles of a map, and rings of a fan, from the source to the radius."""
RAYS = 24
STEPS = 25
"""Points of a geodesic."""


def draw_log(
    surface: EncodedSurface,
    p: Any,
    canvas: Canvas | None = None,
    *,
    texture: Literal["checker", "polar"] = "checker",
    radius: float | None = None,
    title: str = "Log",
) -> Drawing:
    """The log map of p as a checkerboard or a polar grid, as far as it is valid (Sec. 3).

    Args:
        surface: of one shape.
        p: (3,) source on it.
        canvas: what is painted; the surface's own points by default.
        texture: square tiles, or rings of equal distance and sectors.
        radius: tiles end there; the trained radius by default.
        title: above the picture.

    Example:
        >>> from riemlayer import ExpLogField
        >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
        >>> surface = ExpLogField.from_preset("tiny").encode(points)
        >>> draw_log(surface, points[0], texture="polar").log.shape
        (300, 2)
    """
    canvas = canvas or Canvas(surface.points)
    p, reach = _source(surface, p), _radius(surface, radius)
    log, valid = log_map(surface, p, canvas, reach)
    flat = tangent_coordinates(log, normal_at(surface, p, canvas))
    return Drawing(
        canvas, log=flat, valid=valid, p=p, texture=texture, radius=reach, period=reach / TILES,
        title=title,
    )  # fmt: skip


def draw_exp(
    surface: EncodedSurface,
    p: Any,
    canvas: Canvas | None = None,
    *,
    rays: int = RAYS,
    radius: float | None = None,
    title: str = "Exp",
) -> Drawing:
    """Exp of p as a fan of geodesics, with the circle that ends them (Sec. 3).

    Args:
        surface, p, canvas, radius, title: as for `draw_log`.
        rays: geodesics, evenly around p.

    Example:
        >>> from riemlayer import ExpLogField
        >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
        >>> surface = ExpLogField.from_preset("tiny").encode(points)
        >>> len(draw_exp(surface, points[0], rays=8).paths)
        8
    """
    canvas = canvas or Canvas(surface.points)
    p, reach = _source(surface, p), _radius(surface, radius)
    paths = [*exp_fan(surface, p, normal_at(surface, p, canvas), reach, rays)]
    return Drawing(canvas, p=p, paths=paths, title=title, radius=reach, period=reach / TILES)


def exp_fan(surface: EncodedSurface, p: Tensor, normal: Array, radius: float, rays: int) -> Array:
    """Geodesics (rays, 25, 3) of length `radius` from p, evenly around the normal."""
    angle = np.linspace(0, 2 * np.pi, rays, endpoint=False)
    ends = radius * np.stack([np.cos(angle), np.sin(angle)], 1) @ tangent_frame(normal)
    v = torch.as_tensor(np.linspace(0, 1, STEPS)[:, None] * ends[:, None]).to(p)
    with torch.inference_mode():
        return to_numpy(surface.exp(p, v), float)


def log_map(
    surface: EncodedSurface, p: Tensor, canvas: Canvas, radius: float
) -> tuple[Array, Array]:
    """Log_p of the canvas (N, 3) and its validity (N,), 0 where the chord is beyond the radius."""
    q = torch.as_tensor(canvas.points).to(p)
    with torch.inference_mode():
        log, logit = surface.decode_log(p, q)
        near = (q - p).norm(dim=-1) <= 1.05 * radius  # and the geodesic is longer still
    return to_numpy(log, float), to_numpy(logit.sigmoid() * near, float)


def normal_at(surface: EncodedSurface, p: Tensor, canvas: Canvas) -> Array:
    """Unit normal (3,) at p, outward as far as one can tell."""
    with torch.inference_mode():
        return outward(canvas.points, p, surface.normal(p))


def _source(surface: EncodedSurface, p: Any) -> Tensor:
    p = torch.as_tensor(p).detach().to(surface.centre)
    if p.shape != (3,):
        raise ValueError(f"`p` must be one point (3,), got {tuple(p.shape)}")
    return p


def _radius(surface: EncodedSurface, radius: float | None) -> float:
    if len(surface) != 1:
        raise ValueError(f"`surface` must be one shape, got {len(surface)}; take surface[i]")
    if radius is not None and not radius > 0:
        raise ValueError(f"`radius` must be positive, got {radius}")
    return float(surface.radius) if radius is None else radius
