"""NumPy archives (.npz)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from riemlayer.data.readers.record import RawShape, bytes_of_colours, unit_normals

MESH = (("vertices", "faces"), ("V", "F"))


def read_npz(path: Path) -> RawShape:
    """`points`, or `vertices` and `faces` (also `V` and `F`), or all three in one frame.

    `normals`, `colours` (also `colors`), `uv` and `unit` are taken where they fit.
    """
    with np.load(path, allow_pickle=False) as data:
        names = list(data)
        mesh = next((pair for pair in MESH if {*pair} <= {*names}), None)
        if mesh is None and "points" not in names:
            raise ValueError(f"must hold `points`, or `vertices` and `faces`, got {names}")
        points = _numbers(data, "points") if "points" in names else None
        vertices = faces = None
        if mesh is not None:
            vertices, faces = _numbers(data, mesh[0]), _whole(_numbers(data, mesh[1]))
        rows = len(points if points is not None else vertices)  # pyright: ignore[reportArgumentType]
        colours = _beside(data, rows, "colours") or _beside(data, rows, "colors")
        normals, uv = _beside(data, rows, "normals"), _beside(data, rows, "uv")
        unit = str(data["unit"]) if "unit" in names and data["unit"].dtype.kind == "U" else None
    return RawShape(
        points,
        vertices,
        faces,
        normals=None if normals is None else unit_normals(normals[0]),
        colours=None if colours is None else bytes_of_colours(colours[0]),
        uv=None if uv is None or points is not None else uv[0].astype(float),
        unit=unit,
    )


def _numbers(data, name: str) -> NDArray:
    x = data[name]
    if x.dtype.kind not in "fiu":
        raise ValueError(f"must hold numbers in `{name}`, got {x.dtype}")
    return x.astype(float)


def _whole(faces: NDArray) -> NDArray[np.int64]:
    if not (np.isfinite(faces).all() and (faces == np.round(faces)).all()):
        raise ValueError("must hold whole numbers in its faces")
    if np.abs(faces).max(initial=0) > 1 << 53:
        raise ValueError("must hold faces that index its vertices, got larger numbers")
    return faces.astype(np.int64)


def _beside(data, rows: int, name: str) -> tuple[NDArray] | None:
    """The array of that name, if it has a row of numbers for each point."""
    width = 2 if name == "uv" else 3
    if name not in data or data[name].dtype.kind not in "fiu":
        return None
    x = data[name]
    return (x,) if x.ndim == 2 and len(x) == rows and x.shape[1] >= width else None
