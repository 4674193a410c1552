"""How encoding time and memory grow with the cloud: from 1,000 to 1,000,000 points.

    python -m benchmarks.scaling --weights base

Two series: one cloud sampled ever more densely, whose occupied leaves saturate at the depth of the
octree, and packed batches of clouds of 15,000 points, whose leaves grow with the batch. Time is
linear in points and leaves together; the fit says how well. Writes scaling.json, scaling.md and
scaling.png to benchmarks/results.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from benchmarks import tasks
from benchmarks.measure import median_seconds, python, warn_if_busy, write_results
from benchmarks.speed import RESULTS, duration, size
from riemlayer import ExpLogField
from riemlayer.tables.machine import machine

DENSER = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
BATCHES = (1, 2, 4, 8, 16, 33, 67)
CLOUD = 15_000
"""Points of each cloud of a batch: 67 of them are a million."""


@dataclass
class Sample:
    """One encoding."""

    clouds: int
    points: int
    leaves: int
    seconds: float
    megabytes: float | None = None
    """Peak above the interpreter; of the largest of each series."""


@dataclass(frozen=True)
class Line:
    """Least squares: seconds = fixed + point * points + leaf * leaves."""

    fixed: float
    point: float
    leaf: float
    r_squared: float

    @classmethod
    def fit(cls, samples: list[Sample]) -> Line:
        """Fit with relative errors, so that small clouds count as much as large ones."""
        seconds = np.array([s.seconds for s in samples])
        rows = np.array([[1.0, s.points, s.leaves] for s in samples])
        scale = rows.max(0) * seconds[:, None]
        solution = np.linalg.lstsq(rows / scale, np.ones(len(rows)), rcond=None)[0] / rows.max(0)
        left = np.square(np.log(np.maximum(rows @ solution, 1e-9) / seconds)).sum()
        total = np.square(np.log(seconds) - np.log(seconds).mean()).sum()
        return cls(*map(float, solution), r_squared=float(1 - left / total))

    def at(self, points: np.ndarray, leaves: np.ndarray) -> np.ndarray:
        """Seconds of the fit."""
        return self.fixed + self.point * points + self.leaf * leaves


def measure(field: ExpLogField, clouds: int, points: int, repeats: int) -> Sample:
    """Encode `clouds` equal clouds of `points` points each."""
    encode = tasks.encode(field, clouds, points)
    with torch.inference_mode():
        leaves = len(encode().embedding.level)
        seconds = median_seconds(encode, repeats, warm_up=0)
    return Sample(clouds, clouds * points, leaves, seconds)


def plot(path: Path, denser: list[Sample], batches: list[Sample], line: Line) -> None:
    """Time against points and against occupied leaves, with the fit."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for axis, samples, of, label in (
        (axes[0], denser, "points", "points of one cloud"),
        (axes[1], batches, "leaves", "occupied leaves of a packed batch"),
    ):
        count = np.array([getattr(s, of) for s in samples])
        fit = line.at(*(np.array([getattr(s, x) for s in samples]) for x in ("points", "leaves")))
        axis.plot(count, fit, color="0.6", label="fit")
        axis.plot(count, [s.seconds for s in samples], "o", color="#c2571a", label="measured")
        axis.set(xlabel=label, ylabel="seconds", xscale="log", yscale="log")
        axis.grid(alpha=0.3)
        axis.legend(frameon=False)
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


def table(denser: list[Sample], batches: list[Sample], line: Line, facts: dict) -> str:
    """Both series in Markdown, and the fit."""
    lines = [
        f"Weights `{facts['weights']}`; {facts['processor']}, {facts['threads']} threads, torch "
        f"{facts['torch']}. Fit over all rows: {1e3 * line.fixed:.0f} ms + "
        f"{1e9 * line.point:.0f} ns a point + {1e6 * line.leaf:.1f} µs a leaf, "
        f"R² of log time = {line.r_squared:.4f}.\n",
        "| clouds | points | occupied leaves | time | µs a leaf | peak memory |",
        "|--:|--:|--:|--:|--:|--:|",
    ]
    for s in denser + batches:
        each = f"{1e6 * s.seconds / s.leaves:.1f}"
        memory = size(s.megabytes)
        line_ = (f"{s.clouds}", f"{s.points:,}", f"{s.leaves:,}", duration(s.seconds), each, memory)
        lines.append(f"| {' | '.join(line_)} |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description="Encoding time against the size of the cloud.")
    parser.add_argument("--weights", default="base", help="name, directory, hub id or preset:NAME")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--no-memory", action="store_true", help="times only")
    parser.add_argument("--fast", action="store_true", help="tiny sizes, to see that it runs")
    parser.add_argument("--output", type=Path, help=f"folder of the results; {RESULTS}")
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    warn_if_busy()
    facts = machine(options.threads) | {"weights": options.weights}
    field = tasks.load_field(options.weights)
    sizes, counts, cloud = ((500, 1_000), (1, 2), 500) if options.fast else (DENSER, BATCHES, CLOUD)
    denser = [measure(field, 1, n, 5 if n <= 30_000 else 3) for n in sizes]
    batches = [measure(field, n, cloud, 5 if n <= 8 else 2) for n in counts]
    if not options.no_memory:
        for sample in (denser[-1], batches[-1]):
            command = ["-m", "benchmarks.tasks", "encode", "--weights", options.weights]
            command += [
                "--points",
                str(sample.points // sample.clouds),
                "--clouds",
                str(sample.clouds),
            ]
            sample.megabytes = python(command, options.threads)["megabytes"]
    line = Line.fit(denser + batches)
    results = {
        "facts": facts,
        "one_cloud": [asdict(s) for s in denser],
        "packed": [asdict(s) for s in batches],
        "fit": asdict(line),
    }
    fast = Path(tempfile.gettempdir()) / "riemlayer-benchmarks"
    folder = options.output or (fast if options.fast else RESULTS)
    write_results(folder, "scaling", results, table(denser, batches, line, facts))
    plot(folder / "scaling.png", denser, batches, line)


if __name__ == "__main__":
    main()
