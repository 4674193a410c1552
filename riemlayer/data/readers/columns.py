"""Tables of numbers in text, streamed into arrays: no line outlives its parsing."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from riemlayer.data.readers.record import RawShape, bytes_of_colours, unit_normals

COMMENTS = ("#", "//", ";", "%")
WORD = re.compile(r"[A-Za-z_]")
NUMBER = re.compile(r"[+-]?(\d+\.?\d*([eE][+-]?\d+)?|\.\d+([eE][+-]?\d+)?|nan|inf)", re.IGNORECASE)


def read_text_cloud(path: Path) -> RawShape:
    """A cloud of one point a line (.xyz .pts .txt): x y z, then colours or normals.

    Numbers are separated by blanks, commas or semicolons. Comments (#, //), one line of column
    names and a first line with the number of points are understood; that number must be right.
    """
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = _lines(file)
        first = next(lines, None)
        if first is not None and _names_columns(first):
            first = next(lines, None)
        if first is None:
            raise ValueError("must hold at least 4 points of 3 numbers, it holds none")
        declared = None
        if re.fullmatch(r"\d+", first):
            declared, first = int(first), next(lines, "")
        table = read_table(_chain(first, lines))
    if declared is not None and declared != len(table):
        raise ValueError(f"must hold the {declared} points of its first line, got {len(table)}")
    if table.shape[1] < 3:
        raise ValueError(f"must hold at least three numbers a line, got {table.shape}")
    normals, colours = _aside(table)
    return RawShape(points=table[:, :3].copy(), normals=normals, colours=colours)


def read_table(lines: Iterator[str], width: int | None = None) -> NDArray[np.float64]:
    """Rows of equally many numbers as (rows, columns); lines are parsed as they come.

    Raises:
        ValueError: something else than a number, rows of different lengths, or not of `width`.
    """
    first = next(lines, None)
    if first is None:
        return np.zeros((0, width or 3))
    try:
        table = np.loadtxt(_chain(first, lines), ndmin=2, comments=None)
    except ValueError as error:
        raise ValueError(f"must hold equally many numbers a line: {error}") from error
    if width is not None and table.shape[1] != width:
        raise ValueError(f"must hold {width} numbers a line, got {table.shape[1]}")
    return table


def _lines(file: IO[str]) -> Iterator[str]:
    for line in file:
        line = line.strip()
        if line and not line.startswith(COMMENTS):
            yield line.split("#")[0].replace(",", " ").replace(";", " ").strip()


def _chain(first: str, lines: Iterator[str]) -> Iterator[str]:
    yield first
    yield from lines


def _names_columns(line: str) -> bool:
    """Is this a header such as "X Y Z R G B", with no number in it?"""
    words = line.split()
    return len(words) >= 3 and all(WORD.match(w) and not NUMBER.fullmatch(w) for w in words)


def _aside(table: NDArray) -> tuple[NDArray | None, NDArray | None]:
    """Normals and colours among the columns after x y z: triples of unit length, or of bytes."""
    normals = colours = None
    extra = table[:, 3:]
    starts = {3: (0,), 4: (1, 0), 6: (0, 3), 7: (1, 4)}.get(extra.shape[1], ())
    for start in starts:
        triple = extra[:, start : start + 3]
        length = np.linalg.norm(triple, axis=1)
        if normals is None and np.abs(length - 1).max(initial=0) < 0.02:
            normals = unit_normals(triple)
        elif colours is None and triple.min(initial=0) >= 0 and triple.max(initial=0) <= 255:
            whole = bool((triple == np.round(triple)).all())
            if whole or triple.max(initial=0) <= 1:
                colours = bytes_of_colours(triple)
    return normals, colours
