"""Formats that trimesh reads: .stl, .glb, .gltf and .dae, scenes merged into one mesh."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from riemlayer.data.readers.record import RawShape, bytes_of_colours

METRES = (".glb", ".gltf")
"""Formats whose standard says that lengths are metres."""


def read_scene(path: Path) -> RawShape:
    """All meshes of a scene, placed and merged; or its points where it has no face.

    Vertices of an .stl, which names none, are those of its triangles without repetition.
    """
    trimesh = _trimesh(path)
    suffix = path.suffix.lower()
    if suffix == ".stl":
        _check_solids(path)
    try:
        with warnings.catch_warnings(), _silent(trimesh.util.log):
            warnings.simplefilter("error")  # numpy warns where it stops parsing in the middle
            parts = trimesh.load_scene(path, process=False, skip_materials=True).dump()
    except Exception as error:  # trimesh raises whatever its parsers raise
        said = str(error) or type(error).__name__
        raise ValueError(
            f"must be a {suffix[1:]} file that trimesh reads, it said: {said}"
        ) from error
    meshes = [x for x in parts if isinstance(x, trimesh.Trimesh) and len(x.faces)]
    clouds = [x for x in parts if isinstance(x, trimesh.PointCloud) and len(x.vertices)]
    unit = "m" if suffix in METRES else None
    if not meshes:
        points = [np.asarray(x.vertices, float) for x in clouds]
        return RawShape(points=np.concatenate(points) if points else None, unit=unit)
    vertices = np.concatenate([np.asarray(x.vertices, float) for x in meshes])
    starts = np.cumsum([0] + [len(x.vertices) for x in meshes[:-1]])
    faces = np.concatenate(
        [np.asarray(x.faces, np.int64) + i for x, i in zip(meshes, starts, strict=True)]
    )
    if suffix == ".stl":
        vertices, inverse = np.unique(vertices, axis=0, return_inverse=True)
        return RawShape(vertices=vertices, faces=inverse.reshape(-1)[faces])
    return RawShape(
        vertices=vertices, faces=faces, colours=_colours(meshes), uv=_uv(meshes), unit=unit
    )


@contextmanager
def _silent(log: logging.Logger) -> Iterator[None]:
    """No tracebacks on the terminal for what is survived, or raised anyway."""
    disabled, log.disabled = log.disabled, True
    try:
        yield
    finally:
        log.disabled = disabled


def _trimesh(path: Path):
    try:
        import trimesh

        if path.suffix.lower() == ".dae":
            import collada  # noqa: F401  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        mend = "pip install pycollada" if error.name == "collada" else "pip install trimesh"
        raise ValueError(f"needs {error.name} to be read: {mend}") from error
    return trimesh


def _check_solids(path: Path) -> None:
    """trimesh leaves a solid of text out where the file ends in the middle of it."""
    with path.open("rb") as file:
        if file.read(5).lower() != b"solid":
            return
        file.seek(0)
        starts = ends = 0
        for line in file:
            word = line.strip().lower()
            starts, ends = starts + word.startswith(b"solid"), ends + word.startswith(b"endsolid")
    size = path.stat().st_size
    if starts != ends and (size - 84) % 50:  # else it is a binary file that begins with the word
        raise ValueError(f"must close its {starts} solids, {ends} are closed; is it cut short?")


def _colours(meshes: list) -> np.ndarray | None:
    if not all(x.visual.kind == "vertex" for x in meshes):
        return None
    return np.concatenate([bytes_of_colours(x.visual.vertex_colors) for x in meshes])


def _uv(meshes: list) -> np.ndarray | None:
    parts = [getattr(x.visual, "uv", None) for x in meshes]
    if any(uv is None or len(uv) != len(x.vertices) for uv, x in zip(parts, meshes, strict=True)):
        return None
    return np.concatenate([np.asarray(uv, float)[:, :2] for uv in parts])
