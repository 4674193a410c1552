"""Answers as pictures and pages, by `riemlayer.viz`; drawn in the cube, where units are gone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from riemlayer.cli.loaded import Array, Loaded
from riemlayer.viz import (
    Canvas,
    Drawing,
    View,
    draw_exp,
    draw_log,
    outward,
    viewpoint,
    write_html,
    write_png,
)

MOST_DISCS = 30_000
"""Points of a cloud that are drawn."""
LONGEST = 0.05
"""Edges of a mesh are halved down to this, in the cube, where a map can be asked anywhere."""


@dataclass(frozen=True)
class Scene:
    """What `riemlayer.viz` draws."""

    drawings: tuple[Drawing, ...]
    view: View
    title: str
    note: str = ""


def log_scene(loaded: Loaded, p: Array, note: str) -> Scene:
    """Log of p (3,), file's units, as tiles and as a polar grid, and Exp as a fan."""
    canvas = canvas_of(loaded, LONGEST)
    x = loaded.inward(p)
    drawings = (
        draw_log(loaded.surface, x, canvas),
        draw_log(loaded.surface, x, canvas, texture="polar", title="Log, polar"),
        draw_exp(loaded.surface, x, canvas),
    )
    return Scene(drawings, looking_at(loaded, p), loaded.path.name, note)


def scene(
    loaded: Loaded,
    p: Array,
    note: str,
    canvas: Canvas | None = None,
    log: Array | None = None,
    reach: float | None = None,
    **what: Any,
) -> Scene:
    """One drawing around p (3,); everything is given in the file's units.

    Args:
        loaded: the shape.
        p: (3,) the source.
        note: a sentence below the title.
        canvas: what log and colours belong to; the file's points by default.
        log: (n, 2) tangent coordinates of all points, drawn as tiles; NaN where there are none.
        reach: where the tiles end, the trained radius by default.
        what: paths, dots or colours of a `Drawing`.
    """
    for name in {"paths", "dots"} & {*what}:
        what[name] = in_cube(loaded, what[name])
    if log is not None:
        what["log"] = log / loaded.scale
    if canvas is None:
        canvas, kept = canvas_of(loaded), drawn(loaded)
        what |= {name: what[name][kept] for name in {"log", "colours"} & {*what}}
    radius = loaded.radius / loaded.scale
    drawing = Drawing(
        canvas,
        p=in_cube(loaded, p),
        radius=radius if reach is None else reach / loaded.scale,
        period=radius / 5,
        **what,
    )
    return Scene((drawing,), looking_at(loaded, p), loaded.path.name, note)


def canvas_of(loaded: Loaded, longest: float | None = None) -> Canvas:
    """The mesh, or some of the points of a large cloud."""
    return Canvas(in_cube(loaded, loaded.points)[drawn(loaded)], loaded.faces, longest=longest)


def looking_at(loaded: Loaded, p: Array) -> View:
    """A camera that sees p (3,) well."""
    x, q = in_cube(loaded, loaded.points)[drawn(loaded)], in_cube(loaded, p)
    return viewpoint(x, outward(x, q, loaded.frame(p)[:, 2]))


def in_cube(loaded: Loaded, x: Array) -> Array:
    """Points (..., 3) in the cube, in double precision."""
    return (np.asarray(x) - loaded.centre) / loaded.scale


def drawn(loaded: Loaded) -> np.ndarray:
    """Indices of the points to draw: all of a mesh, some of a large cloud."""
    n = len(loaded.points)
    if loaded.faces is not None or n <= MOST_DISCS:
        return np.arange(n)
    return np.sort(np.random.default_rng(0).choice(n, MOST_DISCS, replace=False))


def write_scene(path: Path, scene: Scene) -> None:
    """A .png or an .html, by the suffix."""
    if path.suffix.lower() == ".png":
        write_png(path, *scene.drawings, view=scene.view)
    else:
        write_html(path, *scene.drawings, view=scene.view, title=scene.title, note=scene.note)
