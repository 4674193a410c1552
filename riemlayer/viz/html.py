"""A page with the shape to turn: one file, nothing loaded from anywhere."""

from __future__ import annotations

import base64
import json
import os
from importlib.resources import files
from pathlib import Path

import numpy as np

from riemlayer.viz.drawing import BLACK, BLUE, CREAM, DOT, ORANGE, PLAIN, Array, Drawing, View


def write_html(
    path: str | Path, *drawings: Drawing, view: View, title: str = "riemlayer", note: str = ""
) -> Path:
    """A page that shows the drawings one at a time and can be turned with mouse, finger and keys.

    The page holds all it needs (WebGL 2, no library), so it opens from a disk without a network.

    Args:
        path: the file to write; it appears only when it is complete.
        drawings: one or more; their titles become the buttons.
        view: where one looks from first, see `viewpoint`.
        title: of the page.
        note: a sentence below the title.

    Returns:
        The path.
    """
    if any(drawing.colours is not None for drawing in drawings):
        raise ValueError("drawings must have no `colours`: pages show tiles; use write_png")
    path = Path(path)
    store = _Store()
    scene = {
        "title": title,
        "note": note,
        "view": {key: np.asarray(value).tolist() for key, value in vars(view).items()},
        "colours": {
            "blue": BLUE,
            "cream": CREAM,
            "plain": PLAIN,
            "orange": ORANGE,
            "black": BLACK,
            "dot": DOT,
        },
        "drawings": [_encode(drawing, store) for drawing in drawings],
        "arrays": store.encoded,
    }
    # "<" would end the script element that holds the data
    data = json.dumps(scene).replace("<", "\\u003c")
    template = files("riemlayer.viz").joinpath("page.html").read_text("utf-8")
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.html")
    temporary.write_text(template.replace("{{scene}}", data), "utf-8")
    os.replace(temporary, path)
    return path


class _Store:
    """Arrays as base64 text; an array that several drawings share is kept once."""

    def __init__(self) -> None:
        self.encoded: list[str] = []
        self._index: dict[str, int] = {}

    def __call__(self, x: Array | None, dtype: type) -> int | None:
        if x is None:
            return None
        text = base64.b64encode(np.ascontiguousarray(x, dtype=dtype).tobytes()).decode()
        if text not in self._index:
            self._index[text] = len(self.encoded)
            self.encoded.append(text)
        return self._index[text]


def _encode(drawing: Drawing, store: _Store) -> dict:
    return {
        "title": drawing.title,
        "radius": drawing.radius,
        "period": drawing.period,
        "spacing": drawing.spacing,
        "points": store(drawing.points, np.float32),
        "normals": store(drawing.normals, np.float32),
        "faces": store(drawing.faces, np.uint32),
        "log": store(drawing.log, np.float32),
        "slope": store(drawing.slope, np.float32),
        "p": store(drawing.p, np.float32),
        "dots": store(drawing.dots, np.float32),
        "paths": [
            store(_segments(lines), np.float32) for lines in (drawing.paths, drawing.reference)
        ],
    }


def _segments(lines) -> Array:
    """(..., 6) begin and end of every straight piece of the polylines."""
    pieces = [np.concatenate([line[:-1], line[1:]], axis=1) for line in lines]
    return np.concatenate(pieces) if pieces else np.zeros((0, 6))
