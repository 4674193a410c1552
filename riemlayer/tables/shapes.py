"""Meshes to evaluation shapes: watertight, remeshed, in the cube, with the truth of both maps.

Every shape is one file `<group>/<name>.npz` with the arrays of `evaluate.Shape`. Lengths are in
the unit of the cube [-1, 1]^3 that the mesh fills.
"""

from __future__ import annotations

import json
import os
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from riemlayer.data.prepare import Content, find_meshes, procedural_sample, run
from riemlayer.data.sample_file import RECIPE, remove_stale
from riemlayer.tables.run import write_json
from riemlayer.tables.truth import INPUTS, cloud, shape_arrays

FIRST_SEED = 1_100_000
"""Of the procedural shapes; training draws seeds below 1,000,000."""
THIN = ("hand", "humanoid", "sheet", "garment", "spectacles", "cutlery", "insect", "tray")
"""Kinds with what is hardest to tell apart from points (appendix H): fingers, wrists, sheets whose
two sides are closer than a cell."""
Jobs = dict[tuple[str, str], tuple[str, Callable[[], Content]]]
"""By group and name: the name of the record, and what computes it."""


@dataclass(frozen=True)
class Preparation:
    """What a run did."""

    written: int
    """Files."""
    skipped: int
    """Files that were there already."""
    failures: dict[str, str]
    """Reasons by "group/name" of the meshes that gave no shape, the content of failures.json."""


def prepare_shapes(
    folder: str | Path,
    out: str | Path,
    sources: int = 10,
    seed: int = 0,
    inputs: Sequence[str] = ("remeshed",),
    workers: int = 1,
) -> Preparation:
    """Prepares every mesh below `folder` for evaluation (ours).

    The group of a mesh is its top folder below `folder`, or "meshes"; `remeshed` clouds go to
    `out/<group>/<name>.npz`, the others to `out/<group>-<input>/<name>.npz` with the same truth.
    A run that was cut off goes on where it stopped; meshes that failed are tried again. What was
    computed once stays in `out/.records`, so that further inputs cost nothing; it may be deleted.

    Args:
        folder: any meshes (.obj .off .ply .stl .glb .gltf .dae); nothing is written to it.
        out: folder of the shapes.
        sources: P, random vertices of each shape.
        seed: every draw depends on it and on the names of group and mesh alone.
        inputs: among `INPUTS`.
        workers: processes.

    Raises:
        ValueError: `folder` holds no mesh, an input is unknown, two meshes have one name, or `out`
            holds another mesh, or other sources, under the name of one of these.
        OSError: `out` cannot be written (a full disk); every finished file stays valid.
    """
    places = [(path, *_place(path.relative_to(folder))) for path in sorted(find_meshes(folder))]
    same = Counter((group, name) for _, group, name in places)
    jobs: Jobs = {}
    for path, group, name in places:
        label = group, name if same[group, name] == 1 else name + path.suffix
        if label in jobs:
            raise ValueError(f"meshes must differ in name, {path} repeats {'/'.join(label)}")
        job = partial(_mesh_record, path, label, sources, _seed(seed, *label))
        jobs[label] = f"{'--'.join(label)}--{_fingerprint(path):08x}", job
    return _prepare(jobs, Path(out), f"{sources}-sources-seed-{seed}", inputs, workers)


def procedural_shapes(
    n: int,
    out: str | Path,
    seed: int = FIRST_SEED,
    sources: int = 10,
    inputs: Sequence[str] = ("remeshed",),
    workers: int = 1,
    kinds: Sequence[str] = (),
    group: str = "procedural",
) -> Preparation:
    """Makes n procedural shapes for evaluation, `out/<group>/<kind>-<seed>.npz` (ours).

    Args:
        n: number of shapes.
        out, sources, inputs, workers: as for `prepare_shapes`.
        seed: of the first shape; each shape depends on its own seed and kind alone.
        kinds: of the shapes, in turn, such as `THIN`; drawn by the seeds where there are none.
        group: of the shapes.

    Raises:
        ValueError: `seed` is below `FIRST_SEED`, and training may have seen such shapes.
    """
    if seed < FIRST_SEED:
        raise ValueError(f"seed must be at least {FIRST_SEED} (training uses others), got {seed}")
    jobs: Jobs = {}
    for i in range(n):
        kind = kinds[i % len(kinds)] if kinds else None
        job = partial(_procedural_record, seed + i, sources, kind, group)
        jobs[group, str(seed + i)] = f"{group}--{seed + i}", job
    return _prepare(jobs, Path(out), f"{sources}-sources", inputs, workers)


def _place(path: Path) -> tuple[str, str]:
    """Group and name of a mesh from its path below the folder."""
    parts = path.with_suffix("").parts
    group, rest = (parts[0], parts[1:]) if len(parts) > 1 else ("meshes", parts)
    return _clean(group), _clean("-".join(rest))


def _clean(text: str) -> str:
    return re.sub(r"[^\w.-]", "_", text)


def _fingerprint(path: Path) -> int:
    """Of the file's content; 0 where it cannot be read, which its job will say."""
    try:
        return zlib.crc32(path.read_bytes())
    except OSError:
        return 0


def _seed(*words: object) -> int:
    return zlib.crc32("/".join(map(str, words)).encode())


def _mesh_record(path: Path, label: tuple[str, str], sources: int, seed: int) -> Content:
    from riemlayer.data.meshes import load_mesh, prepare_mesh

    mesh = prepare_mesh(*load_mesh(path), np.random.default_rng(seed))
    arrays = shape_arrays(mesh.vertices, mesh.faces, sources, seed)
    if mesh.soup is not None:
        arrays["soup"] = mesh.soup.astype(np.float32)
    return arrays, {"group": label[0], "shape": label[1], "seed": str(seed)}


def _procedural_record(seed: int, sources: int, kind: str | None, group: str) -> Content:
    sample, metadata = procedural_sample(seed, kind)
    arrays = shape_arrays(sample["vertices"], sample["faces"], sources, seed)
    if "soup" in sample:
        arrays["soup"] = sample["soup"]
    name = f"{metadata['kind']}-{seed}"
    return arrays, {"group": group, "shape": name, "seed": str(seed)}


def _prepare(
    jobs: Jobs,
    out: Path,
    settings: str,
    inputs: Sequence[str],
    workers: int,
) -> Preparation:
    """Records by the machinery of the training data, then a file an input."""
    if unknown := [name for name in inputs if name not in INPUTS]:
        raise ValueError(f"inputs must be among {', '.join(INPUTS)}, got {', '.join(unknown)}")
    records = out / ".records" / f"recipe-{RECIPE}-{settings}"
    failed = records / "failures.jsonl"
    failed.unlink(missing_ok=True)  # to try them again
    run(dict(jobs.values()), records, workers)
    labels = {record: "/".join(label) for label, (record, _) in jobs.items()}
    lines = failed.read_text("utf-8").splitlines() if failed.exists() else []
    failures = {labels[x["name"]]: x["reason"] for x in map(json.loads, lines)}
    write_json(out / "failures.json", _others(out / "failures.json", labels) | failures)
    written = skipped = 0
    for record in labels:
        path = records / f"{record}.safetensors"
        for new in _write_inputs(path, out, inputs) if path.exists() else ():
            written, skipped = written + new, skipped + (not new)
    return Preparation(written, skipped, failures)


def _others(path: Path, labels: Mapping[str, str]) -> dict[str, str]:
    """Failures in `path` of shapes that are not among the values of `labels`."""
    kept = json.loads(path.read_text("utf-8")) if path.exists() else {}
    return {name: reason for name, reason in kept.items() if name not in set(labels.values())}


def _write_inputs(record: Path, out: Path, inputs: Sequence[str]) -> Iterator[bool]:
    """Writes the missing files of one record; for each input that it has: was it missing?"""
    from safetensors import safe_open

    with safe_open(record, "numpy") as file:
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        metadata = file.metadata()
    soup = arrays.pop("soup", None)
    for name in inputs:
        if name == "raw" and soup is None:
            continue
        group = metadata["group"] + ("" if name == "remeshed" else f"-{name}")
        path = out / group / f"{metadata['shape']}.npz"
        if path.exists():
            with np.load(path) as there:
                if not all(np.array_equal(there[x], arrays[x]) for x in ("V", "src")):
                    raise ValueError(
                        f"out holds another mesh or other sources as {path}: remove it"
                    )
            yield False
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_stale(path.parent)
        seed = _seed(metadata["seed"], name)
        points = soup if name == "raw" else cloud(name, arrays["V"], arrays["F"], seed)
        _write(path, arrays | {"points": points})
        yield True


def _write(path: Path, arrays: Mapping[str, Any]) -> None:
    """Through a temporary file, so that `path` is whole or not there."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            np.savez_compressed(file, **arrays)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
