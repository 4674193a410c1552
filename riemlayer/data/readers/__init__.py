"""Any file with a shape in it becomes one `RawShape`, in the file's own units and order.

Text tables, PLY, PCD, OBJ, OFF and NPZ are read here, whole arrays at a time; STL, glTF and COLLADA
by trimesh.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from riemlayer.data.readers.archive import read_npz
from riemlayer.data.readers.columns import read_text_cloud
from riemlayer.data.readers.obj import read_obj
from riemlayer.data.readers.off import read_off
from riemlayer.data.readers.pcd import read_pcd
from riemlayer.data.readers.ply import read_ply
from riemlayer.data.readers.record import RawShape, checked
from riemlayer.data.readers.scene import read_scene

__all__ = ["SUFFIXES", "RawShape", "read_shape"]

READERS: dict[str, Callable[[Path], RawShape]] = {
    ".obj": read_obj,
    ".off": read_off,
    ".ply": read_ply,
    **dict.fromkeys((".stl", ".glb", ".gltf", ".dae"), read_scene),
    **dict.fromkeys((".xyz", ".pts", ".txt"), read_text_cloud),
    ".pcd": read_pcd,
    ".npz": read_npz,
}
SUFFIXES = tuple(READERS)
"""What file names may end in."""
MAGIC = {
    b"ply": ".ply",
    b"glTF": ".glb",
    b"PK\x03\x04": ".npz",
    b"# .PCD": ".pcd",
    b"OFF": ".off",
    b"COFF": ".off",
    b"NOFF": ".off",
    b"solid": ".stl",
}
"""How files of a format begin."""


def read_shape(path: str | Path) -> RawShape:
    """The cloud or mesh in a file, in its own units and order (ours).

    Args:
        path: .obj .off .ply .stl .glb .gltf .dae .xyz .pts .txt .pcd or .npz.

    Returns:
        A `RawShape`: `points` of a cloud, `vertices` and `faces` of a mesh, and what lay beside
        them. The meshes of a scene are placed and merged.

    Raises:
        OSError: the file is missing, a directory, or may not be read.
        ValueError: it holds no shape. Both in one line that names the file and a mend.

    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "a.xyz"
    >>> _ = file.write_text("x,y,z\\n0,0,0\\n1,0,0\\n0,1,0\\n0,0,1\\n")
    >>> read_shape(file).points.shape
    (4, 3)
    """
    path = Path(path)
    head = _head(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path}: must end in one of {' '.join(SUFFIXES)}{_hint(path, head)}")
    if not head:
        raise ValueError(f"{path}: is empty (0 bytes); write it again")
    try:
        with np.errstate(all="ignore"):  # what came of nonsense is refused by `checked`
            return checked(reader(path))
    except Exception as error:  # readers of damaged files raise whatever their parsers raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{path}: {reason}{_hint(path, head)}") from error


def _head(path: Path) -> bytes:
    """The first bytes of a file that can be read."""
    if path.is_dir():
        raise IsADirectoryError(
            f"{path}: path must name a file, this is a directory; name one in it"
        )
    if not path.is_file():
        raise FileNotFoundError(f"{path}: path must name a file, found none there")
    try:
        with path.open("rb") as file:
            return file.read(64)
    except PermissionError as error:
        raise PermissionError(f"{path}: may not be read; allow it with chmod u+r") from error


def _hint(path: Path, head: bytes) -> str:
    """What else the file may be, by its first bytes."""
    known = next((suffix for magic, suffix in MAGIC.items() if head.startswith(magic)), None)
    if known in (None, path.suffix.lower()):
        return ""
    return f" (its content begins like {known}: rename it?)"
