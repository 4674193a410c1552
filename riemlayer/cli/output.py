"""Where an answer goes: checked before anything is computed, written whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from riemlayer.cli.command import Options
from riemlayer.cli.errors import UserError
from riemlayer.cli.formats import Geometry, write_npz, write_obj, write_ply
from riemlayer.cli.options import Force, Out
from riemlayer.cli.progress import stage

if TYPE_CHECKING:
    from riemlayer.cli.pictures import Scene

SUFFIXES = (".npz", ".ply", ".obj", ".png", ".html")


@dataclass(frozen=True)
class Result:
    """An answer in every form that it can be written in."""

    arrays: dict[str, np.ndarray]
    """Of an .npz."""
    geometry: Geometry
    """Of a .ply or .obj."""
    scene: Callable[[], Scene]
    """Of a .png or .html."""


@dataclass(frozen=True)
class Output(Options):
    """The file that a subcommand writes."""

    out: Out
    force: Force = False

    def check(self, *inputs: Path | None) -> None:
        """Refuses what could not be written, or what the user gave as input."""
        suffix = self.out.suffix.lower()
        if suffix not in SUFFIXES:
            raise UserError(f"--out must end in one of {' '.join(SUFFIXES)}, got {self.out}")
        check_target(self.out, self.force, *inputs)

    def write(self, result: Result) -> None:
        """Writes in the form that the suffix names."""
        stage(f"writing {self.out.name}")
        with whole_file(self.out) as path:
            match self.out.suffix.lower():
                case ".npz":
                    write_npz(path, result.arrays)
                case ".ply":
                    write_ply(path, result.geometry)
                case ".obj":
                    write_obj(path, result.geometry)
                case _:
                    from riemlayer.cli.pictures import write_scene

                    write_scene(path, result.scene())


def check_target(out: Path, force: bool, *inputs: Path | None, option: str = "--out") -> None:
    """Refuses a file that is an input, exists, or has no folder to be in."""
    for path in inputs:
        if path is not None and path.exists() and out.exists() and path.samefile(out):
            raise UserError(f"{option} {out} is an input, which is never written to; name another")
    if out.is_dir():
        raise UserError(f"{option} {out} is a folder; name a file in it")
    if out.exists() and not force:
        raise UserError(f"{option} {out} exists; name another file, or replace it with --force")
    if not out.absolute().parent.is_dir():
        raise UserError(f"{option} {out}: its folder does not exist; make it with mkdir -p")
    if not os.access(out.absolute().parent, os.W_OK):
        raise UserError(f"{option} {out}: its folder may not be written to; name another")


@contextmanager
def whole_file(out: Path) -> Iterator[Path]:
    """A hidden file beside `out` that takes its place if the body succeeds, else vanishes."""
    path = out.with_name(f".{out.stem}.{os.getpid()}{out.suffix}")
    try:
        yield path
        os.replace(path, out)
    except BaseException:
        path.unlink(missing_ok=True)
        raise


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """A hidden folder beside `out` that takes its place if the body succeeds, else vanishes."""
    path = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        path.mkdir()
        yield path
        os.replace(path, out)
    except BaseException:
        shutil.rmtree(path, ignore_errors=True)
        raise
