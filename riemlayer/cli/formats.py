"""Writers of .npz, .ply and .obj: numpy alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Geometry:
    """Points with what lies on them, in the file's units."""

    points: Array
    """(n, 3)"""
    faces: NDArray[np.int64] | None = None
    """(m, 3)"""
    lines: Sequence[NDArray[np.int64]] = ()
    """Polylines, as indices of points."""
    uv: Array | None = None
    """(n, 2) texture coordinates: the picture is [0, 1]^2."""
    colours: Array | None = None
    """(n, 3) in [0, 1]."""
    scalars: Mapping[str, NDArray] = field(default_factory=dict)
    """(n,) further columns of a .ply, by name."""


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Arrays by name."""
    with open(path, "wb") as file:
        np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]


def write_ply(path: Path, geometry: Geometry) -> None:
    """Binary PLY: x y z, then s t, red green blue and the scalars where there are any.

    Coordinates are single precision where that holds them exactly, else double.
    """
    x = geometry.points
    single = bool((x == x.astype("f4")).all())
    columns: list[tuple[str, np.ndarray]] = [
        (name, x[:, i].astype("f4" if single else "f8")) for i, name in enumerate("xyz")
    ]
    if geometry.uv is not None:
        columns += [(name, geometry.uv[:, i].astype("f4")) for i, name in enumerate("st")]
    if geometry.colours is not None:
        shades = (255 * geometry.colours).round().astype("u1")
        columns += [(name, shades[:, i]) for i, name in enumerate(("red", "green", "blue"))]
    columns += [(name, value.astype("f4")) for name, value in geometry.scalars.items()]
    vertices = _records(columns)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(x)}"]
    kinds = {"f4": "float", "f8": "double", "u1": "uchar"}
    header += [f"property {kinds[value.dtype.str[1:]]} {name}" for name, value in columns]
    faces = edges = b""
    if geometry.faces is not None:
        header += [f"element face {len(geometry.faces)}"]
        header += ["property list uchar int vertex_indices"]
        corners = geometry.faces.astype("i4")
        three = np.full(len(corners), 3, "u1")
        faces = _records([("n", three), *((c, corners[:, i]) for i, c in enumerate("abc"))])
    if geometry.lines:
        pairs = np.concatenate([np.stack((k[:-1], k[1:]), 1) for k in geometry.lines])
        header += [f"element edge {len(pairs)}"]
        header += ["property int vertex1", "property int vertex2"]
        edges = pairs.astype("<i4").tobytes()
    with open(path, "wb") as file:
        file.write("\n".join([*header, "end_header\n"]).encode())
        for part in (vertices, faces, edges):
            file.write(part)


def _records(columns: Sequence[tuple[str, np.ndarray]]) -> bytes:
    """Rows of the columns, packed, little-endian."""
    dtype = np.dtype([(name, value.dtype.newbyteorder("<")) for name, value in columns])
    rows = np.empty(len(columns[0][1]), dtype)
    for name, value in columns:
        rows[name] = value
    return rows.tobytes()


def write_obj(path: Path, geometry: Geometry) -> None:
    """Wavefront OBJ: v, vt where there are texture coordinates, f, l, and p of bare points."""
    x, uv = geometry.points, geometry.uv
    lines = ["# riemlayer", *(f"v {a!r} {b!r} {c!r}" for a, b, c in x.tolist())]
    if uv is not None:
        lines += [f"vt {a:.9g} {b:.9g}" for a, b in uv.tolist()]
    corner = "{0}" if uv is None else "{0}/{0}"
    if geometry.faces is not None:
        form = f"f {corner} {corner.replace('0', '1')} {corner.replace('0', '2')}"
        lines += [form.format(*row) for row in (geometry.faces + 1).tolist()]
    for line in geometry.lines:
        lines.append(" ".join(["l", *(corner.format(i) for i in (line + 1).tolist())]))
    if geometry.faces is None and not geometry.lines:
        lines += [f"p {i}" for i in range(1, len(x) + 1)]
    path.write_text("\n".join(lines) + "\n", "utf-8")
