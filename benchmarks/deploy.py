"""What deployment brings and costs: compiled and exported decoders' times, half precision's errors.

    python -m benchmarks.deploy --weights base

times the two halves of a query, eager look-ups and decoder, with the decoder in eager torch, by
torch.compile, as a loaded torch.export program and in ONNX Runtime; then asks Exp and Log of a few
procedural shapes in bfloat16 and float16 and says how far the answers lie from those in float32. It
writes deploy.json and deploy.md to benchmarks/results. Most of its time goes to the compiler; run
it with nothing else running.
"""

from __future__ import annotations

import argparse
import contextlib
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks import tasks
from benchmarks.measure import median_seconds, warn_if_busy, write_results
from benchmarks.speed import duration
from riemlayer import EncodedSurface, ExpLogField, deploy
from riemlayer.data.augment import sample_surface
from riemlayer.data.procedural import random_shape
from riemlayer.deploy import Map
from riemlayer.tables.machine import machine
from riemlayer.tables.shapes import FIRST_SEED

RESULTS = Path(__file__).parent / "results"
KINDS = ("car", "quadruped", "blob", "assembly")


@dataclass
class Timing:
    """Seconds of a query's halves; None where it was not run."""

    what: str
    lookups: float
    eager: float
    exported: float
    onnx: float
    compiled: float | None
    compiling: float | None
    """First call, compilation included."""
    apart: float
    """Largest difference between any of them and eager, in the cube."""


@dataclass
class Precision:
    """Distances to float32, in trained radii: mean, 99 % and largest."""

    what: str
    exp: tuple[float, float, float]
    log: tuple[float, float, float]
    query: float | None
    """Seconds of Log from one source to as many points as in the first table."""
    encode: float | None
    """Seconds of encoding."""


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    points: int = 15_000
    targets: int = 10_000
    vectors: int = 1_000
    sources: int = 500
    shapes: int = 4
    sampled: int = 5_000
    asked: int = 100
    """Sources, and queries each, on a shape."""
    repeats: int = 15

    @classmethod
    def fast(cls) -> Sizes:
        """Enough to see that everything runs."""
        return cls(400, 50, 20, 8, 1, 400, 5, 1)


def full_precision(weights: str) -> ExpLogField:
    """A field that stays in float32 unless told otherwise, whatever the processor has."""
    field = tasks.load_field(weights).requires_grad_(False)
    field.half_precision = contextlib.nullcontext  # pyright: ignore[reportAttributeAccessIssue]
    return field


def timings(weights: str, sizes: Sizes, compiling: bool) -> Iterator[Timing]:
    """Every line of the first table, as it is measured."""
    field, compiled = full_precision(weights), full_precision(weights)
    if compiling:
        torch.compiler.config.force_disable_caches = True  # else "first call" is what a disk takes
        for head in (compiled.exp_head, compiled.log_head):
            head.decoder.compile(dynamic=True)
    points = tasks.torus(sizes.points)
    surface = field.encode(points)
    p, many, few = points[:1], points[: sizes.sources], tasks.NEIGHBOURS
    v = tasks.tangent_vectors(p, sizes.vectors, float(surface.radius))
    near = points[torch.cdist(many, points).topk(few, largest=False)[1]]
    questions: list[tuple[str, Map, Tensor, Tensor]] = [
        (f"Exp of {few} vectors, one source", "exp", p[:, None], v[:, :few]),
        (f"Exp of {sizes.vectors:,} vectors, one source", "exp", p[:, None], v),
        (f"Log to {few} points, one source", "log", p, points[:few]),
        (f"Log to {sizes.targets:,} points, one source", "log", p, points[: sizes.targets]),
        (f"Log to {few} points, {sizes.sources} sources", "log", many[:, None], near),
    ]
    programs = {which: Programs(field, which) for which in ("exp", "log")}
    for what, which, p, x in questions:
        query = deploy.prepare(surface, which, p, x)
        eager, other = (deploy.Decoder(f, which) for f in (field, compiled))
        runs = programs[which].runs(query.inputs)
        runs["eager"] = partial(eager, **query.inputs)
        first = None
        if compiling:
            runs["compiled"] = partial(other, **query.inputs)
            start = time.perf_counter()
            runs["compiled"]()
            first = time.perf_counter() - start
        answers = {name: run() for name, run in runs.items()}
        seconds = {name: median_seconds(run, sizes.repeats) for name, run in runs.items()}
        yield Timing(
            what,
            lookups=median_seconds(partial(deploy.prepare, surface, which, p, x), sizes.repeats),
            **{"compiled": None, **seconds},
            compiling=first,
            apart=max(apart(answer, answers["eager"]) for answer in answers.values()),
        )


class Programs:
    """The decoder of a map, exported, written and loaded again."""

    def __init__(self, field: ExpLogField, which: Map) -> None:
        import onnxruntime

        with torch.inference_mode(False), tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            program = deploy.export(field, which)
            torch.export.save(program, folder / "map.pt2")
            deploy.export_onnx(program, folder / "map.onnx")
            self.program = torch.export.load(folder / "map.pt2").module()
            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads = torch.get_num_threads()
            self.session = onnxruntime.InferenceSession(
                folder / "map.onnx", options, providers=["CPUExecutionProvider"]
            )

    def runs(self, inputs: dict[str, Tensor]) -> dict[str, Callable[[], Any]]:
        """A call of each program."""
        arrays = {name: x.numpy() for name, x in inputs.items()}
        return {
            "exported": lambda: self.program(**inputs),
            "onnx": lambda: self.session.run(None, arrays),
        }


def apart(answer: Any, expected: Any) -> float:
    """Largest difference between two answers of a decoder."""
    pairs = zip(answer, expected, strict=True)
    return max(float((torch.as_tensor(a) - b).abs().max()) for a, b in pairs)


def precisions(weights: str, sizes: Sizes) -> Iterator[Precision]:
    """Every line of the second table, as it is measured."""
    field = full_precision(weights)
    clouds = [shape_points(KINDS[i], FIRST_SEED + i, sizes.sampled) for i in range(sizes.shapes)]
    wanted = [Asked(field.encode(points), sizes.asked, i) for i, points in enumerate(clouds)]
    torus, repeats = tasks.torus(sizes.points), sizes.repeats // 3 + 1
    log_torus = tasks.log(field, torus, sizes.targets)
    for dtype, encoded in (
        (torch.float32, False),
        (torch.bfloat16, False),
        (torch.bfloat16, True),
        (torch.float16, False),
        (torch.float16, True),
    ):
        half = dtype != torch.float32
        exp, log = [], []
        for points, asked in zip(clouds, wanted, strict=True):
            with torch.autocast("cpu", dtype, enabled=encoded):
                surface = field.encode(points) if encoded else asked.surface
            with torch.autocast("cpu", dtype, enabled=half):
                q, v = surface.exp(asked.p, asked.v), surface.log(asked.p, asked.q)
            exp.append(((q - asked.q).norm(dim=-1) / surface.radius).flatten())
            log.append(((v - asked.back).norm(dim=-1) / surface.radius).flatten())
        query = encode = None
        with torch.autocast("cpu", dtype, enabled=half):
            if not encoded:
                query = median_seconds(log_torus, repeats)
            if encoded or not half:
                encode = median_seconds(lambda: field.encode(torus), 1, warm_up=not half)
        name = str(dtype).removeprefix("torch.")
        what = f"{name}{', encoding too' if encoded else ', queries alone' if half else ''}"
        yield Precision(what, spread(exp), spread(log), query, encode)


class Asked:
    """Questions to a surface and its answers in float32."""

    def __init__(self, surface: EncodedSurface, count: int, seed: int) -> None:
        generator = torch.Generator().manual_seed(seed)
        index = torch.randperm(len(surface.points), generator=generator)[:count]
        self.surface, self.p = surface, surface.points[index, None]
        v = surface.project(self.p, torch.randn(count, count, 3, generator=generator))
        length = surface.radius * torch.rand(count, count, 1, generator=generator)
        self.v = length * torch.nn.functional.normalize(v, dim=-1)
        self.q = surface.exp(self.p, self.v)
        self.back = surface.log(self.p, self.q)


def shape_points(kind: str, seed: int, count: int) -> Tensor:
    """Raw cloud (count, 3) of a procedural shape."""
    shape = random_shape(seed, kind)
    vertices, faces = torch.from_numpy(shape.vertices).float(), torch.from_numpy(shape.faces)
    return sample_surface(vertices, faces, count, torch.Generator().manual_seed(seed))


def spread(errors: list[Tensor]) -> tuple[float, float, float]:
    """Mean, 99 % and largest of all errors."""
    x = torch.cat(errors)
    return float(x.mean()), float(x.quantile(0.99)), float(x.max())


def table(timings: list[Timing], precisions: list[Precision], facts: dict) -> str:
    """Both tables in Markdown."""
    has = "has" if facts["bfloat16"] else "has no"
    lines = [
        f"Weights `{facts['weights']}`; {facts['processor']}, {facts['threads']} threads, torch "
        f"{facts['torch']}, ONNX Runtime {facts['onnxruntime']}. Load before the run "
        f"{facts['load_before']:g} on {facts['cores']} cores. Medians of one run. All decoders are "
        f"within {max(row.apart for row in timings):.0e} of eager, in the cube.\n",
        "| | look-ups, eager | decoder: eager | torch.compile | times as fast | first call | "
        "torch.export | ONNX Runtime | times as fast |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in timings:
        cells = [duration(row.lookups), duration(row.eager), duration(row.compiled)]
        cells += [
            f"{row.eager / row.compiled:.2f}" if row.compiled else "",
            duration(row.compiling),
        ]
        cells += [duration(row.exported), duration(row.onnx), f"{row.eager / row.onnx:.2f}"]
        lines.append(f"| {row.what} | {' | '.join(cells)} |")
    lines += [
        "\nHalf precision by `torch.autocast`: distances to the answers in float32, in trained "
        f"radii, on {facts['shapes']} procedural shapes. This processor {has} bfloat16 "
        "instructions; its times say nothing of others.\n",
        "| | Exp: mean | 99 % | largest | Log: mean | 99 % | largest | Log, one source | encode |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in precisions:
        errors = " | ".join(f"{x:.1e}" if x else "0" for x in (*row.exp, *row.log))
        times = f"{duration(row.query)} | {duration(row.encode)}"
        lines.append(f"| {row.what} | {errors} | {times} |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    import onnxruntime

    parser = argparse.ArgumentParser(description="What deployment brings and costs.")
    parser.add_argument("--weights", default="base", help="name, directory, hub id or preset:NAME")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--no-compile", action="store_true", help="without torch.compile")
    parser.add_argument("--fast", action="store_true", help="tiny sizes, to see that it runs")
    parser.add_argument("--output", type=Path, help=f"folder of the results; {RESULTS}")
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    warn_if_busy()
    sizes = Sizes.fast() if options.fast else Sizes()
    compiler = shutil.which("g++") or shutil.which("clang++")
    facts = machine(options.threads) | {
        "weights": options.weights,
        "onnxruntime": onnxruntime.__version__,
        "shapes": sizes.shapes,
    }
    with torch.inference_mode():
        times = [*timings(options.weights, sizes, bool(compiler) and not options.no_compile)]
        half = [*precisions(options.weights, sizes)]
    rows = {"times": [asdict(row) for row in times], "precision": [asdict(row) for row in half]}
    fast = Path(tempfile.gettempdir()) / "riemlayer-benchmarks"
    folder = options.output or (fast if options.fast else RESULTS)
    write_results(folder, "deploy", {"facts": facts} | rows, table(times, half, facts))


if __name__ == "__main__":
    main()
