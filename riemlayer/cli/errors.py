"""What goes wrong, in one line: whose fault it is, what was named, and the mend."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

EXTRAS = {
    "data": [
        *("scipy", "trimesh", "potpourri3d", "gpytoolbox", "skimage"),
        *("mesh2sdf", "manifold3d", "joblib", "tqdm"),
    ],
    "viz": ["pyvista", "vtk", "matplotlib", "PIL"],
    "cli": ["lightning", "jsonargparse", "psutil"],
    "scale": ["ray", "distributed", "webdataset", "cloudpickle"],
    "deploy": ["onnx", "onnxscript", "onnxruntime"],
}
"""Packages that each extra of riemlayer brings, by the names they are imported by."""


class UserError(Exception):
    """Input that cannot be used; the message names the file or argument and the mend."""


@contextmanager
def blame(what: object) -> Iterator[None]:
    """What the library refuses inside is the user's input `what`.

    >>> with blame("--size"):
    ...     raise ValueError("size must be positive")
    Traceback (most recent call last):
    riemlayer.cli.errors.UserError: --size: size must be positive
    """
    try:
        yield
    except (ValueError, TypeError) as error:
        raise UserError(f"{what}: {error}") from error


def judge(error: BaseException) -> tuple[int, str]:
    """Exit code and one line for anything that was raised: 2 the user's, 1 a failure of ours."""
    code, message = 1, f"internal error, {type(error).__name__}: {error}"
    if isinstance(error, UserError):
        code, message = 2, str(error)
    elif hasattr(error, "format_message"):  # typer's own, whose class moved between its versions
        path = getattr(getattr(error, "ctx", None), "command_path", "riemlayer")
        code, message = 2, f"{error.format_message().rstrip('.')}; see {path} --help"  # pyright: ignore
    elif isinstance(error, ModuleNotFoundError) and (extra := _extra_of(error)):
        code, message = 2, f'needs {error.name}: pip install "riemlayer[{extra}]"'
    elif isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        code, message = 2, f"{where}{error.strerror or error}"
    else:
        message += "; please report it with what --debug prints"
    return code, " ".join(message.split())


def _extra_of(error: ModuleNotFoundError) -> str | None:
    package = (error.name or "").split(".")[0]
    return next((extra for extra, names in EXTRAS.items() if package in names), None)
