"""Pictures on one sheet: side by side, with titles and colour bars."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from riemlayer.viz.drawing import Drawing
from riemlayer.viz.palette import colour_map

if TYPE_CHECKING:
    from PIL.Image import Image

Array = np.ndarray

DPI = 100
STRIP = 0.25
"""Width of a colour bar with its numbers and words, in parts."""
TITLE, WORDS = 0.042, 0.034
"""Heights of letters, in parts."""
INK = "#222222"


def compose(parts: Sequence[Array], drawings: Sequence[Drawing], columns: int | None) -> Image:
    """Parts (size, size, 3) in rows of `columns`, under titles; a bar stands after its drawings.

    Neighbours in a row that have the same label and limits share a bar.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    size, columns = len(parts[0]), columns or len(parts)
    if columns < 1:
        raise ValueError(f"`columns` must be at least 1, got {columns}")
    rows = [
        _row(range(i, min(i + columns, len(parts))), drawings)
        for i in range(0, len(parts), columns)
    ]
    strip = round(STRIP * size)
    width = max(size * len(row) + strip * sum(bars) for row, bars in rows)
    height = size * len(rows)
    sheet = np.full((height, width, 3), 255, np.uint8)
    with rc_context({"font.family": "sans-serif", "axes.edgecolor": INK}):
        figure = Figure((width / DPI, height / DPI), dpi=DPI, facecolor="none")
        for r, (row, bars) in enumerate(rows):
            left, top = 0, r * size
            for i, bar in zip(row, bars, strict=True):
                sheet[top : top + size, left : left + size] = parts[i]
                middle, head = (left + size / 2) / width, 1 - (top + 0.3 * TITLE * size) / height
                figure.text(
                    middle, head, drawings[i].title, ha="center", va="top", color=INK,
                    fontsize=TITLE * size * 72 / DPI,
                )  # fmt: skip
                left += size
                if bar:
                    _add_bar(figure, drawings[i], left, top, size)
                    left += strip
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        ink = np.asarray(canvas.buffer_rgba(), float)
    cover = ink[..., 3:] / 255
    return Image.fromarray((sheet * (1 - cover) + ink[..., :3] * cover).round().astype(np.uint8))


def _row(indices: range, drawings: Sequence[Drawing]) -> tuple[range, list[bool]]:
    """Which drawings of a row are followed by a bar."""

    def scale(i: int) -> Any:
        drawing = drawings[i]
        return None if drawing.values is None else (drawing.label, drawing.limits)

    bars = []
    for i in indices:
        same = i + 1 in indices and scale(i + 1) == scale(i)
        bars.append(scale(i) is not None and not same)
    return indices, bars


def _add_bar(figure: Any, drawing: Drawing, left: int, top: int, size: int) -> None:
    """A colour bar from `limits[0]` to `limits[1]`, with both ends among its ticks."""
    width, height = figure.get_size_inches() * DPI
    box = (left + 0.02 * size) / width, 1 - (top + 0.8 * size) / height
    axes = figure.add_axes((*box, 0.035 * size / width, 0.6 * size / height))
    low, high = drawing.limits or (0.0, 1.0)
    shades = colour_map(np.linspace(0, 1, 256))[:, None]
    axes.imshow(shades, origin="lower", aspect="auto", extent=(0, 1, 0, 1))
    letters = WORDS * size * 72 / DPI
    axes.set_xticks([])
    axes.yaxis.tick_right()
    axes.yaxis.set_label_position("right")
    axes.set_yticks(np.linspace(0, 1, 5), [f"{x:.3g}" for x in np.linspace(low, high, 5)])
    axes.tick_params(labelsize=letters, width=0.008 * letters * size / DPI, colors=INK)
    axes.set_ylabel(drawing.label, fontsize=letters, color=INK)
