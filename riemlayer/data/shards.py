"""Prepared samples packed into shards: tar files in the format of WebDataset, with a manifest."""

from __future__ import annotations

import hashlib
import json
import tarfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open

from riemlayer.data.run_folder import only_run, read_failures
from riemlayer.data.sample_file import remove_stale, whole_or_not_at_all

MANIFEST = "manifest.jsonl"


@dataclass(frozen=True)
class Packed:
    """What `pack` left in its folder."""

    samples: int
    shards: int
    written: int
    """Shards that were not there yet, or whose samples had changed."""


def pack(folder: str | Path, out: str | Path, size: int = 64) -> Packed:
    """Packs a folder of samples, by name, into `shard-<i>.tar` and manifest.jsonl (ours).

    A line of the manifest is a shape: its name, source, kind, licence, counts, checksum, and where
    in which shard it lies; or its name and the reason of its failure. The same samples give the
    same bytes. A run that was stopped at any moment is continued by the same call; a folder has a
    manifest only when it is complete.

    Args:
        folder: written by `prepare`; not changed.
        out: folder, made where missing. Shards that hold their samples already are left alone.
        size: samples a shard.

    Raises:
        FileNotFoundError: there is no sample.
        FolderInUse: another run is writing to `out`.
        OSError: a shard cannot be written (a full disk); every finished shard stays valid.
        ValueError: a sample is truncated or corrupt; the message names it.
    """
    from tqdm import tqdm

    from riemlayer.data.dataset import sample_files

    if size < 1:
        raise ValueError(f"size must be at least 1 sample a shard, got {size}")
    folder, out = Path(folder), Path(out)
    files = sample_files(folder)
    groups = {
        out / f"shard-{i // size:06d}.tar": files[i : i + size] for i in range(0, len(files), size)
    }
    with only_run(out):
        remove_stale(out, age=0)
        other = [x for x in out.glob("shard-*") if x.with_suffix(".tar") not in groups]
        todo = [shard for shard, group in groups.items() if not _holds(shard, group)]
        if todo or other:
            (out / MANIFEST).unlink(missing_ok=True)
        for file in other:
            file.unlink()
        for shard in tqdm(todo, unit="shard", delay=2, disable=None):
            _write_shard(shard, groups[shard])
        _write_manifest(out, [*groups], folder, {x.stem for x in files})
    return Packed(len(files), len(groups), len(todo))


def _holds(shard: Path, files: Sequence[Path]) -> bool:
    """Whether a shard was made of these files as they are now, as `make` decides it."""
    lines = shard.with_suffix(".jsonl")
    if not (lines.exists() and shard.exists()):
        return False
    entries = [json.loads(line) for line in lines.read_text("utf-8").splitlines()]
    whole = shard.stat().st_size >= entries[-1]["offset"] + entries[-1]["bytes"]
    newest = max(file.stat().st_mtime_ns for file in files)
    same = [x["name"] for x in entries] == [file.stem for file in files]
    return whole and same and lines.stat().st_mtime_ns >= newest


def _write_shard(shard: Path, files: Sequence[Path]) -> None:
    """The tar file first, then the lines of its samples, without which it does not count."""
    from webdataset.writer import TarWriter

    lines = shard.with_suffix(".jsonl")
    lines.unlink(missing_ok=True)
    entries = []
    with whole_or_not_at_all(shard) as file:
        with TarWriter(file, user="", group="", mtime=0, encoder=False) as writer:
            for path in files:
                data = path.read_bytes()
                entries.append(_describe(path, data))
                key = path.stem.replace(".", "%2E")  # the suffix starts at the first dot
                writer.write({"__key__": key, "safetensors": data})
        file.seek(0)
        with tarfile.open(fileobj=file) as tar:
            for entry, member in zip(entries, tar.getmembers(), strict=True):
                entry |= {"shard": shard.name, "offset": member.offset_data}
    with whole_or_not_at_all(lines) as file:
        file.writelines(_line(entry) for entry in entries)


def _describe(path: Path, data: bytes) -> dict[str, Any]:
    try:
        with safe_open(path, framework="np") as file:
            metadata = file.metadata() or {}
            shape = {name: file.get_slice(name).get_shape() for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        message = f"sample file {path} is truncated or corrupt, delete it and prepare it again"
        raise ValueError(f"{message}: {error}") from error
    counts = {name: shape.get(name, [0])[0] for name in ("vertices", "faces")}
    counts |= dict(zip(("sources", "vectors"), shape.get("v", [0, 0])[:2], strict=True))
    known = {name: metadata.get(name, "") for name in ("source", "kind", "licence", "recipe")}
    checksum = hashlib.sha256(data).hexdigest()
    return {"name": path.stem, **known, **counts, "bytes": len(data), "sha256": checksum}


def _write_manifest(out: Path, shards: Sequence[Path], folder: Path, done: set[str]) -> None:
    failures = {n: reason for n, reason in read_failures(folder).items() if n not in done}
    with whole_or_not_at_all(out / MANIFEST) as file:
        for shard in shards:
            file.write(shard.with_suffix(".jsonl").read_bytes())
        file.writelines(_line({"name": n, "failed": why}) for n, why in failures.items())


def _line(entry: dict[str, Any]) -> bytes:
    return json.dumps(entry, ensure_ascii=False).encode() + b"\n"
