"""Writes the README's tables from the JSON and Markdown that the benchmarks wrote.

    python -m benchmarks.readme

fills every block between `<!-- NAME -->` and `<!-- end NAME -->`; a test fails where they differ.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

from riemlayer.tables import render

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"


def accuracy() -> str:
    """Group means at radius 0.5 on the paper's mask, a table a group, and Table 4."""
    results = json.loads((RESULTS / "tables.json").read_text("utf-8"))["methods"]
    groups = render.ordered(results)
    return "\n\n".join(
        [*(render.group_table(results, group) for group in groups), render.at_p_table(results)]
    )


def procedural() -> str:
    """The same of the procedural shapes that `python -m riemlayer.tables` makes."""
    results = json.loads((RESULTS / "procedural" / "tables.json").read_text("utf-8"))["methods"]
    return "\n\n".join(render.group_table(results, group) for group in render.ordered(results))


def motions() -> str:
    """The table that `benchmarks.motions` wrote."""
    return (RESULTS / "motions.md").read_text("utf-8").strip()


def near() -> str:
    """The table that `benchmarks.near` wrote."""
    return (RESULTS / "near.md").read_text("utf-8").strip()


def exact() -> str:
    """The table that `benchmarks.exact` wrote."""
    return (RESULTS / "exact.md").read_text("utf-8").strip()


def speed() -> str:
    """The table that `benchmarks.speed` wrote."""
    return (RESULTS / "speed.md").read_text("utf-8").strip()


def deploy() -> str:
    """The tables that `benchmarks.deploy` wrote."""
    return (RESULTS / "deploy.md").read_text("utf-8").strip()


def card() -> str:
    """Facts of the packaged weights' model card."""
    facts = json.loads((ROOT / "riemlayer" / "weights" / "base.json").read_text("utf-8"))
    training = facts["training"]
    shapes = ", ".join(f"{count} from {name}" for name, count in training["shapes"].items())
    return "\n".join(
        [
            f"- **Parameters** {training['parameters']:,}, stored as float16.",
            f"- **Training** last {training['steps']:,} steps in {training['hours']} hours, "
            f"shapes a step: {training['shapes_a_step']}; {facts['time']}. The runs, each from the "
            "weights of the one before:",
            *(f"  {i}. {run}." for i, run in enumerate(facts["history"], 1)),
            f"- **Shapes** {sum(training['shapes'].values())}: {shapes}.",
            *(f"- **{name.capitalize()}** {text}" for name, text in facts["data"].items()),
            f"- **Limits** {facts['limits']}",
            f"- **Licence** {facts['licence']}",
        ]
    )


BLOCKS: dict[str, Callable[[], str]] = {
    "accuracy": accuracy,
    "procedural": procedural,
    "motions": motions,
    "near": near,
    "exact": exact,
    "speed": speed,
    "deploy": deploy,
    "card": card,
}


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
