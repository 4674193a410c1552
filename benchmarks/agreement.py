"""How our rivals' scores agree with those of other code on the same shapes.

    python -m benchmarks.agreement TABLES.json BASELINES.json

compares every metric of heat, projection and tracing that both files have, and writes agreement.md
and agreement.json to benchmarks/results: the number compared, the largest difference, and each one
beyond 5 %.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

from benchmarks.measure import write_results
from benchmarks.speed import RESULTS

METRICS = {
    "mdd": "mdd",
    "mdd_clip": "mdd_cap",
    "angle": "theta",
    "log_end": "logerr_end",
    "exp": "exp",
}
METHODS = {"heat": "heat_interp", "projection": "proj", "tracing": "tracing", "floor": "floor"}
"""Names here and there; of their two heats the one that, as ours, interpolates between points."""
TOLERANCE = 0.05


@dataclass(frozen=True)
class Difference:
    """One metric in both files."""

    group: str
    method: str
    section: str
    metric: str
    ours: float
    theirs: float

    @property
    def relative(self) -> float:
        return self.ours / self.theirs - 1 if self.theirs else float(self.ours != 0)


def differences(ours: dict, theirs: dict) -> Iterator[Difference]:
    """Every number that both have: `methods` of tables.json, and the other code's groups."""
    for group, entry in theirs.items():
        for name, other in METHODS.items():
            mean = ours.get(name, {}).get("groups", {}).get(group)
            row = entry["methods"].get(other)
            if not mean or not row:
                continue
            for section in ("r0.5", "r0.25", "r0.5_tight"):
                for mine, their in METRICS.items():
                    a, b = mean.get(section, {}).get(mine), row.get(section, {}).get(their)
                    if a is not None and b is not None:
                        yield Difference(group, name, section, mine, a, b)


def table(found: list[Difference]) -> str:
    """Summary of each method, and the differences beyond the tolerance."""
    lines = ["| method | numbers | median difference | largest | beyond 5 % |", "|---" * 5 + "|"]
    for name in METHODS:
        sizes = [abs(d.relative) for d in found if d.method == name]
        if sizes:
            beyond = sum(size > TOLERANCE for size in sizes)
            lines.append(
                f"| {name} | {len(sizes)} | {median(sizes):.2%} | {max(sizes):.1%} | {beyond} |"
            )
    lines += ["", "| beyond 5 % | radius | metric | ours | theirs | difference |", "|---" * 6 + "|"]
    for d in found:
        if abs(d.relative) > TOLERANCE:
            where = f"{d.group}, {d.method} | {d.section} | {d.metric}"
            lines.append(f"| {where} | {d.ours:.4f} | {d.theirs:.4f} | {d.relative:+.1%} |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", type=Path, help="tables.json of riemlayer.tables")
    parser.add_argument("baselines", type=Path, help="scores of the other code")
    parser.add_argument("-o", "--out", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    ours = json.loads(options.tables.read_text("utf-8"))["methods"]
    theirs = json.loads(options.baselines.read_text("utf-8"))
    found = list(differences(ours, theirs))
    rows = [asdict(d) | {"relative": d.relative} for d in found]
    write_results(options.out, "agreement", {"differences": rows}, table(found))


if __name__ == "__main__":
    main()
