"""Arrays that the user hands over in .npy files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from riemlayer.cli.errors import UserError


def read_array(path: Path) -> NDArray:
    """A finite array of numbers from an .npy file."""
    if path.is_dir():
        raise UserError(f"{path} is a folder; name an .npy file")
    if not path.is_file():
        raise UserError(f"{path} does not exist; check the name and the folder")
    try:
        with open(path, "rb") as file:
            array = np.lib.format.read_array(file, allow_pickle=False)
    except (ValueError, EOFError, OSError, MemoryError, OverflowError) as error:
        reason = " ".join(str(error).split())[:200]
        raise UserError(
            f"{path}: must be a whole .npy file, as np.save writes: {reason}"
        ) from error
    if array.dtype.kind not in "fiu":
        raise UserError(f"{path}: must hold numbers, got {array.dtype}")
    if array.size == 0:
        raise UserError(f"{path}: must hold at least one row, got shape {array.shape}")
    if not np.isfinite(array).all():
        raise UserError(f"{path}: must hold finite numbers; remove NaN and infinity")
    return array


def read_vectors(path: Path) -> NDArray[np.float64]:
    """(K, 3) or (K, 2) vectors; one vector may come without its first axis."""
    x = np.atleast_2d(read_array(path)).astype(float)
    if x.ndim != 2 or x.shape[1] not in (2, 3):
        raise UserError(f"{path}: must hold vectors of shape (K, 3) or (K, 2), got {x.shape}")
    return x


def read_image(path: Path) -> NDArray[np.float64]:
    """(rows, columns, 3) colours in [0, 1] of a picture, its first row on top."""
    from PIL import Image

    if not path.is_file():
        raise UserError(f"{path} is no file; name a picture")
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"), float) / 255
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise UserError(f"{path}: must be a whole picture such as .png or .jpg: {error}") from error
