"""`riemlayer prepare`."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from riemlayer.cli.command import Answer, command
from riemlayer.cli.errors import UserError

PANEL = "Training and evaluation"
Folder = Annotated[Path, typer.Option("--out", "-o", help="Folder to write to.", metavar="DIR")]


def register(app: typer.Typer) -> None:
    """Adds the subcommand."""
    command(app, "riemlayer prepare MESHES -o DIR --workers 2", PANEL, bar=False)(prepare)


def prepare(
    out: Folder,
    meshes: Annotated[
        list[Path] | None,
        typer.Argument(help="Mesh files, or folders of them.", show_default=False),
    ] = None,
    procedural: Annotated[
        int | None,
        typer.Option(help="Make this many procedural shapes instead.", min=1, show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the first procedural shape.", min=0)] = 0,
    workers: Annotated[int, typer.Option(help="Processes.", min=1)] = 2,
    cluster: Annotated[
        str | None,
        typer.Option(
            help="Run on a cluster instead: ray, ray://HOST:PORT, or tcp://HOST:PORT of Dask.",
            show_default=False,
        ),
    ] = None,
    shards: Annotated[
        int | None,
        typer.Option(
            help="Then pack all samples of DIR into DIR/shards, this many a shard.",
            min=1,
            show_default=False,
        ),
    ] = None,
) -> Answer:
    """Training data: watertight, remeshed shapes with traced geodesics (Sec. 4.1).

    A run that stopped is continued by the same call. Shapes that cannot be prepared are named, with
    the reason, in failures.jsonl. DIR/shards is what many machines read: few, large files and
    manifest.jsonl, a line a shape.
    """
    from riemlayer.data.prepare import prepare_meshes, prepare_procedural

    if bool(meshes) == (procedural is not None):
        raise UserError("meshes: give mesh files or folders, or --procedural N")
    check_folder(out, *(meshes or ()))
    paths = find(meshes or ())
    try:
        if procedural is not None:
            report = prepare_procedural(procedural, seed, out, workers, cluster)
        else:
            report = prepare_meshes(paths, out, workers, None, cluster)
    except ValueError as error:
        raise UserError(str(error)) from error
    facts = {"out": str(out), **vars(report)}
    if report.failed and not (report.written or report.skipped):
        raise UserError(
            f"{out}/failures.jsonl: none of {report.failed} shapes could be prepared, the first: "
            f"{first_failure(out)}"
        )
    text = f"{out}: {report.written} written, {report.skipped} already there"
    failed = f", {report.failed} failed (reasons in failures.jsonl)" if report.failed else ""
    if shards is None:
        return Answer(facts, text + failed)
    packed = shard(out, shards)
    packed_text = f"\n{out}/shards: {packed['samples']} samples in {packed['shards']} shards"
    return Answer(facts | {"packed": packed}, text + failed + packed_text)


def find(meshes: Iterable[Path]) -> list[Path]:
    """Mesh files, those named and those in folders."""
    from riemlayer.data.prepare import find_meshes

    paths: list[Path] = []
    for path in meshes:
        if not path.exists():
            raise UserError(f"{path} does not exist; check the name and the folder")
        try:
            paths += find_meshes(path) if path.is_dir() else [path]
        except ValueError as error:
            raise UserError(str(error)) from error
    return paths


def shard(out: Path, size: int) -> dict[str, Any]:
    """Packs the samples of a folder into its subfolder `shards`."""
    from riemlayer.data.shards import pack

    try:
        return vars(pack(out, out / "shards", size))
    except ValueError as error:
        raise UserError(str(error)) from error


def first_failure(folder: Path) -> str:
    """Reason of the first line of failures.jsonl."""
    line = (folder / "failures.jsonl").read_text("utf-8").splitlines()[0]
    return "{name}: {reason}".format(**json.loads(line))


def check_folder(out: Path, *inputs: Path) -> None:
    """Refuses a folder to write to that is a file, or one of the inputs."""
    if out.exists() and not out.is_dir():
        raise UserError(f"--out {out} is a file; name a folder")
    if any(path.is_dir() and out.is_dir() and path.samefile(out) for path in inputs):
        raise UserError(f"--out {out} is an input, which is never written to; name another")
