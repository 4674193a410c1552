"""Cost against sources, queries, shapes and ranks: what `benchmarks.scaling` leaves out.

    python -m benchmarks.axes --weights base

One thread a rank. Sources and queries are timed on an encoded torus of 15,000 points; shapes are
clouds of 10,000 points from files, answers written to files. Writes axes.json and axes.md to
benchmarks/results.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks import tasks
from benchmarks.measure import median_seconds, python, warn_if_busy, write_results
from benchmarks.ranks import answer
from benchmarks.speed import RESULTS, duration
from riemlayer import ExpLogField
from riemlayer.tables.machine import machine

ASKED = ("embedding", "log", "geometry")


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    points: int = 15_000
    sources: tuple[int, ...] = (1, 4, 16, 64, 256)
    per_source: int = 384
    queries: tuple[int, ...] = (100, 1_000, 10_000, 100_000)
    cloud: int = 10_000
    shapes: int = 6
    batches: tuple[int, ...] = (1, 4)
    ranks: tuple[int, ...] = (1, 2)
    train_queries: int = 768
    steps: int = 3

    @classmethod
    def fast(cls) -> Sizes:
        """Enough to see that everything runs."""
        return cls(400, (1, 2), 8, (10, 20), 200, 2, (1, 2), (1,), 8, 1)


def of_queries(field: ExpLogField, sizes: Sizes) -> list[dict[str, Any]]:
    """Seconds of Exp and Log against sources of the same number of queries, and against queries."""
    points = tasks.torus(sizes.points)
    surface = field.encode(points)
    rows = [(s, sizes.per_source) for s in sizes.sources] + [(1, k) for k in sizes.queries]
    found = []
    for s, k in rows:
        p = points[:s]
        v = tasks.tangent_vectors(p, k, float(surface.radius))
        q = p[:, None] + v
        times = {
            "exp": median_seconds(lambda p=p, v=v: surface.exp(p[:, None], v), 3, warm_up=1),
            "log": median_seconds(lambda p=p, q=q: surface.log(p[:, None], q), 3, warm_up=1),
        }
        found.append({"sources": s, "queries": k, **times})
    return found


def of_shapes(weights: str, sizes: Sizes) -> list[dict[str, Any]]:
    """Shapes a second of training and of each prediction, by batch and by ranks."""
    found = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for i in range(sizes.shapes):
            np.savez(folder / f"{i}.npz", points=tasks.torus(sizes.cloud, i).numpy())
        runs = [("embedding", batch, 1) for batch in sizes.batches]
        runs += [(what, 4, ranks) for what in ASKED for ranks in sizes.ranks]
        for what, batch, ranks in dict.fromkeys(runs):
            command = ["predict", "--clouds", name, "--what", what, "--batch", str(batch)]
            found.append({"what": what, "batch": batch, **run(command, weights, ranks)})
    for ranks in sizes.ranks:
        command = ["train", "--points", str(sizes.points), "--queries", str(sizes.train_queries)]
        command += ["--steps", str(sizes.steps)]
        found.append({"what": "training step", "batch": 1, **run(command, weights, ranks)})
    return found


def run(command: list[str], weights: str, ranks: int) -> dict[str, Any]:
    """What `benchmarks.ranks` answers, and the load it ran under."""
    load = round(os.getloadavg()[0], 2)
    given = [*command, "--weights", weights, "--ranks", str(ranks)]
    found = answer(given) if ranks == 1 else python(["-m", "benchmarks.ranks", *given], 1)
    return {"ranks": ranks, "load_before": load, **(found or {})}


def table(queries: list[dict], shapes: list[dict], facts: dict[str, Any]) -> str:
    """Both tables in Markdown."""
    lines = [
        f"Weights `{facts['weights']}`; {facts['processor']}, {facts['cores']} cores, one thread a "
        f"rank, torch {facts['torch']}, load before {facts['load_before']}.\n",
        "| sources | queries a source | Exp | Log | Exp, µs a query | Log, µs a query |",
        "|--:|--:|--:|--:|--:|--:|",
    ]
    for x in queries:
        each = [f"{1e6 * x[k] / (x['sources'] * x['queries']):.2f}" for k in ("exp", "log")]
        cells = [f"{x['sources']:,}", f"{x['queries']:,}", duration(x["exp"]), duration(x["log"])]
        lines.append(f"| {' | '.join(cells + each)} |")
    points, cloud = facts["sizes"]["points"], facts["sizes"]["cloud"]
    lines += [
        f"\nShapes: predictions on clouds of {cloud:,} points, files read and written; a training "
        f"step on {points:,} points. The load is what other programs and the run before left.\n",
        "| what | shapes at once | ranks | shapes a second | MB a shape | load before |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for x in shapes:
        size = f"{x['megabytes_a_shape']:.2f}" if "megabytes_a_shape" in x else "-"
        rate = f"{x['shapes_per_second']:.3g}"
        cells = [x["what"], x["batch"], x["ranks"], rate, size, x["load_before"]]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description="Cost against sources, queries, shapes, ranks.")
    parser.add_argument("--weights", default="base", help="name, directory, hub id or preset:NAME")
    parser.add_argument("--fast", action="store_true", help="tiny sizes, to see that it runs")
    parser.add_argument("--output", type=Path, help=f"folder of the results; {RESULTS}")
    options = parser.parse_args(arguments)
    sizes = Sizes.fast() if options.fast else Sizes()
    torch.set_num_threads(1)
    warn_if_busy()
    facts = machine(1) | {"weights": options.weights, "sizes": asdict(sizes)}
    field = tasks.load_field(options.weights)
    with torch.inference_mode():
        queries = of_queries(field, sizes)
    shapes = of_shapes(options.weights, sizes)
    fast = Path(tempfile.gettempdir()) / "riemlayer-benchmarks"
    folder = options.output or (fast if options.fast else RESULTS)
    results = {"machine": facts, "queries": queries, "shapes": shapes}
    write_results(folder, "axes", results, table(queries, shapes, facts))


if __name__ == "__main__":
    main()
