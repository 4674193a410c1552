"""The pictures that papers on geodesics show, each from a surface in one call."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from riemlayer.ops import Stitched
from riemlayer.surface import EncodedSurface
from riemlayer.viz.canvas import Canvas
from riemlayer.viz.drawing import Drawing
from riemlayer.viz.palette import apart, label_colours
from riemlayer.viz.view import outward, tangent_coordinates, tangent_frame, to_numpy, unit

Array = np.ndarray

TILES = 5
"""Tiles of a map, and rings of a fan, from the source to the radius."""
RAYS = 24
STEPS = 25
"""Points of a geodesic."""
FAR = 10.0
"""Where points beyond the radius are put, in radii."""
ASTRAY = 0.2
"""Cycle error |Exp_p(Log_p q) - q|, in radii, from which on a log map is not drawn."""


def draw_log(
    surface: EncodedSurface,
    p: Any,
    canvas: Canvas | None = None,
    *,
    texture: Literal["checker", "polar"] = "checker",
    radius: float | None = None,
    title: str = "Log",
) -> Drawing:
    """The log map of p as a checkerboard or a polar grid, as far as it can be trusted (Sec. 3).

    Tiles stand where Log calls itself valid and Exp leads back to within a fifth of the radius.

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
    flat, trust = log_map(surface, p, normal_at(surface, p, canvas), canvas, reach)
    return Drawing(
        canvas, log=flat, valid=trust, p=p, texture=texture, radius=reach, period=reach / TILES,
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
    """Exp of p as a fan of geodesics (Sec. 3).

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


def draw_geodesics(
    surface: EncodedSurface,
    p: Any,
    q: Any,
    canvas: Canvas | None = None,
    *,
    title: str = "Geodesics",
) -> Drawing:
    """Geodesics from p to points within the trained radius, Exp_p(t Log_p(q)).

    Args:
        surface, p, canvas, title: as for `draw_log`.
        q: (K, 3) where they end.

    Example:
        >>> from riemlayer import ExpLogField
        >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
        >>> surface = ExpLogField.from_preset("tiny").encode(points)
        >>> path = draw_geodesics(surface, points[0], points[1:4]).paths[2]
        >>> bool(np.allclose(path[-1], points[3], atol=1e-5))
        True
    """
    canvas = canvas or Canvas(surface.points)
    p, reach = _source(surface, p), _radius(surface, None)
    ends = torch.as_tensor(q).to(p)
    if ends.ndim != 2 or ends.shape[1] != 3:
        raise ValueError(f"`q` must have shape (K, 3), got {tuple(ends.shape)}")
    t = torch.linspace(0, 1, STEPS).to(p)
    with torch.inference_mode():
        paths = to_numpy(surface.geodesic(p, ends[:, None], t.expand(len(ends), STEPS)), float)
    return Drawing(canvas, p=p, paths=[*paths], title=title, radius=reach, period=reach / TILES)


def draw_stitched(
    stitched: Stitched,
    canvas: Canvas,
    p: Any,
    radius: float,
    *,
    title: str = "",
) -> Drawing:
    """An atlas as one checkerboard, each point in the colour of the chart whose centre is nearest.

    Args:
        stitched: of `stitch_log(surface, p, points)` with the canvas's points.
        canvas: what is painted.
        p: (3,) the source.
        radius: of a chart.
        title: above the picture; the number of charts by default.

    Example:
        >>> from riemlayer import ExpLogField
        >>> from riemlayer.ops import stitch_log
        >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
        >>> surface = ExpLogField.from_preset("tiny").encode(points)
        >>> stitched = stitch_log(surface, points[0], points, depth=1)
        >>> draw_stitched(stitched, Canvas(points), points[0], 0.5).colours.shape
        (300, 3)
    """
    centres = to_numpy(stitched.charts.centre, float)
    gap = np.linalg.norm(canvas.points[:, None] - centres, axis=-1)
    charts = "1 chart" if len(centres) == 1 else f"{len(centres)} charts"
    return Drawing(
        canvas, log=stitched.coordinates, valid=stitched.covered, p=p, dots=centres,
        colours=label_colours(apart(centres))[gap.argmin(1)], radius=np.inf, period=radius / TILES,
        title=title or charts,
    )  # fmt: skip


def draw_validity(
    surface: EncodedSurface, p: Any, canvas: Canvas | None = None, *, title: str = "Validity"
) -> Drawing:
    """Probability that each point lies before the cut locus of p, as Log tells it.

    Args:
        surface, p, canvas, title: as for `draw_log`.

    Example:
        >>> from riemlayer import ExpLogField
        >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
        >>> surface = ExpLogField.from_preset("tiny").encode(points)
        >>> draw_validity(surface, points[0]).limits
        (0.0, 1.0)
    """
    canvas = canvas or Canvas(surface.points)
    p = _source(surface, p)
    with torch.inference_mode():
        logit = surface.decode_log(p, torch.as_tensor(canvas.points).to(p))[1]
    return Drawing(
        canvas, values=logit.sigmoid(), limits=(0, 1), label="validity", p=p, title=title
    )


def draw_errors(
    canvas: Canvas,
    errors: Mapping[str, Any],
    radius: float,
    *,
    valid: Any = None,
    p: Any = None,
    limits: tuple[float, float] | None = None,
) -> list[Drawing]:
    """Errors of several methods, in units of the radius, on one colour bar.

    Args:
        canvas: what is painted.
        errors: (N,) lengths for every point, by the titles of the drawings; NaN is drawn plain.
        radius: what they are divided by.
        valid: (N,) nothing is drawn where this is below 1/2.
        p: (3,) source, drawn as a ball.
        limits: ends of the colour bar, in radii; the least and the greatest of all drawn errors
            by default.

    Example:
        >>> canvas = Canvas(np.eye(4, 3), [[0, 1, 2]])
        >>> ours, theirs = draw_errors(canvas, {"a": [0, 1, 2, 3], "b": [0, 0, 0, 9]}, radius=2)
        >>> ours.limits, theirs.limits
        ((0.0, 4.5), (0.0, 4.5))
    """
    if not radius > 0:
        raise ValueError(f"`radius` must be positive, got {radius}")
    if not errors:
        raise ValueError("`errors` must hold at least one method, got none")
    drawings = [
        Drawing(canvas, values=to_numpy(x, float) / radius, valid=valid, p=p, title=title,
                label="error / radius", limits=limits)
        for title, x in errors.items()
    ]  # fmt: skip
    ends = np.array([drawing.limits for drawing in drawings])
    both = limits or (float(ends[:, 0].min()), float(ends[:, 1].max()))
    return [drawing.replace(limits=both) for drawing in drawings]


def exp_fan(surface: EncodedSurface, p: Tensor, normal: Array, radius: float, rays: int) -> Array:
    """Geodesics (rays, 25, 3) of length `radius` from p, evenly around the normal."""
    angle = np.linspace(0, 2 * np.pi, rays, endpoint=False)
    ends = radius * np.stack([np.cos(angle), np.sin(angle)], 1) @ tangent_frame(normal)
    v = torch.as_tensor(np.linspace(0, 1, STEPS)[:, None] * ends[:, None]).to(p)
    with torch.inference_mode():
        return to_numpy(surface.exp(p, v), float)


def log_map(
    surface: EncodedSurface, p: Tensor, normal: Array, canvas: Canvas, radius: float
) -> tuple[Array, Array]:
    """Tangent coordinates (N, 2) of Log_p of the canvas, and how far to trust them (N,).

    Trust below 1/2 means none. It is no better than the validity, lower where Exp does not lead
    back, and 0 where the chord is beyond the radius already: such points are put far away.
    """
    q = torch.as_tensor(canvas.points).to(p)
    with torch.inference_mode():
        near = (q - p).norm(dim=-1) <= 1.05 * radius  # a geodesic is no shorter than its chord
        v, logit = surface.decode_log(p, q[near])
        miss = (surface.decode_exp(p, v)[0] - q[near]).norm(dim=-1)
    flat, trust = FAR * radius * unit(tangent_coordinates(q - p, normal)), np.zeros(len(q))
    inside = to_numpy(near, bool)
    flat[inside] = tangent_coordinates(v, normal)
    leads_back = 1 - to_numpy(miss, float) / (2 * ASTRAY * radius)
    trust[inside] = np.minimum(to_numpy(logit.sigmoid(), float), leads_back.clip(0))
    return flat, trust


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
