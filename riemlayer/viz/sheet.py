"""Pictures on one sheet: side by side, with titles and colour bars."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from riemlayer.viz.drawing import Drawing
from riemlayer.viz.palette import colour_map

if TYPE_CHECKING:
    from PIL.Image import Image

Array = np.ndarray

DPI = 100
STRIP = 0.27
"""Width of a colour bar with its numbers and words, in parts."""
TITLE, WORDS = 0.042, 0.034
"""Heights of letters, in parts."""
HEAD = 0.08
"""Height of the line of titles, in parts."""
INK = "#222222"
TICKS = 5


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
    heads = [round(HEAD * size) if any(drawings[i].title for i in row) else 0 for row, _ in rows]
    width = max(size * len(row) + strip * sum(bars) for row, bars in rows)
    height = size * len(rows) + sum(heads)
    sheet = np.full((height, width, 3), 255, np.uint8)
    with rc_context({"font.family": "sans-serif", "axes.edgecolor": INK}):
        figure = Figure((width / DPI, height / DPI), dpi=DPI, facecolor="none")
        top = 0
        for (row, bars), head in zip(rows, heads, strict=True):
            left = 0
            for i, bar in zip(row, bars, strict=True):
                sheet[top + head : top + head + size, left : left + size] = parts[i]
                figure.text(
                    (left + size / 2) / width, 1 - (top + head / 2) / height, drawings[i].title,
                    ha="center", va="center", color=INK, fontsize=TITLE * size * 72 / DPI,
                )  # fmt: skip
                left += size
                if bar:
                    _add_bar(figure, drawings[i], left, top + head, size)
                    left += strip
            top += head + size
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
    shades = colour_map(np.linspace(0, 1, 256))[:, None]
    axes.imshow(shades, origin="lower", aspect="auto", extent=(0, 1, 0, 1))
    letters = WORDS * size * 72 / DPI
    axes.set_xticks([])
    axes.yaxis.tick_right()
    axes.set_yticks(np.linspace(0, 1, TICKS), tick_labels(drawing))
    axes.tick_params(labelsize=letters, width=0.008 * letters * size / DPI, colors=INK)
    figure.text(
        (left + STRIP * size) / width, box[1] + 0.3 * size / height, drawing.label, rotation=90,
        ha="right", va="center", fontsize=letters, color=INK,
    )  # fmt: skip


def tick_labels(drawing: Drawing) -> list[str]:
    """Five numbers from one end of the colour bar to the other; an end that is exceeded says so.

    Example:
        >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
        >>> tick_labels(Drawing(square, [[0, 1, 2], [0, 2, 3]], values=[0, 1, 2, 9], limits=(0, 8)))
        ['0', '2', '4', '6', '≥ 8']
    """
    low, high = drawing.limits or (0.0, 1.0)
    digits = 3 - math.ceil(math.log10(high - low)) if high > low else 6
    labels = [f"{round(x, digits):g}" for x in np.linspace(low, high, TICKS)]
    if drawing.values is not None and drawing.valid is not None:
        shown = drawing.values[drawing.valid >= 0.5]
        labels[0] = "≤ " * bool((shown < low).any()) + labels[0]
        labels[-1] = "≥ " * bool((shown > high).any()) + labels[-1]
    return labels
