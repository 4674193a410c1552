"""NumPy archives (.npz)."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from riemlayer.data.readers.record import RawShape, bytes_of_colours, unit_normals

MESH = (("vertices", "faces"), ("V", "F"))


def read_npz(path: Path) -> RawShape:
    """`points`, or `vertices` and `faces` (also `V` and `F`), or all three in one frame.

    `normals`, `colours` (also `colors`), `uv` and `unit` are taken where they fit.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            arrays = dict(data)
    except (OSError, EOFError, zipfile.BadZipFile, zlib.error, AttributeError, TypeError) as error:
        said = str(error) or type(error).__name__
        raise ValueError(f"must be an archive of numpy.savez, it is damaged: {said}") from error
    names = list(arrays)
    mesh = next((pair for pair in MESH if {*pair} <= {*names}), None)
    if mesh is None and "points" not in names:
        raise ValueError(f"must hold `points`, or `vertices` and `faces`, got {names}")
    points = _numbers(arrays, "points") if "points" in names else None
    vertices = faces = None
    if mesh is not None:
        vertices, faces = _numbers(arrays, mesh[0]), _whole(_numbers(arrays, mesh[1]))
    rows = len(points if points is not None else vertices)  # pyright: ignore[reportArgumentType]
    colours = _beside(arrays, rows, "colours")
    colours = _beside(arrays, rows, "colors") if colours is None else colours
    normals, uv = _beside(arrays, rows, "normals"), _beside(arrays, rows, "uv")
    unit = arrays.get("unit")
    return RawShape(
        points,
        vertices,
        faces,
        normals=None if normals is None else unit_normals(normals),
        colours=None if colours is None else bytes_of_colours(colours),
        uv=None if uv is None or points is not None else uv.astype(float),
        unit=None if unit is None or unit.dtype.kind != "U" else str(unit),
    )


def _numbers(arrays: dict[str, NDArray], name: str) -> NDArray:
    x = arrays[name]
    if x.dtype.kind not in "fiu":
        raise ValueError(f"must hold numbers in `{name}`, got {x.dtype}")
    return x.astype(float)


def _whole(faces: NDArray) -> NDArray[np.int64]:
    if not (np.isfinite(faces).all() and (faces == np.round(faces)).all()):
        raise ValueError("must hold whole numbers in its faces")
    if np.abs(faces).max(initial=0) > 1 << 53:
        raise ValueError("must hold faces that index its vertices, got larger numbers")
    return faces.astype(np.int64)


def _beside(arrays: dict[str, NDArray], rows: int, name: str) -> NDArray | None:
    """The array of that name, if it has a row of numbers for each point."""
    x, width = arrays.get(name), 2 if name == "uv" else 3
    if x is None or x.dtype.kind not in "fiu" or x.ndim != 2 or len(x) != rows:
        return None
    return x if x.shape[1] >= width and np.isfinite(x).all() else None
