"""Prepares training samples in parallel; a run that stopped is continued by the same call.

python -m riemlayer.data.prepare --procedural 1000 --seed 0 -o DIR --workers 2
python -m riemlayer.data.prepare --meshes DIR -o DIR
"""

from __future__ import annotations

import argparse
import random
import re
import signal
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from riemlayer.data.cluster import cluster_results, died
from riemlayer.data.run_folder import drop_half_line, only_run, read_failures, record_failure
from riemlayer.data.sample_file import RECIPE, remove_stale, write_sample

MESH_SUFFIXES = (".obj", ".off", ".ply", ".stl", ".glb", ".gltf", ".dae")
SECONDS_A_SHAPE = 300
"""A worker that needs longer is ended; the shape counts as failed."""


@dataclass(frozen=True)
class Report:
    """What a run did."""

    written: int
    skipped: int
    """Finished, or recorded as failed, by an earlier run."""
    failed: int


def prepare_procedural(
    n: int, seed: int, out: str | Path, workers: int = 2, cluster: str | None = None
) -> Report:
    """Writes `procedural-<seed + i>.safetensors` for i < n into `out` (ours).

    Args:
        n: number of shapes.
        seed: of the first shape; each shape depends on its own seed alone.
        out: folder, made where missing. Finished files are not made again.
        workers: processes.
        cluster: where to run instead, see `riemlayer.data.cluster.connected`; all see `out`.

    Raises:
        OSError: the folder cannot be written (a full disk); every finished file stays valid.
        FolderInUse: another run is writing to `out`.
    """
    jobs = {f"procedural-{s:06d}": partial(procedural_sample, s) for s in range(seed, seed + n)}
    return run(jobs, Path(out), workers, cluster=cluster)


def prepare_meshes(
    paths: Iterable[str | Path],
    out: str | Path,
    workers: int = 2,
    licences: Mapping[str, str] | None = None,
    cluster: str | None = None,
) -> Report:
    """Writes `mesh-<folder>-<stem>.safetensors` for every mesh file into `out` (ours).

    Args:
        paths: mesh files, prepared in this order.
        out: folder, made where missing. Finished files are not made again.
        workers: processes.
        licences: licence of each folder's meshes, for the metadata.
        cluster: where to run instead, see `riemlayer.data.cluster.connected`; all see the files.

    Raises:
        OSError: the folder cannot be written (a full disk); every finished file stays valid.
        FolderInUse: another run is writing to `out`.
        ValueError: two files would have the same name.
    """
    jobs: dict[str, Callable[[], Content]] = {}
    for path in map(Path, paths):
        folder = path.resolve().parent.name
        name = re.sub(r"[^\w.-]", "_", f"mesh-{folder}-{path.stem}")
        if name in jobs:
            raise ValueError(f"paths must differ in folder or stem, {path} repeats {name}")
        jobs[name] = partial(mesh_sample, path.absolute(), name, (licences or {}).get(folder, ""))
    return run(jobs, Path(out), workers, cluster=cluster)


Content = tuple[dict, dict[str, str]]
"""Tensors and metadata of one sample."""


def procedural_sample(seed: int, kind: str | None = None) -> Content:
    """Tensors and metadata of one procedural shape (ours), of a drawn kind where none is given."""
    from riemlayer.data.meshes import SOUP_SIZE, prepare_mesh, sample_surface
    from riemlayer.data.procedural import random_shape

    shape, rng = random_shape(seed, kind), np.random.default_rng(seed)
    mesh = prepare_mesh(shape.vertices, shape.faces, rng)
    soup = mesh.soup
    if shape.soup is not None and soup is None:
        raw = (shape.soup[0] - mesh.centre) / mesh.scale
        samples = sample_surface(raw, shape.soup[1], 2 * SOUP_SIZE, rng)
        soup = samples[np.abs(samples).max(1) < 1.01][:SOUP_SIZE]  # no parts that fell off
        if len(soup) < SOUP_SIZE:
            raise ValueError("soup must lie around the shape, half of it is outside the cube")
    metadata = dict(kind=shape.kind, source="riemlayer.data.procedural", licence="MIT")
    return _content(mesh.vertices, mesh.faces, soup, seed, metadata)


def mesh_sample(path: Path, name: str, licence: str) -> Content:
    """Tensors and metadata of one mesh file (ours)."""
    from riemlayer.data.meshes import load_mesh, prepare_mesh

    seed = zlib.crc32(name.encode())
    mesh = prepare_mesh(*load_mesh(path), np.random.default_rng(seed))
    source = f"{path.resolve().parent.name}/{path.name}"
    metadata = dict(kind="mesh", source=source, licence=licence)
    return _content(mesh.vertices, mesh.faces, mesh.soup, seed, metadata)


def _content(vertices, faces, soup, seed: int, metadata: dict[str, str]) -> Content:
    from riemlayer.data.ground_truth import shape_ground_truth

    vertices = vertices.astype(np.float32)
    tensors = {"vertices": vertices, "faces": faces.astype(np.int32)}
    if soup is not None:
        tensors["soup"] = soup.astype(np.float32)
    tensors |= shape_ground_truth(vertices.astype(float), faces, seed)
    return tensors, metadata | {"seed": str(seed), "recipe": RECIPE, "open": "0"}


def run(
    jobs: Mapping[str, Callable[[], Content]],
    out: Path,
    workers: int,
    seconds: int = SECONDS_A_SHAPE,
    cluster: str | None = None,
) -> Report:
    """Runs the jobs whose file is missing, each in a worker; failures go to failures.jsonl (ours).

    A job that raises, hangs or kills its worker is recorded with the reason and not tried again
    by a later run: delete its line to retry it.
    """
    with only_run(out):
        return _run(jobs, out, workers, seconds, cluster)


def _run(
    jobs: Mapping[str, Callable[[], Content]],
    out: Path,
    workers: int,
    seconds: int,
    cluster: str | None,
) -> Report:
    from tqdm import tqdm

    remove_stale(out)
    drop_half_line(out)
    done = {file.stem for file in out.glob("[!.]*.safetensors")} | {*read_failures(out)}
    todo = {name: job for name, job in jobs.items() if name not in done}
    if cluster is None:
        results = _results(todo, out, workers, seconds)
    else:
        results = cluster_results(todo, out, cluster, partial(_work, seconds=seconds), seconds)
    failed = 0
    finished = len(jobs) - len(todo)
    with tqdm(total=len(jobs), initial=finished, unit="shape", delay=2, disable=None) as bar:
        for name, reason in results:
            if reason is not None:
                failed += 1
                record_failure(out, name, reason)
            bar.set_postfix(failed=failed)
            bar.update()
    return Report(len(todo) - failed, len(jobs) - len(todo), failed)


def _results(
    todo: Mapping[str, Callable[[], Content]], out: Path, workers: int, seconds: int
) -> Iterator[tuple[str, str | None]]:
    """Pairs of name and reason of failure, as they come; at most `workers` jobs are under way.

    When a worker dies, the jobs under way are repeated one by one: one that dies again failed.
    """
    queue, suspects, alone = list(todo.items())[::-1], [], False
    running: dict[Future, tuple[str, Callable[[], Content]]] = {}
    while queue or suspects or running:
        if not running:
            alone = bool(suspects)
        source, limit = (suspects, 1) if alone else (queue, workers)
        while source and len(running) < limit:
            name, job = source.pop()
            running[_submit(workers, name, job, out, seconds)] = name, job
        done = wait(running, return_when=FIRST_COMPLETED).done
        if not any(isinstance(future.exception(), BrokenProcessPool) for future in done):
            for future in done:
                yield running.pop(future)[0], future.result()
        elif alone:
            yield running.popitem()[1][0], died(seconds)
        else:
            suspects = list(running.values())
            running.clear()


def _submit(workers: int, *arguments) -> Future:
    from joblib.externals.loky import get_reusable_executor

    threads = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
    return get_reusable_executor(max_workers=workers, env=threads).submit(_work, *arguments)


def _work(name: str, job: Callable[[], Content], out: Path, seconds: int) -> str | None:
    """Builds and writes one sample; the reason where it cannot be built. A full disk raises."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # ends the process, even inside a C++ loop
    signal.alarm(seconds)
    try:
        tensors, metadata = job()
    except Exception as error:  # whatever a library raises on a bad shape
        return f"{type(error).__name__}: {error}"
    finally:
        signal.alarm(0)
    write_sample(out / f"{name}.safetensors", tensors, {"name": name} | metadata)
    return None


def find_meshes(folder: str | Path, seed: int = 0) -> list[Path]:
    """All mesh files below a folder, shuffled so that any first part is representative (ours)."""
    paths = sorted(p for p in Path(folder).rglob("*") if p.suffix.lower() in MESH_SUFFIXES)
    if not paths:
        wanted = " ".join(MESH_SUFFIXES)
        raise ValueError(f"folder must hold meshes ({wanted}), found none below {folder}")
    random.Random(seed).shuffle(paths)
    return paths


def main(argv: Sequence[str] | None = None) -> None:
    """The command line of this module."""
    parser = argparse.ArgumentParser(
        prog="python -m riemlayer.data.prepare",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--procedural", type=int, metavar="N", help="make N procedural shapes")
    what.add_argument("--meshes", type=Path, metavar="DIR", help="prepare all meshes below DIR")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first procedural shape")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the samples")
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    args = parser.parse_args(argv)
    if args.meshes is not None:
        report = prepare_meshes(find_meshes(args.meshes), args.out, args.workers)
    else:
        report = prepare_procedural(args.procedural, args.seed, args.out, args.workers)
    print(f"{report.written} written, {report.skipped} already there, {report.failed} failed")


if __name__ == "__main__":
    main()
