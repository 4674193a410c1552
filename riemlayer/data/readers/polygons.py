"""Polygons in text: rows of different lengths, kept in compact arrays."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray


def read_polygons(
    lines: Iterator[str], count: int, before: Sequence[bool] = ()
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The corners of all polygons and the number of each one's; one a line, its number first.

    Args:
        lines: consumed as far as needed.
        count: polygons.
        before: the columns ahead of each polygon, True for a list with its length.

    Raises:
        ValueError: fewer lines, or a line that holds something else.
    """
    corners, counts = array("q"), array("q")
    for line in islice(lines, count):
        words, at = line.split(), 0
        try:
            for is_list in before:
                at += 1 + (int(words[at]) if is_list else 0)
            own = int(words[at])
            row = [int(word) for word in words[at + 1 : at + 1 + own]]
        except (ValueError, IndexError):
            row, own = [], -1
        if len(row) != own or "_" in line:  # Python takes 1_0 for a number
            raise ValueError(
                f"must hold polygons as a number and that many whole numbers, got {line[:60]!r}"
            )
        corners.extend(row)
        counts.append(own)
    if len(counts) != count:
        raise ValueError(f"must hold {count} polygons, got {len(counts)}; is it cut short?")
    return np.array(corners, np.int64), np.array(counts, np.int64)


def fans(corners: NDArray, counts: NDArray) -> NDArray[np.int64]:
    """Triangles (m, 3) of polygons, as fans around each one's first corner (ours).

    Args:
        corners: (sum of counts,) vertices of all polygons, one after the other.
        counts: (P,) corners of each; those with fewer than 3 have no triangle.

    >>> fans(np.array([4, 5, 6, 7, 0, 1, 2]), np.array([4, 3])).tolist()
    [[4, 5, 6], [4, 6, 7], [0, 1, 2]]
    """
    counts = np.asarray(counts, np.int64)
    first = np.cumsum(counts) - counts
    triangles = np.maximum(counts - 2, 0)
    start = np.repeat(first, triangles)
    step = np.arange(len(start)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    rows = np.stack([start, start + step + 1, start + step + 2], 1)
    return np.asarray(corners).astype(np.int64)[rows]
