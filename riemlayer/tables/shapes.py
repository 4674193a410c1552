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

import numpy as np

from riemlayer.baselines import MeshHeat
from riemlayer.data.cut_locus import divergence
from riemlayer.data.ground_truth import RADIUS, trace
from riemlayer.data.manifold import vertex_normals
from riemlayer.data.prepare import Content, find_meshes, procedural_sample, run
from riemlayer.data.sample_file import RECIPE, remove_stale
from riemlayer.tables.evaluate import tangent_frame
from riemlayer.tables.run import write_json

Array = np.ndarray
Arrays = dict[str, Array]
INPUTS = ("remeshed", "nonuniform", "noisy", "raw")
"""What a method is given (Sec. 4.1): the vertices of the remeshed shape; samples of it whose density
varies about 10:1; its vertices moved by up to `NOISE`; samples of the surface before it was made
watertight, where it had to be."""
NOISE = 0.015
FIRST_SEED = 1_100_000
"""Of the procedural shapes; training draws seeds below 1,000,000."""
TRACED, KEPT = 2400, 400
"""Vectors a source that the filter sees, and that are kept."""
TAU, TAU_TIGHT = 0.5, 0.1
BLUE_NOISE = 30_000
"""Evenly spread samples that the uneven ones are drawn from."""


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
            holds shapes of other settings.
        OSError: `out` cannot be written (a full disk); every finished file stays valid.
    """
    places = [(path, *_place(path.relative_to(folder))) for path in sorted(find_meshes(folder))]
    same = Counter((group, name) for _, group, name in places)
    jobs: dict[tuple[str, str], Callable[[], Content]] = {}
    for path, group, name in places:
        label = group, name if same[group, name] == 1 else name + path.suffix
        if label in jobs:
            raise ValueError(f"meshes must differ in name, {path} repeats {'/'.join(label)}")
        jobs[label] = partial(_mesh_record, path, label, sources, _seed(seed, *label))
    return _prepare(jobs, Path(out), f"{sources}-sources-seed-{seed}", inputs, workers)


def procedural_shapes(
    n: int,
    out: str | Path,
    seed: int = FIRST_SEED,
    sources: int = 10,
    inputs: Sequence[str] = ("remeshed",),
    workers: int = 1,
) -> Preparation:
    """Makes n procedural shapes for evaluation, `out/procedural/<kind>-<seed>.npz` (ours).

    Args:
        n: number of shapes.
        out, sources, inputs, workers: as for `prepare_shapes`.
        seed: of the first shape; each shape depends on its own seed alone.

    Raises:
        ValueError: `seed` is below `FIRST_SEED`, and training may have seen such shapes.
    """
    if seed < FIRST_SEED:
        raise ValueError(f"seed must be at least {FIRST_SEED} (training uses others), got {seed}")
    jobs = {
        ("procedural", str(s)): partial(_procedural_record, s, sources)
        for s in range(seed, seed + n)
    }
    return _prepare(jobs, Path(out), f"{sources}-sources", inputs, workers)


def ground_truth(vertices: Array, faces: Array, src: Array, vec: Array) -> Arrays:
    """Exp and Log of a mesh at some of its vertices, and where they can be relied on.

    Exp is traced (straightest geodesics). Log is the vector heat method's `AffineLocal`, which
    far from the source collapses to short vectors: `valid` asks for a short geodesic (fast
    marching) as well. The tight masks hold shortest geodesics alone: Eq. (8) with tau = 0.1, and
    |v| within 0.02 + 10 % of the fast-marching distance (at an end point, of that of the nearest
    vertex, and the way there on top).

    Args:
        vertices, faces: a manifold mesh (n, 3), (m, 3) in the cube.
        src: source vertices (P,).
        vec: tangent vectors (P, T, 3) of length up to `RADIUS`; the filter of appendix E looks at
            all of them together.

    Returns:
        "end" (P, T, 3), "ok", "ok_tight" (P, T), "log" (P, n, 3), "valid", "valid_tight" (P, n).

    Raises:
        ValueError: the truth is not finite.
    """
    from potpourri3d import MeshFastMarchingDistanceSolver
    from scipy.spatial import KDTree

    end, complete = trace(vertices, faces, src, vec)
    heat, marching = MeshHeat(), MeshFastMarchingDistanceSolver(vertices, faces)
    heat.prepare_mesh(vertices, faces)
    log = np.stack([heat.log(vertices[s], vertices) for s in src])
    far = np.stack([np.ravel(marching.compute_distance([[(int(s), [])]])) for s in src])  # (P, n)
    if not (np.isfinite(end).all() and np.isfinite(log).all() and np.isfinite(far).all()):
        raise ValueError("vertices, faces: a geodesic, log map or distance is not finite")
    delta = divergence(end, vec)
    ok = complete & (delta <= TAU)
    length, (gap, near) = np.linalg.norm(vec, axis=-1), KDTree(vertices).query(end)
    off = np.abs(length - np.take_along_axis(far, near, 1))
    reach = np.linalg.norm(log, axis=-1)
    spread = divergence(np.broadcast_to(vertices, log.shape), log)
    valid = (reach < RADIUS) & (far < 1.05 * RADIUS) & (spread <= TAU)
    shortest = np.abs(reach - far) <= 0.02 + 0.1 * far
    return {
        "end": end,
        "ok": ok,
        "ok_tight": ok & (delta <= TAU_TIGHT) & (off <= 0.02 + 0.1 * length + gap),
        "log": log,
        "valid": valid,
        "valid_tight": valid & (spread <= TAU_TIGHT) & shortest,
    }


def draw_queries(
    vertices: Array, faces: Array, sources: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Random source vertices (P,), their normals (P, 3) and `TRACED` vectors each (P, T, 3).

    The vectors are tangent and uniform by area in the disk of `RADIUS`.
    """
    if not 0 < sources <= len(vertices):
        raise ValueError(f"sources must lie between 1 and {len(vertices)} vertices, got {sources}")
    src = rng.choice(len(vertices), sources, replace=False)
    normal = vertex_normals(vertices, faces)[src]
    share, turn = rng.random((2, sources, TRACED, 1))
    flat = np.concatenate([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)], -1)
    frames = np.stack([tangent_frame(x) for x in normal])
    return src, normal, RADIUS * np.sqrt(share) * flat @ frames.transpose(0, 2, 1)


def shape_arrays(vertices: Array, faces: Array, sources: int, seed: int) -> Arrays:
    """All arrays of a prepared shape but its cloud, of one manifold mesh in the cube (ours).

    What is stored in float32 is what was traced and solved for. `log` is rounded to multiples of
    2^-15, of 2^-7 where it is longer than 0.75 and never counts, so that the file packs well.
    """
    vertices = vertices.astype(np.float32)
    mesh, rng = vertices.astype(float), np.random.default_rng(seed)
    src, normal, vec = draw_queries(mesh, faces, sources, rng)
    vec = vec.astype(np.float32)
    truth = ground_truth(mesh, faces, src, vec.astype(float))
    near = np.linalg.norm(truth["log"], axis=-1, keepdims=True) < 1.5 * RADIUS
    grid = np.where(near, 2.0**15, 2.0**7)
    return {
        "V": vertices,
        "F": faces.astype(np.int32),
        "src": src.astype(np.int32),
        "src_normal": normal.astype(np.float32),
        "vec": vec[:, :KEPT],
        "end": truth["end"][:, :KEPT].astype(np.float32),
        "log": (np.round(truth["log"] * grid) / grid).astype(np.float32),
        **{name: truth[name][:, :KEPT] for name in ("ok", "ok_tight")},
        **{name: truth[name] for name in ("valid", "valid_tight")},
    }


def cloud(name: str, vertices: Array, faces: Array, seed: int) -> Array:
    """The cloud (N, 3) float32 of an input of `INPUTS` other than "raw" (Sec. 4.1).

    Raises:
        ValueError: there is no such input.
    """
    if name == "remeshed":
        return vertices
    if name == "noisy":
        rng = np.random.default_rng(seed)
        direction = rng.normal(size=vertices.shape)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        length = NOISE * rng.random((len(vertices), 1))
        return (vertices + length * direction).astype(np.float32)
    if name == "nonuniform":
        import torch

        from riemlayer.data import augment

        generator = torch.Generator().manual_seed(seed)
        mesh = torch.from_numpy(vertices), torch.from_numpy(faces)
        points = augment.sample_surface(*mesh, 3 * BLUE_NOISE, generator)
        points = augment.thin_out(points, BLUE_NOISE)
        return points[augment.uneven(points, generator)].numpy()
    raise ValueError(f"inputs must be among {', '.join(INPUTS)}, got {name!r}")


def _place(path: Path) -> tuple[str, str]:
    """Group and name of a mesh from its path below the folder."""
    top, *rest = ("meshes", *path.with_suffix("").parts)[-len(path.parts) - (len(path.parts) == 1) :]
    return _clean(top), _clean("-".join(rest))


def _clean(text: str) -> str:
    return re.sub(r"[^\w.-]", "_", text)


def _seed(*words: object) -> int:
    return zlib.crc32("/".join(map(str, words)).encode())


def _mesh_record(path: Path, label: tuple[str, str], sources: int, seed: int) -> Content:
    from riemlayer.data.meshes import load_mesh, prepare_mesh

    mesh = prepare_mesh(*load_mesh(path), np.random.default_rng(seed))
    arrays = shape_arrays(mesh.vertices, mesh.faces, sources, seed)
    if mesh.soup is not None:
        arrays["soup"] = mesh.soup.astype(np.float32)
    return arrays, {"group": label[0], "shape": label[1]}


def _procedural_record(seed: int, sources: int) -> Content:
    sample, metadata = procedural_sample(seed)
    arrays = shape_arrays(sample["vertices"], sample["faces"], sources, seed)
    if "soup" in sample:
        arrays["soup"] = sample["soup"]
    return arrays, {"group": "procedural", "shape": f"{metadata['kind']}-{seed}"}


def _prepare(
    jobs: Mapping[tuple[str, str], Callable[[], Content]],
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
    labels = {"--".join(label): label for label in jobs}
    run({name: jobs[label] for name, label in labels.items()}, records, workers)
    lines = failed.read_text("utf-8").splitlines() if failed.exists() else []
    failures = {"/".join(labels[x["name"]]): x["reason"] for x in map(json.loads, lines)}
    write_json(out / "failures.json", failures)
    written = skipped = 0
    for name in labels:
        path = records / f"{name}.safetensors"
        for new in _write_inputs(path, out, inputs) if path.exists() else ():
            written, skipped = written + new, skipped + (not new)
    return Preparation(written, skipped, failures)


def _write_inputs(record: Path, out: Path, inputs: Sequence[str]) -> Iterator[bool]:
    """Writes the missing files of one record; for each input that it has, whether it was missing."""
    from safetensors import safe_open

    with safe_open(record, "numpy") as file:
        arrays, metadata = {name: file.get_tensor(name) for name in file.keys()}, file.metadata()
    soup = arrays.pop("soup", None)
    for name in inputs:
        if name == "raw" and soup is None:
            continue
        group = metadata["group"] + ("" if name == "remeshed" else f"-{name}")
        path = out / group / f"{metadata['shape']}.npz"
        if path.exists():
            with np.load(path) as there:
                if not np.array_equal(there["src"], arrays["src"]):
                    raise ValueError(f"out holds shapes of other settings ({path}); choose another")
            yield False
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_stale(path.parent)
        seed = _seed(metadata["group"], metadata["shape"], name, *arrays["src"])
        points = soup if name == "raw" else cloud(name, arrays["V"], arrays["F"], seed)
        _write(path, arrays | {"points": points})
        yield True


def _write(path: Path, arrays: Arrays) -> None:
    """Through a temporary file, so that `path` is whole or not there."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            np.savez_compressed(file, **arrays)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
