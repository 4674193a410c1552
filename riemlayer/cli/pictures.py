"""Answers as pictures and pages, by `riemlayer.viz`; drawn in the cube, where units are gone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from riemlayer.cli.loaded import Array, Loaded
from riemlayer.viz import Drawing, View, viewpoint, write_html, write_png

FAR = 1e3
"""Tangent coordinates given to points that a map does not reach: beyond every radius drawn."""
MOST_DISCS = 30_000
"""Points of a cloud that are drawn."""


@dataclass(frozen=True)
class Scene:
    """What `riemlayer.viz` draws."""

    drawing: Drawing
    view: View
    title: str
    note: str = ""


def scene(
    loaded: Loaded,
    p: Array,
    note: str,
    log: Array | None = None,
    reach: float | None = None,
    **what: Any,
) -> Scene:
    """A scene around a source p (3,); everything is given in the file's units.

    Args:
        log: (n, 2) tangent coordinates of all points, drawn as tiles; NaN where there are none.
        reach: where the tiles end, the trained radius by default.
        what: paths, dots or colours of a `Drawing`.
    """
    kept = drawn(loaded)
    reach = loaded.radius if reach is None else reach
    for name in {"paths", "dots"} & {*what}:
        what[name] = [in_cube(loaded, x) for x in what[name]]
    if "colours" in what:
        what["colours"] = what["colours"][kept]
    if log is not None:
        what["log"] = np.nan_to_num(log[kept] / loaded.scale, nan=FAR)
    canvas = in_cube(loaded, loaded.points)
    drawing = Drawing(
        canvas[kept], loaded.faces, p=in_cube(loaded, p), radius=reach / loaded.scale, **what
    )
    view = viewpoint(canvas, outward(loaded, p, loaded.frame(p)[:, 2]))
    return Scene(drawing, view, loaded.path.name, note)


def in_cube(loaded: Loaded, x: Array) -> Array:
    """Points in the cube, in double precision."""
    return (np.asarray(x) - loaded.centre) / loaded.scale


def drawn(loaded: Loaded) -> np.ndarray:
    """Indices of the points to draw: all of a mesh, some of a large cloud."""
    n = len(loaded.points)
    if loaded.faces is not None or n <= MOST_DISCS:
        return np.arange(n)
    return np.sort(np.random.default_rng(0).choice(n, MOST_DISCS, replace=False))


def outward(loaded: Loaded, p: Array, normal: Array) -> Array:
    """The normal with the sign that leaves most of the shape behind the tangent plane."""
    side = ((loaded.points - p) / loaded.scale @ normal).mean()
    return normal if side < 0 else -normal


def write_scene(path: Path, scene: Scene) -> None:
    """A .png or an .html, by the suffix."""
    if path.suffix.lower() == ".png":
        write_png(path, scene.drawing, view=scene.view)
        return
    drawing = scene.drawing
    write_html(path, drawing, view=scene.view, title=scene.title, note=scene.note)
