"""How fast, beside what: every figure of the README's speed table, in one run on one machine.

    python -m benchmarks.speed --weights base --ocnn-python /tmp/ocnnenv/bin/python

times the field and its rivals one after the other (warm-up, then the median), reads each task's
peak memory from a process of its own, and writes speed.json and speed.md to benchmarks/results. The
cloud is a torus of 15,000 raw points. `--weights preset:base` takes an untrained field, which is as
fast. How to make the environment of `--ocnn-python` says benchmarks/ocnn_unet.py; without it that
rival is left out.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks import tasks
from benchmarks.measure import (
    median_seconds,
    python,
    warn_if_busy,
    write_results,
)
from riemlayer import ExpLogField
from riemlayer.baselines import Walking
from riemlayer.losses import LossWeights
from riemlayer.tables.machine import machine

RESULTS = Path(__file__).parent / "results"
OCNN, SET_UP, WARM, TRACING = (
    "ocnn UNet at the paper's widths, depth 6",
    "PointCloudHeatSolver up to its first log map",
    "PointCloudHeatSolver, warm",
    "fine-step walking of 400 vectors",
)


@dataclass
class Row:
    """A line of the table."""

    what: str
    seconds: float
    at_most: float | None = None
    """Seconds to stay below."""
    megabytes: float | None = None
    """Peak above the interpreter."""
    megabytes_at_most: float | None = None
    against: dict[str, float] = field(default_factory=dict)
    """Seconds of the rivals."""
    faster: dict[str, float] = field(default_factory=dict)
    """By how much a rival is to be beaten."""


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    points: int = 15_000
    targets: int = 10_000
    vectors: int = 1_000
    traced: int = 400
    queries: int = 768
    """A source, in a training step."""
    million: int = 1_000_000
    repeats: int = 15

    @classmethod
    def fast(cls) -> Sizes:
        """Enough to see that everything runs."""
        return cls(600, 400, 100, 40, 32, 2_000, 2)


class Bench:
    """The runs of one table."""

    def __init__(self, weights: str, sizes: Sizes, options: argparse.Namespace) -> None:
        self.weights, self.sizes, self.options = weights, sizes, options
        self.field = tasks.load_field(weights)
        self.points = tasks.torus(sizes.points)

    def time(self, run: Callable[[], object], repeats: int | None = None) -> float:
        """Median seconds of a call."""
        return median_seconds(run, repeats or self.sizes.repeats)

    def memory(self, task: str, points: int) -> float | None:
        """Peak megabytes of a task."""
        if self.options.no_memory:
            return None
        command = ["-m", "benchmarks.tasks", task, "--weights", self.weights]
        return python([*command, "--points", str(points)], self.options.threads)["megabytes"]

    def ocnn(self) -> dict[str, float]:
        """Seconds of ocnn's U-Net on the same cloud, where its interpreter is given."""
        if self.options.ocnn_python is None:
            return {}
        with tempfile.TemporaryDirectory() as folder:
            cloud = Path(folder) / "points.npy"
            np.save(cloud, self.points.numpy())
            command = ["-m", "benchmarks.ocnn_unet", str(cloud), "--repeats"]
            command += [
                str(max(2, self.sizes.repeats // 3)),
                "--threads",
                str(self.options.threads),
            ]
            done = python(command, self.options.threads, self.options.ocnn_python)
        return {OCNN: done["seconds"]}

    def rows(self) -> Iterator[Row]:
        """Every line, as it is measured."""
        ocnn, heat = self.ocnn(), Heat(self.points, self.sizes)
        warm = self.time(heat.warm)
        yield from self.encoding(ocnn, self.time(heat.set_up, 3))
        yield from self.maps(self.time(heat.warm_on_targets), warm)
        yield from self.training()
        million = self.sizes.million
        seconds = self.time(tasks.encode(self.field, 1, million), 1)
        memory = self.memory("encode", million)
        yield Row(f"encode {million:,} points", seconds, 10.0, memory, 6000)

    def encoding(self, ocnn: dict[str, float], set_up: float) -> Iterator[Row]:
        """One pass of the backbone, octree and local planes included."""
        n = self.sizes.points
        seconds, memory = self.time(tasks.encode(self.field, 1, n)), self.memory("encode", n)
        against, faster = ocnn | {SET_UP: set_up}, {OCNN: 10.0, SET_UP: 4.0}
        yield Row(f"encode {n:,} points", seconds, 0.12, memory, 600, against, faster)
        paper = ExpLogField.from_preset("paper").eval()
        seconds = self.time(tasks.encode(paper, 1, n), self.sizes.repeats // 2 + 1)
        what = f"the same with the `paper` preset{', bf16' if machine(1)['bfloat16'] else ''}"
        yield Row(what, seconds, against=ocnn, faster={OCNN: 4.0})

    def maps(self, warm_on_targets: float, warm: float) -> Iterator[Row]:
        """Log and Exp from one source, Log along all edges of a graph, and the layers' record."""
        sizes, points = self.sizes, self.points
        seconds = self.time(tasks.log(self.field, points, sizes.targets))
        what = f"Log from one source to {sizes.targets:,} points"
        yield Row(what, seconds, 0.010, against={WARM: warm_on_targets})
        walked = tasks.exp(self.field, points, sizes.vectors)
        straight = tasks.exp(tasks.without_walk(self.field), points, sizes.vectors)
        what = f"Exp of {sizes.vectors:,} vectors from one source"
        tracing = {TRACING: self.time(tracing_run(points, sizes.traced))}
        yield Row(f"{what}, walked prior", self.time(walked), 0.008, against=tracing)
        yield Row(f"{what}, straight prior", self.time(straight), 0.004, against=tracing)
        pairs = tasks.NEIGHBOURS * sizes.points
        seconds = self.time(tasks.edges(self.field, points), min(3, sizes.repeats))
        memory, name = self.memory("edges", sizes.points), f"{WARM}, once a source"
        what = f"{tasks.NEIGHBOURS}-neighbour log edges of all points ({pairs:,} pairs)"
        against, faster = {name: warm * sizes.points}, {name: 100.0}
        yield Row(what, seconds, 1.5, memory, 1500, against, faster)
        seconds = self.time(tasks.record(self.field, points), min(3, sizes.repeats))
        memory = self.memory("record", sizes.points)
        what = f"`local_geometry` of {sizes.points:,} points, k={tasks.NEIGHBOURS}"
        yield Row(what, seconds, 2.0, memory, 1500)

    def training(self) -> Iterator[Row]:
        """Forward, backward and optimiser on one core."""
        queries, threads = self.sizes.queries, torch.get_num_threads()
        torch.set_num_threads(1)
        for losses, limit, note in (
            (tasks.TRAINED_WITH, 0.45, "losses of `base`"),
            (LossWeights(), None, "all terms of Eq. (1)"),
        ):
            with torch.inference_mode(False):
                step = tasks.training_step(self.field, self.points, queries, losses)
                seconds = self.time(step, self.sizes.repeats // 3 + 1)
            what = f"training step, {tasks.SOURCES * queries:,} queries, one core, {note}"
            yield Row(what, seconds, limit)
        torch.set_num_threads(threads)


class Heat:
    """The point-cloud heat solver of potpourri3d, cold and warm."""

    def __init__(self, points: Tensor, sizes: Sizes) -> None:
        self.cloud = points.double().numpy()
        self.solver = self.set_up()
        self.on_targets = self.solver_of(self.cloud[: sizes.targets])
        self.source = 0

    def set_up(self):
        """Build the solver of the whole cloud and solve once, which factorises its matrices."""
        return self.solver_of(self.cloud)

    def solver_of(self, cloud: np.ndarray):
        """A solver that has solved once."""
        import potpourri3d

        solver = potpourri3d.PointCloudHeatSolver(cloud)
        solver.compute_log_map(0)
        return solver

    def warm(self) -> np.ndarray:
        """Log map of the whole cloud from a source that was not asked before."""
        self.source += 1
        return self.solver.compute_log_map(self.source)

    def warm_on_targets(self) -> np.ndarray:
        """Log map of the cloud of targets alone."""
        self.source += 1
        return self.on_targets.compute_log_map(self.source)


def tracing_run(points: Tensor, count: int) -> tasks.Run:
    """Walking of `count` vectors from one source, with search tree and planes ready."""
    method, cloud = Walking(), points.numpy()
    method.prepare(cloud)
    vectors = tasks.tangent_vectors(points[:1], count, 0.5)[0].numpy()
    return lambda: method.exp(cloud[0], vectors)


def table(rows: list[Row], facts: dict) -> str:
    """The rows in Markdown."""
    lines = [
        f"{facts['points']:,} points on a torus, {facts['leaves']:,} occupied leaves, weights "
        f"`{facts['weights']}`; {facts['processor']}, {facts['threads']} threads, "
        f"torch {facts['torch']}. Medians of one run.\n",
        "| what | time | at most | memory | at most | against | takes | times as long | at least |",
        "|---|--:|--:|--:|--:|---|--:|--:|--:|",
    ]
    for row in rows:
        own = f"{duration(row.seconds)} | {duration(row.at_most)} | {size(row.megabytes)} | "
        own += size(row.megabytes_at_most)
        for i, (rival, seconds) in enumerate(row.against.items() or [("", None)]):
            head = f"{row.what} | {own}" if i == 0 else " | | | |"
            ratio = f"{seconds / row.seconds:.1f}" if seconds else ""
            least = f"{row.faster[rival]:g}" if rival in row.faster else ""
            lines.append(f"| {head} | {rival} | {duration(seconds)} | {ratio} | {least} |")
    return "\n".join(lines)


def duration(seconds: float | None) -> str:
    """Seconds or milliseconds in three digits; nothing for None."""
    if seconds is None:
        return ""
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"


def size(megabytes: float | None) -> str:
    """Whole megabytes; nothing for None."""
    return "" if megabytes is None else f"{megabytes:,.0f} MB"


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description="How fast, beside what.")
    parser.add_argument("--weights", default="base", help="name, directory, hub id or preset:NAME")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--ocnn-python", help="interpreter that can import ocnn")
    parser.add_argument("--no-memory", action="store_true", help="times only")
    parser.add_argument("--fast", action="store_true", help="tiny sizes, to see that it runs")
    parser.add_argument("--output", type=Path, help=f"folder of the results; {RESULTS}")
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    warn_if_busy()
    bench = Bench(options.weights, Sizes.fast() if options.fast else Sizes(), options)
    with torch.inference_mode():
        facts = machine(options.threads) | {
            "weights": options.weights,
            "points": bench.sizes.points,
            "leaves": len(bench.field.encode(bench.points).embedding.level),
        }
        rows = []
        for row in bench.rows():
            rows.append(row)
            print(f"{row.what}: {duration(row.seconds)} {size(row.megabytes)}", flush=True)
    results = {"facts": facts, "rows": [asdict(row) for row in rows]}
    fast = Path(tempfile.gettempdir()) / "riemlayer-benchmarks"
    folder = options.output or (fast if options.fast else RESULTS)
    write_results(folder, "speed", results, table(rows, facts))


if __name__ == "__main__":
    main()
