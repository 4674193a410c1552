"""Writes the README's tables from the JSON and Markdown that the benchmarks wrote.

    python -m benchmarks.readme

fills every block between `<!-- NAME -->` and `<!-- end NAME -->`; a test fails where they differ.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"
COLUMNS = (
    ("mdd", "E_MDD", 3),
    ("mdd_clip", "E_MDD, edges clipped at 1", 3),
    ("angle", "E_angle (degrees)", 1),
    ("log_end", "Log error at end points", 4),
    ("exp", "E_Exp", 4),
)
METHODS = (
    ("base", "**riemlayer `base`**"),
    ("heat", "Heat, point cloud"),
    ("projection", "Projection (Exp: and snap)"),
    ("tracing", "Tracing (heuristic walking)"),
    ("floor", "the true log map (floor)"),
)


def accuracy() -> str:
    """Group means at radius 0.5 on the paper's mask, a table a group; the best of a column bold."""
    table = json.loads((RESULTS / "accuracy.json").read_text("utf-8"))["methods"]
    groups = next(iter(table.values()))["groups"]
    lines = []
    for group in groups:
        rows = {name: table[name]["groups"][group]["r0.5"] for name, _ in METHODS if name in table}
        rivals = {name: row for name, row in rows.items() if name != "floor"}
        lines += [
            f"| {group} | " + " | ".join(title for _, title, _ in COLUMNS) + " |",
            "|---" * (1 + len(COLUMNS)) + "|",
        ]
        for name, title in METHODS:
            if name in rows:
                cells = [_cell(rows[name], rivals, key, digits) for key, _, digits in COLUMNS]
                lines.append(f"| {title} | " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines).rstrip()


def _cell(row: dict, rivals: dict[str, dict], key: str, digits: int) -> str:
    if row.get(key) is None:
        return "–"
    best = min(x[key] for x in rivals.values() if x.get(key) is not None)
    text = f"{row[key]:.{digits}f}"
    return f"**{text}**" if any(row is x for x in rivals.values()) and row[key] == best else text


def speed() -> str:
    """The table that `benchmarks.speed` wrote."""
    return (RESULTS / "speed.md").read_text("utf-8").strip()


def card() -> str:
    """Facts of the packaged weights' model card."""
    facts = json.loads((ROOT / "riemlayer" / "weights" / "base.json").read_text("utf-8"))
    training, data = facts["training"], facts["data"]
    return "\n".join(
        [
            f"- **Parameters** {training['parameters']:,}, stored as float16.",
            f"- **Training** {training['steps']:,} steps of one shape and about 10,000 geodesics; "
            f"{facts['time']}.",
            *(f"- **{name.capitalize()}** {text}" for name, text in data.items()),
            f"- **Limits** {facts['limits']}",
            f"- **Licence** {facts['licence']}",
        ]
    )


BLOCKS: dict[str, Callable[[], str]] = {"accuracy": accuracy, "speed": speed, "card": card}


def filled(text: str) -> str:
    """`text` with every marked block replaced by what the results say now."""
    for name, make in BLOCKS.items():
        pattern = rf"(<!-- {name} -->\n).*?(<!-- end {name} -->)"
        text, count = re.subn(
            pattern, lambda m, make=make: f"{m[1]}{make()}\n{m[2]}", text, flags=re.S
        )
        if count != 1:
            raise ValueError(f"README must hold one block {name!r}, found {count}")
    return text


def main() -> None:
    readme = ROOT / "README.md"
    readme.write_text(filled(readme.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main()
