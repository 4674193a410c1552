"""OFF files (ours); trimesh's reader takes a file that was cut short for a smaller mesh."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import IO

from riemlayer.data.readers.columns import read_table
from riemlayer.data.readers.polygons import fans, read_polygons
from riemlayer.data.readers.record import RawShape, bytes_of_colours, unit_normals

HEADER = re.compile(r"(ST)?(C)?(N)?OFF")


def read_off(path: Path) -> RawShape:
    """A mesh (OFF, COFF, NOFF, STOFF and their combinations, as text), or a cloud without faces."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = _lines(file)
        word, _, rest = next(lines, "").partition(" ")
        kind = HEADER.fullmatch(word)
        if kind is None:
            raise ValueError(f"must begin with OFF, got {word[:20]!r}; is it another format?")
        counts = (rest or next(lines, "")).split()
        if not 2 <= len(counts) <= 3 or not all(re.fullmatch("[0-9]{1,15}", x) for x in counts):
            raise ValueError("must give its numbers of vertices and faces in text after OFF")
        vertices, faces = int(counts[0]), int(counts[1])
        table = read_table(islice(lines, vertices))
        if len(table) != vertices or table.shape[1] < 3:
            raise ValueError(f"must hold {vertices} vertices, got {table.shape}; is it cut short?")
        triangles = fans(*read_polygons(lines, faces)) if faces else None
        if next(lines, None) is not None:
            raise ValueError("must hold the numbers that it begins with, more lines follow")
    texture, colour, normal = (part is not None for part in kind.groups())
    extra = table[:, 3:]
    width = 3 * normal
    normals = unit_normals(extra[:, :3]) if normal and extra.shape[1] >= 3 else None
    wide = extra.shape[1] - width - 2 * texture
    colours = bytes_of_colours(extra[:, width : width + 3]) if colour and wide >= 3 else None
    uv = extra[:, -2:] if texture and extra.shape[1] >= width + 2 else None
    xyz = table[:, :3].copy()
    if triangles is None:
        return RawShape(points=xyz, normals=normals, colours=colours)
    return RawShape(vertices=xyz, faces=triangles, normals=normals, colours=colours, uv=uv)


def _lines(file: IO[str]) -> Iterator[str]:
    for line in file:
        line = line.split("#")[0].strip()
        if line:
            yield line
