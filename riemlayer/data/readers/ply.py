"""PLY files, of text or binary, clouds or meshes (ours).

trimesh's reader holds text line by line, and refuses binary files that mix triangles and quads.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from riemlayer.data.readers.columns import read_table
from riemlayer.data.readers.polygons import fans, read_polygons
from riemlayer.data.readers.record import (
    RawShape,
    bytes_of_colours,
    side_by_side,
    unit_normals,
)

TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CORNERS = ("vertex_indices", "vertex_index")
AXES, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
COORDINATES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texcoord_u", "texcoord_v"))
LONGEST = 1 << 16
"""Bytes of a header's line; corners of a polygon."""


@dataclass
class Element:
    """A kind of record: how many, and of each property name, type and, of a list, its count's."""

    name: str
    count: int
    properties: list[tuple[str, str, str | None]] = field(default_factory=list)

    def dtype(self, order: str, lengths: dict[str, int]) -> np.dtype:
        """Of a record whose lists have these lengths."""
        fields = []
        for name, kind, length in self.properties:
            if length is not None:
                fields += [(name + " length", order + length), (name, order + kind, lengths[name])]
            else:
                fields.append((name, order + kind))
        return np.dtype(fields)


class Content(dict[str, NDArray]):
    """Columns (n,) of an element; of faces the `corners` of all, and the `counts` of each."""


def read_ply(path: Path) -> RawShape:
    """A mesh, or a cloud where there are no faces; normals, colours and uv of the vertices."""
    contents: dict[str, Content] = {}
    with path.open("rb") as file:
        order, elements = _header(file)
        for element in elements:
            read = _binary(path, file, element, order) if order else _text(file, element)
            contents[element.name] = read
        left = len(file.read(LONGEST).strip())
    if left:
        raise ValueError(f"must hold what its header says, {left} bytes or more are left over")
    if "tristrips" in contents:
        raise ValueError("must hold faces, got triangle strips; write it again as triangles")
    return _shape(contents)


def _header(file: IO[bytes]) -> tuple[str, list[Element]]:
    if file.readline(LONGEST).strip() != b"ply":
        raise ValueError("must begin with `ply`; is it a mesh of another format?")
    order, elements = None, []
    for line in iter(lambda: file.readline(LONGEST), b""):
        match line.decode("latin-1").split():
            case ["end_header"] if order is not None:
                return order, elements
            case ["format", form, "1.0"] if form in ORDERS:
                order = ORDERS[form]
            case ["element", name, count] if re.fullmatch(r"[0-9]{1,15}", count):
                elements.append(Element(name, int(count)))
            case ["property", "list", length, kind, name] if {length, kind} <= {*TYPES}:
                _append(elements, (name, TYPES[kind], TYPES[length]))
            case ["property", kind, name] if kind in TYPES:
                _append(elements, (name, TYPES[kind], None))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case words:
                raise ValueError(f"must have a PLY header, got the line {' '.join(words)[:60]!r}")
    raise ValueError("must have a PLY header up to `end_header`; is it cut short?")


def _append(elements: list[Element], new: tuple[str, str, str | None]) -> None:
    if not elements or any(new[0] == old[0] for old in elements[-1].properties):
        raise ValueError(f"must have a PLY header, its property {new[0][:40]!r} is out of place")
    elements[-1].properties.append(new)


def _binary(path: Path, file: IO[bytes], element: Element, order: str) -> Content:
    """Reads an element; at once where its lists have one length, as in nearly all files."""
    start, left = file.tell(), path.stat().st_size - file.tell()
    if not element.count or not element.properties:
        return Content()
    lengths = _first_lengths(file, element, order)
    dtype = element.dtype(order, lengths)
    if element.count * dtype.itemsize <= left:
        data = np.memmap(path, dtype, "r", start, (element.count,))
        if all((data[name + " length"] == length).all() for name, length in lengths.items()):
            file.seek(start + data.nbytes)
            corners = next((name for name in CORNERS if name in lengths), None)
            if corners is None:
                return Content({name: data[name] for name in dtype.names or ()})
            counts = np.full(element.count, lengths[corners])
            return Content(corners=np.array(data[corners]).reshape(-1), counts=counts)
    if not lengths:
        raise _short(element)
    file.seek(start)
    return _ragged(file, element, order)


def _first_lengths(file: IO[bytes], element: Element, order: str) -> dict[str, int]:
    """Length of each list in the first record, at which the file stands."""
    lengths = {}
    for name, kind, length in element.properties:
        count = 1
        if length is not None:
            size = np.dtype(length).itemsize
            count = lengths[name] = _length(file.read(size), 0, order + length, element)
        file.seek(count * np.dtype(kind).itemsize, 1)
    return lengths


def _ragged(file: IO[bytes], element: Element, order: str) -> Content:
    """Reads an element whose lists differ in length, record by record; keeps the corners."""
    start, data, at = file.tell(), file.read(), 0
    corners, counts = [np.zeros(0, np.int64)], []
    for _ in range(element.count):
        for name, kind, length in element.properties:
            count, kind = 1, np.dtype(order + kind)
            if length is not None:
                count = _length(data, at, order + length, element)
                at += np.dtype(length).itemsize
            if at + count * kind.itemsize > len(data):
                raise _short(element)
            if name in CORNERS:
                corners.append(np.frombuffer(data, kind, count, at))
                counts.append(count)
            at += count * kind.itemsize
    file.seek(start + at)
    return Content(corners=np.concatenate(corners), counts=np.array(counts, np.int64))


def _length(data: bytes, at: int, kind: str, element: Element) -> int:
    if at + np.dtype(kind).itemsize > len(data):
        raise _short(element)
    value = float(np.frombuffer(data, kind, 1, at)[0])
    if not 0 <= value <= LONGEST:
        raise ValueError(f"must hold lists of up to {LONGEST} numbers, got {value:g}; damaged?")
    return int(value)


def _short(element: Element) -> ValueError:
    return ValueError(f"must hold {element.count} of its {element.name!r}; is it cut short?")


def _text(file: IO[bytes], element: Element) -> Content:
    lines = _lines(file)
    lists = [name for name, _, length in element.properties if length is not None]
    corners = next((name for name in CORNERS if name in lists), None)
    if corners is not None:
        layout = {name: length is not None for name, _, length in element.properties}
        before = [is_list for name, is_list in layout.items()][: [*layout].index(corners)]
        polygons, counts = read_polygons(lines, element.count, before)
        return Content(corners=polygons, counts=counts)
    if lists or not element.count:
        passed = sum(1 for _ in islice(lines, element.count))
        if passed < element.count:
            raise _short(element)
        return Content()
    table = read_table(islice(lines, element.count), len(element.properties))
    if len(table) < element.count:
        raise _short(element)
    return Content({p[0]: x for p, x in zip(element.properties, table.T, strict=True)})


def _lines(file: IO[bytes]) -> Iterator[str]:
    for line in iter(file.readline, b""):
        if line.strip():
            yield line.decode("latin-1")


def _shape(contents: dict[str, Content]) -> RawShape:
    vertex, face = contents.get("vertex", Content()), contents.get("face", Content())
    if not {*AXES} <= {*vertex}:
        raise ValueError("must have an element `vertex` with x, y and z")
    positions = side_by_side(vertex[name] for name in AXES)
    normals, uv = _columns(vertex, (NORMAL,)), _columns(vertex, COORDINATES)
    colours = next((names for names in COLOURS if {*names} <= {*vertex}), None)
    beside = {
        "normals": None if normals is None else unit_normals(normals),
        "colours": colours and bytes_of_colours(np.stack([vertex[name] for name in colours], 1)),
    }
    if len(face.get("counts", ())) == 0:
        return RawShape(points=positions, **beside)
    faces = fans(face["corners"], face["counts"])
    return RawShape(vertices=positions, faces=faces, uv=uv, **beside)


def _columns(vertex: Content, choices: tuple[tuple[str, ...], ...]) -> NDArray | None:
    """The first of the choices whose columns are all there, side by side."""
    names = next((names for names in choices if {*names} <= {*vertex}), None)
    return None if names is None else side_by_side(vertex[name] for name in names)
