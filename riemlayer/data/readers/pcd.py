"""PCD files of the Point Cloud Library: text, binary and compressed binary (ours)."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from riemlayer.data.readers.columns import read_table
from riemlayer.data.readers.record import (
    RawShape,
    bytes_of_colours,
    side_by_side,
    unit_normals,
)

KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS")
KINDS = {"F": "f", "I": "i", "U": "u"}
MOST = 1 << 40


def read_pcd(path: Path) -> RawShape:
    """A cloud with its normals and colours; rows without a measurement are left out and counted.

    Such rows (NaN) are allowed in organised clouds alone (HEIGHT above 1), where they are the
    format's way to say that a pixel saw nothing.
    """
    with path.open("rb") as file:
        header = _header(file)
        dtype, count = _dtype(header), _count(header)
        match header["DATA"]:
            case ["ascii"]:
                columns = _text(file, dtype, count)
            case ["binary"]:
                columns = _binary(path, file.tell(), dtype, count)
            case ["binary_compressed"]:
                columns = _compressed(file, dtype, count)
            case other:
                raise ValueError(f"must hold ascii or binary data, its header says {other}")
    return _shape(columns, organised=_whole(header, "HEIGHT") > 1)


def _header(file: IO[bytes]) -> dict[str, list[str]]:
    header = {}
    for line in iter(lambda: file.readline(1 << 16), b""):
        words = line.decode("latin-1").split()
        if not words or words[0].startswith("#"):
            continue
        key = "FIELDS" if words[0] == "COLUMNS" else words[0]
        header[key] = words[1:]
        if key == "DATA":
            missing = [k for k in ("FIELDS", "SIZE", "TYPE", "WIDTH") if k not in header]
            if missing:
                raise ValueError(f"must have a PCD header, {missing[0]} is missing")
            return header
        if key not in KEYS:
            break
    raise ValueError("must have a PCD header that ends with DATA; is it cut short?")


def _whole(header: dict[str, list[str]], key: str) -> int:
    match header.get(key, ["1"]):
        case [word] if word.isascii() and word.isdecimal() and int(word) < MOST:
            return int(word)
        case words:
            raise ValueError(f"must have a PCD header with one number for {key}, got {words[:4]}")


def _count(header: dict[str, list[str]]) -> int:
    count = _whole(header, "WIDTH") * _whole(header, "HEIGHT")
    if "POINTS" in header and _whole(header, "POINTS") != count:
        raise ValueError(f"must have POINTS = WIDTH * HEIGHT = {count}, got {header['POINTS'][0]}")
    return count


def _dtype(header: dict[str, list[str]]) -> np.dtype:
    names = header["FIELDS"]
    counts = header.get("COUNT", ["1"] * len(names))
    rows = (header["SIZE"], header["TYPE"], counts)
    if any(len(row) != len(names) for row in rows) or not names:
        raise ValueError("must give one SIZE, TYPE and COUNT for each of its FIELDS")
    fields = []
    for i, (name, size, kind, count) in enumerate(zip(names, *rows, strict=True)):
        whole = count.isascii() and count.isdecimal() and 0 < int(count) <= 1 << 16
        if kind not in KINDS or size not in ("1", "2", "4", "8") or (kind, size) == ("F", "1"):
            raise ValueError(
                f"must use types of PCD, its header says {kind[:9]} of {size[:9]} bytes"
            )
        if not whole:
            raise ValueError(f"must give a COUNT of at least 1 for each field, got {count[:20]!r}")
        known = {field[0] for field in fields}
        label = name if name not in known and name != "_" else f"_{i}"
        fields.append((label, f"<{KINDS[kind]}{size}", (int(count),)))
    return np.dtype(fields)


def _text(file: IO[bytes], dtype: np.dtype, count: int) -> dict[str, NDArray]:
    lines = (line.decode("latin-1") for line in iter(file.readline, b"") if line.strip())
    table = read_table(islice(lines, count + 1))
    width = sum(dtype[name].shape[0] for name in dtype.names or ())
    if table.shape != (count, width):
        raise ValueError(
            f"must hold {count} points of {width} numbers, got {table.shape}; is it cut short?"
        )
    columns, at = {}, 0
    for name in dtype.names or ():
        values = table[:, at : at + 1]
        packed = name in ("rgb", "rgba") and dtype[name].base.kind == "f"
        columns[name] = values.astype(np.float32) if packed else values
        at += dtype[name].shape[0]
    return columns


def _binary(path: Path, start: int, dtype: np.dtype, count: int) -> dict[str, NDArray]:
    left = path.stat().st_size - start
    if not 0 <= left - count * dtype.itemsize < dtype.itemsize or not count:
        raise _wrong(count, dtype, left)
    data = np.memmap(path, dtype, "r", start, (count,))
    return {name: data[name] for name in dtype.names or ()}


def _compressed(file: IO[bytes], dtype: np.dtype, count: int) -> dict[str, NDArray]:
    sizes = np.frombuffer(file.read(8), "<u4")
    if len(sizes) != 2:
        raise ValueError("must hold two sizes before its compressed data; is it cut short?")
    packed, whole = (int(x) for x in sizes)
    data = file.read(packed)
    if len(data) < packed or whole != count * dtype.itemsize:
        raise _wrong(count, dtype, min(whole, len(data)))
    data, at, columns = expand_lzf(data, whole), 0, {}
    for name in dtype.names or ():
        field = dtype[name]
        columns[name] = np.frombuffer(data, field.base, count * field.shape[0], at)
        columns[name] = columns[name].reshape(count, field.shape[0])
        at += count * field.itemsize
    return columns


def _wrong(count: int, dtype: np.dtype, got: int) -> ValueError:
    need = count * dtype.itemsize
    return ValueError(f"must hold {count} points in {need} bytes, got {got}; is it cut short?")


def expand_lzf(data: bytes, size: int) -> bytes:
    """Data packed by LZF: runs of literals, and copies from up to 8 KB back.

    >>> expand_lzf(b"\\x02abc\\xa0\\x02", 10)
    b'abcabcabca'

    Raises:
        ValueError: it is damaged, or not `size` bytes long.
    """
    out, at = bytearray(), 0
    while at < len(data) and len(out) <= size:
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        tail = data[at : at + 1 + (length == 7)]
        at += len(tail)
        if len(tail) < 1 + (length == 7):
            break
        length += 2 + (tail[0] if length == 7 else 0)
        start = len(out) - ((control & 31) << 8) - tail[-1] - 1
        if start < 0:
            break
        period = out[start : start + length]
        out += (period * (length // len(period) + 1))[:length]
    if len(out) != size or at != len(data):
        raise ValueError(f"must unpack to {size} bytes, got {len(out)}; the file is damaged")
    return bytes(out)


def _shape(columns: dict[str, NDArray], organised: bool) -> RawShape:
    if not {"x", "y", "z"} <= {*columns}:
        raise ValueError(f"must have the fields x, y and z, got {[*columns][:9]}")
    points = side_by_side(columns[k][:, 0] for k in "xyz")
    seen = slice(None)
    if organised and not np.isfinite(points).all():
        seen = np.isfinite(points).all(1)
    normals = colours = None
    names = [f"normal_{k}" for k in "xyz"]
    if {*names} <= {*columns}:
        normals = unit_normals(side_by_side(columns[k][:, 0] for k in names)[seen])
    for name in ("rgb", "rgba"):
        if name in columns:
            colours = _unpack(columns[name][:, 0])[seen]
    kept = points[seen]
    return RawShape(points=kept, normals=normals, colours=colours, missing=len(points) - len(kept))


def _unpack(packed: NDArray) -> NDArray[np.uint8]:
    """Colours (N, 3) of three bytes in one number: an integer, or the bits of a float."""
    bits = packed.astype("<f4").view("<u4") if packed.dtype == np.float32 else packed
    bits = bits.astype(np.int64)[:, None] >> np.array([16, 8, 0])
    return bytes_of_colours((bits & 255).astype(np.uint8))
