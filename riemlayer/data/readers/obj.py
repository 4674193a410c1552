"""Wavefront OBJ files (ours): vertices keep the file's numbers, which trimesh's seams change."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from riemlayer.data.readers.polygons import fans
from riemlayer.data.readers.record import RawShape, bytes_of_colours, unit_normals

LINES = (
    "f g o s l p vp mtllib usemtl usemap maplib lod bevel c_interp d_interp shadow_obj trace_obj"
)
CURVES = "cstype deg bmat step curv curv2 surf parm trim hole scrv sp end con mg ctech stech"
KNOWN = frozenset(word.encode() for word in f"{LINES} {CURVES} call csh".split())
"""Keywords of the format besides v, vt and vn."""


class Faces:
    """Corners of all polygons as (vertex, vt, vn) from 0, -1 where not given."""

    def __init__(self) -> None:
        self.corners, self.counts = array("q"), array("q")

    def add(self, words: list[bytes], sizes: Sequence[int]) -> None:
        """One polygon; negative numbers count back from the `sizes` so far."""
        for word in words:
            parts = word.split(b"/")
            if not 1 <= len(parts) <= 3:
                raise ValueError
            for i in range(3):
                given = int(parts[i]) if i < len(parts) and parts[i] else 0
                if given == 0 and i == 0:
                    raise ValueError
                self.corners.append(given - 1 if given >= 0 else sizes[i] + given)
        self.counts.append(len(words))

    def arrays(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Corners (P, 3) and counts."""
        return np.array(self.corners, np.int64).reshape(-1, 3), np.array(self.counts, np.int64)


def read_obj(path: Path) -> RawShape:
    """All polygons of a file as one mesh, or its vertices as a cloud where it has no polygon.

    Vertices may carry colours (six numbers). Normals and texture coordinates are taken where every
    vertex has one alone.
    """
    rows = {b"v": array("d"), b"vt": array("d"), b"vn": array("d")}
    widths = {b"v": 3, b"vt": 2, b"vn": 3}
    colours, faces = array("d"), Faces()
    with path.open("rb") as file:
        for number, line in _lines(file):
            words = line.split()
            if not words or words[0].startswith(b"#"):
                continue
            key = words[0]
            try:
                if b"_" in line and key not in KNOWN - {b"f"}:
                    raise ValueError  # Python takes 1_0 for a number
                if key in rows:
                    row = [float(word) for word in words[1:]]
                    if key == b"v" and len(row) >= 6:
                        colours.extend(row[3:6])
                    row = row[: widths[key]] + [0.0] * (key == b"vt" and len(row) == 1)
                    if len(row) != widths[key]:
                        raise ValueError
                    rows[key].extend(row)
                elif key == b"f":
                    faces.add(words[1:], [len(rows[k]) // widths[k] for k in rows])
                elif key not in KNOWN:
                    raise ValueError
            except (ValueError, OverflowError):
                text = line.decode("latin-1").strip()[:60]
                raise ValueError(f"must hold lines of OBJ, line {number} is {text!r}") from None
    v, vt, vn = (np.array(rows[k]).reshape(-1, widths[k]) for k in rows)
    colour = None
    if len(colours) == v.size and len(v):
        colour = bytes_of_colours(np.array(colours).reshape(-1, 3))
    if not len(faces.counts):
        normals = unit_normals(vn) if len(vn) == len(v) and len(v) else None
        return RawShape(points=v, normals=normals, colours=colour)
    corners, counts = faces.arrays()
    uv, normals = (_one_each(corners, i, x, len(v)) for i, x in ((1, vt), (2, vn)))
    return RawShape(
        vertices=v,
        faces=fans(corners[:, 0], counts),
        normals=None if normals is None else unit_normals(normals),
        colours=colour,
        uv=uv,
    )


def _lines(file: IO[bytes]) -> Iterator[tuple[int, bytes]]:
    """Numbered lines; those that end in a backslash are joined to the next."""
    held = b""
    for number, line in enumerate(file, 1):
        if line.rstrip(b"\r\n").endswith(b"\\"):
            held += line.rstrip(b"\r\n")[:-1] + b" "
            continue
        yield number, held + line
        held = b""
    if held:
        yield number, held


def _one_each(corners: NDArray, i: int, x: NDArray, n: int) -> NDArray | None:
    """Row (n, k) of x for each vertex, if all corners at a vertex name equal rows of x."""
    vertex, index = corners[:, 0], corners[:, i]
    if vertex.min() < 0 or vertex.max() >= n or index.min() < 0 or index.max() >= len(x):
        return None
    values = np.zeros((n, x.shape[1]))
    values[vertex] = x[index]
    return values if (values[vertex] == x[index]).all() else None
