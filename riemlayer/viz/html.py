"""A page with the shape to turn: one file, nothing loaded from anywhere."""

from __future__ import annotations

import base64
import json
import os
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from riemlayer.viz import palette
from riemlayer.viz.canvas import Canvas
from riemlayer.viz.drawing import Array, Drawing
from riemlayer.viz.sheet import tick_labels
from riemlayer.viz.view import View

HUGE = 1e30
"""Stands for an infinite radius, which JSON does not have."""
STOPS = 17
"""Of the colour bar's gradient."""


def write_html(
    path: str | Path, *drawings: Drawing, view: View, title: str = "riemlayer", note: str = ""
) -> Path:
    """A page that shows the drawings, one at a time or side by side under one camera.

    It is turned with mouse, finger and keys, and holds all it needs (WebGL 2, no library), so it
    opens from a disk without a network.

    Args:
        path: the file to write; it appears only when it is complete.
        drawings: one or more; their titles become the buttons.
        view: where one looks from first, see `viewpoint`.
        title: of the page.
        note: a sentence below the title.

    Returns:
        The path.

    Example:
        >>> import tempfile
        >>> from riemlayer.viz import Drawing, viewpoint
        >>> points = np.random.default_rng(0).random((50, 2)) @ np.eye(2, 3)
        >>> drawing = Drawing(points, log=points[:, :2], title="a flat cloud")
        >>> folder, view = Path(tempfile.mkdtemp()), viewpoint(points, [0, 0, 1])
        >>> write_html(folder / "page.html", drawing, view=view).name
        'page.html'
    """
    if not drawings:
        raise ValueError("`drawings` must be one or more, got none")
    path, store = Path(path), ArrayStore()
    content = [encode(x, store) for x in drawings]
    page = render_page(content, store.encoded, view, title, note)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.html")
    try:
        temporary.write_text(page, "utf-8")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


class ArrayStore:
    """Arrays as base64 text; an array that several drawings share is kept once.

    Args:
        first: index of the first array; those before it are somewhere else already.
    """

    def __init__(self, first: int = 0) -> None:
        self.first = first
        self.encoded: list[str] = []
        self._index: dict[str, int] = {}

    def __call__(self, x: Array | None, dtype: type = np.float32) -> int | None:
        if x is None:
            return None
        text = base64.b64encode(np.ascontiguousarray(x, dtype=dtype).tobytes()).decode()
        if text not in self._index:
            self._index[text] = self.first + len(self.encoded)
            self.encoded.append(text)
        return self._index[text]


def encode(drawing: Drawing, store: ArrayStore) -> dict[str, Any]:
    """What the page is told of a drawing: numbers, and the indices of its arrays in the store."""
    return encode_canvas(drawing.canvas, store) | encode_content(drawing, store)


def encode_canvas(canvas: Canvas, store: ArrayStore) -> dict[str, Any]:
    """The shape as it is drawn."""
    discs = canvas.discs
    return {
        "point": store(canvas.points[canvas.corner]),
        "normal": store(canvas.normals),
        "faces": store(canvas.triangles, np.uint32),
        "size": store(None if discs is None else discs.size),
        "rim": store(None if discs is None else discs.rim),
        "bend": store(None if discs is None else discs.bend),
    }


def encode_content(drawing: Drawing, store: ArrayStore) -> dict[str, Any]:
    """What is drawn on the shape."""
    corner = drawing.canvas.corner
    low, high = drawing.limits or (0.0, 1.0)
    by_point = {
        "log": drawing.log, "value": drawing.values, "valid": drawing.valid, "tint": drawing.colours
    }  # fmt: skip
    return {
        "title": drawing.title,
        "pattern": drawing.pattern,
        "radius": min(drawing.radius, HUGE),
        "period": drawing.period,
        "low": low,
        "high": high,
        "label": drawing.label,
        "ticks": tick_labels(drawing),
        **{name: store(None if x is None else x[corner]) for name, x in by_point.items()},
        "slope": store(_two_rows(drawing.slope)),
        "p": store(drawing.p),
        "dots": store(drawing.dots),
        "paths": store(_segments(drawing.paths)),
        "reference": store(_segments(drawing.reference)),
    }


def render_page(
    drawings: list[dict],
    arrays: list[str],
    view: View,
    title: str,
    note: str,
    scripts: tuple[str, ...] = (),
    fixed: int = 0,
) -> str:
    """The page's text.

    Args:
        drawings: of `encode`.
        arrays: of the `ArrayStore`.
        view, title, note: as for `write_html`.
        scripts: of this folder, after the page's own.
        fixed: how many arrays stay when the content changes.
    """
    scene = {
        "title": title,
        "note": note,
        "view": {key: np.asarray(value).tolist() for key, value in vars(view).items()},
        "colours": {
            name: getattr(palette, name.upper())
            for name in ("blue", "cream", "plain", "orange", "black", "dot")
        },
        "map": palette.MAP,
        "bar": [_css(colour) for colour in palette.colour_map(np.linspace(0, 1, STOPS))],
        "drawings": drawings,
        "arrays": arrays,
        "fixed": fixed,
    }
    # "<" would end the script element that holds the data, which comes last: it is the user's text
    parts = {
        "{{shader}}": _text("surface.glsl"),
        "{{script}}": "\n".join(_text(name) for name in ("draw.js", "page.js", *scripts)),
        "{{scene}}": json.dumps(scene, allow_nan=False).replace("<", "\\u003c"),
    }
    page = _text("page.html")
    for mark, text in parts.items():
        page = page.replace(mark, text)
    return page


def _text(name: str) -> str:
    return files("riemlayer.viz").joinpath(name).read_text("utf-8")


def _css(colour: Array) -> str:
    return "#" + "".join(f"{round(255 * x):02x}" for x in colour)


def _segments(lines) -> Array:
    """(..., 6) begin and end of every straight piece of the polylines."""
    pieces = [np.concatenate([line[:-1], line[1:]], axis=1) for line in lines]
    return np.concatenate(pieces) if pieces else np.zeros((0, 6))


def _two_rows(slope: Array | None) -> Array | None:
    """(N, 2, 3) what the shader takes: the second row is 0 where there is one number a point."""
    if slope is None:
        return None
    return np.concatenate([slope, np.zeros_like(slope)], axis=1)[:, :2]
