"""Why not project? The same network on log maps by the field, by projection and by heat solvers.

    OMP_NUM_THREADS=1 python -m benchmarks.why_not_project                 all of it
    OMP_NUM_THREADS=1 python -m benchmarks.why_not_project --resume        the rows that are missing
    OMP_NUM_THREADS=1 python -m benchmarks.why_not_project --timing-only   seconds a shape alone

A network of three tangent convolutions labels the points of shapes on which near in space and near
on the surface differ (benchmarks/labelled.py). Its edges are the same for all methods: of each
point up to 24 others within a chord of 0.2, drawn at random. So are data, frames, seeds and steps.
What differs is where the neighbours lie in the tangent plane, and which of them are dropped because
they are farther than 0.2 along the surface. Two tasks:

    few labels    figures and sheets; one point in twenty carries its label, one in seven of those a
                  wrong one; inputs are these alone, so the network has to carry them along.
    coordinates   figures; the label of a part from the points' coordinates.

All methods see the same 2,000 points; `MeshVectorHeatSolver` sees the mesh as well, and so does the
projection with the mesh's normals, as a scanner would give them. "Exp comes back": edges along
which Exp of the log misses the neighbour are dropped. "Normals within 90°": edges between normals
that differ more are dropped; without a mesh they are PCA normals, with signs spread from point to
point. Accuracy is that on shapes that training did not see, at points without a label. Projection's
PCA plane and the heat solver's diffusion time are those with the least error of the logs of a
quarter of the points of two training shapes. Seconds are of one core.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import mean, median, stdev
from typing import NamedTuple

import torch

from benchmarks.labelled import labelled
from benchmarks.log_edges import Logs, Method, Settings, tuned
from benchmarks.measure import warn_if_busy, write_results
from benchmarks.segmenter import RADIUS, TASKS, Example, Graph, Patches, geometry, graph, learn
from benchmarks.tasks import load_field
from riemlayer import ExpLogField
from riemlayer.tables.machine import machine

RESULTS = Path(__file__).parent / "results"
NAME = "why_not_project"


@dataclass(frozen=True)
class Sizes:
    """How much is run."""

    points: int = 2_000
    train: int = 4
    """Shapes of each kind."""
    test: int = 4
    epochs: int = 24
    seeds: int = 3
    timed: int = 2
    """Shapes of each kind, where only times are taken."""

    @classmethod
    def fast(cls) -> Sizes:
        """Enough to see that everything runs."""
        return cls(600, 1, 1, 1, 2, 1)


class Row(NamedTuple):
    """A method's answers."""

    seconds: list[float]
    """Of one core for preprocessing, one a shape."""
    accuracy: dict[str, list[float]]
    """One a seed, of each task and kind of shape."""


def seconds_of(method: Method, own: Graph) -> tuple[float, Logs]:
    """Processor time of a method's logs along all edges, set-up and encoding included."""
    start = time.process_time()
    logs = method(own.shape, own.edge_index)
    return time.process_time() - start, logs


def accuracies(train: list[Example], test: list[Example], sizes: Sizes) -> dict[str, list[float]]:
    """Of a method, by task and kind."""
    found: dict[str, list[float]] = {}
    for task, kinds in TASKS.items():
        known, new = ([x for x in part if x[0].shape.kind in kinds] for part in (train, test))
        for seed in range(sizes.seeds):
            for kind, share in learn(task, known, new, sizes.epochs, seed).items():
                found.setdefault(f"{task}: {kind}s", []).append(share)
    return found


def run(field: ExpLogField, sizes: Sizes, results: dict, save: Callable[[], None]) -> None:
    """Fills the rows that `results` lacks in, and saves after each."""
    kinds = ("figure", "sheet")
    train = [graph(labelled(k, i, sizes.points), i) for k in kinds for i in range(sizes.train)]
    test = [
        graph(labelled(k, 1_000 + i, sizes.points), i) for k in kinds for i in range(sizes.test)
    ]
    if "settings" not in results["facts"]:
        some = [(g.shape, g.edge_index[:, g.edge_index[1] % 4 == 0]) for g in (train[0], train[-1])]
        settings = tuned(some, RADIUS)
        results["facts"]["settings"] = settings._asdict()
    methods = Settings(**results["facts"]["settings"]).methods(field)
    results["facts"]["methods"] = list(methods)
    for name, method in methods.items():
        if name in results["rows"]:
            continue
        done = [(*seconds_of(method, own), own) for own in (*train, *test)]
        ready = [(own, Patches.of(geometry(own, logs))) for _, logs, own in done]
        parts = ready[: len(train)], ready[len(train) :]
        results["rows"][name] = Row([s for s, _, _ in done], accuracies(*parts, sizes))._asdict()
        save()


def timed(methods: dict[str, Method], sizes: Sizes) -> dict[str, list[float]]:
    """Seconds of every method alone, warm."""
    kinds = ("figure", "sheet")
    own = [graph(labelled(k, i, sizes.points), i) for k in kinds for i in range(sizes.timed)]
    return {n: [seconds_of(m, g)[0] for g in (own[0], *own)][1:] for n, m in methods.items()}


def table(results: dict) -> str:
    """Accuracies with the spread over seeds, and seconds, in Markdown."""
    facts, rows = results["facts"], results["rows"]
    columns = list(next(iter(rows.values()))["accuracy"])
    head = " | ".join(["log maps on the edges", *columns, "seconds a shape"])
    lines = [
        f"{facts['points']:,} points a shape, {facts['train']} training and {facts['test']} test "
        f"shapes of each kind, {facts['seeds']} seeds: mean accuracy ± standard deviation over "
        f"seeds. {facts['processor']}, torch {facts['torch']}; seconds of one core, at load "
        f"{facts['load_before']:.1f} on {facts['cores']} cores.\n",
        f"| {head} |",
        "|---" + "|--:" * (len(columns) + 1) + "|",
    ]
    for name, row in rows.items():
        cells = [
            f"{mean(x):.1%} ± {stdev(x) if len(x) > 1 else 0:.1%}" for x in row["accuracy"].values()
        ]
        seconds = f"{median(row['seconds']):.3g}"
        lines.append(f"| {' | '.join([name, *cells, seconds])} |")
    missing = [name for name in facts["methods"] if name not in rows]
    if missing:
        lines.append(f"\nNot measured yet (`--resume` does it): {'; '.join(missing)}.")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description="Why not project?")
    parser.add_argument("--weights", default="base", help="name, directory, hub id or preset:NAME")
    parser.add_argument("--timing-only", action="store_true", help="keep the accuracies of before")
    parser.add_argument("--resume", action="store_true", help="keep the rows of a run cut short")
    parser.add_argument("--fast", action="store_true", help="tiny sizes, to see that it runs")
    parser.add_argument("--output", type=Path, help=f"folder of the results; {RESULTS}")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    warn_if_busy()
    sizes, field = Sizes.fast() if options.fast else Sizes(), load_field(options.weights)
    folder = options.output or (
        Path(tempfile.gettempdir()) / "riemlayer-benchmarks" if options.fast else RESULTS
    )
    wanted = asdict(sizes) | {"weights": options.weights}
    results = {"facts": machine(1) | wanted, "rows": {}}
    if options.resume or options.timing_only:
        results = json.loads((folder / f"{NAME}.json").read_text("utf-8"))
        held = {key: results["facts"][key] for key in wanted}
        if held != wanted:
            raise ValueError(f"the results must be those of {wanted}, got {held}; start afresh")

    def save() -> None:
        write_results(folder, NAME, results, table(results))

    if options.timing_only:
        settings = Settings(**results["facts"]["settings"])
        if missing := set(results["facts"]["methods"]) - set(results["rows"]):
            raise ValueError(f"the results must hold every row, got none of {missing}; --resume")
        for name, seconds in timed(settings.methods(field), sizes).items():
            results["rows"][name]["seconds"] = seconds
        results["facts"] |= machine(1)
        save()
    else:
        run(field, sizes, results, save)


if __name__ == "__main__":
    main()
