"""Results as Markdown: the paper's tables, winners bold, the paper's own numbers beside ours."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from riemlayer.tables import paper
from riemlayer.tables.run import Results
from riemlayer.tables.systems import NOTES, TITLES, UNRANKED

COLUMNS = (
    ("mdd", "E_MDD", 3),
    ("mdd_clip", "E_MDD, edges clipped at 1", 3),
    ("angle", "E_angle (degrees)", 1),
    ("log_end", "Log end", 4),
    ("exp", "E_Exp", 4),
)
TIMES = (
    ("prepare", "prepare (ms)"),
    ("log", "Log, one source (ms)"),
    ("exp", "Exp, one source (ms)"),
)
SECTIONS = ("r0.5", "r0.25", "r0.1", "r0.5_tight", "r0.25_tight", "r0.1_tight")
AT_P = (
    ("exp_zero", "Exp zero"),
    ("exp_differential", "Exp differential"),
    ("log_zero", "Log zero"),
    ("log_differential", "Log differential"),
)
Row = Mapping[str, float]


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def number(value: float | None, digits: int) -> str:
    """Fixed digits; in powers of ten where they would show nothing; a dash where there is none."""
    if value is None:
        return "–"
    tiny = value != 0 and abs(value) < 0.5 * 10**-digits
    return f"{value:.1e}" if tiny or abs(value) >= 1e4 else f"{value:.{digits}f}"


def ranked(rows: Mapping[str, Row], key: str) -> set[str]:
    """Names of the rows with the smallest value of a column, oracles left out."""
    values = {name: row[key] for name, row in rows.items() if name not in UNRANKED and key in row}
    return {name for name, value in values.items() if value == min(values.values())}


def group_table(results: Results, group: str, section: str = "r0.5", times: bool = True) -> str:
    """Tables 1 and 2 for one group: metrics within a radius, and times; the best are bold."""
    means = {name: result["groups"][group] for name, result in results.items()}
    means = {name: mean for name, mean in means.items() if mean["shapes"]}
    rows = {name: mean.get(section, {}) for name, mean in means.items()}
    best = {key: ranked(rows, key) for key, _, _ in COLUMNS}
    lines = []
    for name, row in rows.items():
        cells = [number(row.get(key), digits) for key, _, digits in COLUMNS]
        for i, (key, _, _) in enumerate(COLUMNS):
            if name in best[key]:
                cells[i] = f"**{cells[i]}**"
        if times:
            seconds = means[name].get("time", {})
            cells += [number(_milli(seconds.get(key)), 1) for key, _ in TIMES]
        lines.append([TITLES.get(name, name), *cells])
    lines += _paper_rows(group, times) if section == "r0.5" else []
    header = [group, *(title for _, title, _ in COLUMNS), *(t for _, t in TIMES if times)]
    return markdown(header, lines)


def _paper_rows(group: str, times: bool) -> list[list[str]]:
    if group not in paper.COUNTERPART:
        return []
    category, table = paper.COUNTERPART[group]
    lines = []
    for name, row in table[category].items():
        cells = [number(row.get(key), digits) for key, _, digits in COLUMNS]
        if times:
            per_query = (row.get("log_time"), row.get("exp_time"))
            cells += ["–", *(number(_milli(x), 1) for x in per_query)]
        title = "ours" if name == "paper" else name.capitalize()
        lines.append([f"*paper, {category}: {title}*", *(f"*{cell}*" for cell in cells)])
    return lines


def at_p_table(results: Results) -> str:
    """Table 4: Eqs (10) to (12), mean over all shapes."""
    lines = []
    for name, result in results.items():
        rows = [g for g in result["groups"].values() if g["shapes"] and "at_p" in g]
        weight = sum(g["shapes"] for g in rows)
        cells = []
        for key, _ in AT_P:
            have = [g for g in rows if key in g["at_p"]]
            total = sum(g["shapes"] * g["at_p"][key] for g in have)
            cells.append(number(total / weight if have else None, 4))
        if rows:
            lines.append([TITLES.get(name, name), *cells])
    lines.append(["*paper: ours*", *(f"*{number(paper.TABLE_4[key], 3)}*" for key, _ in AT_P)])
    return markdown(["Table 4", *(title for _, title in AT_P)], lines)


def ablation_table(
    results: Results, facts: Mapping[str, Mapping], variants: Sequence[str], group: str, title: str
) -> str:
    """Tables 3 and 5: variants trained under one budget; the cost of a step relative to the first.

    Args:
        results: of `run`, a method a variant.
        facts: what the ablation command wrote: steps, seconds_a_step, parameters of each variant.
        variants: rows, in order; those without results are left out.
        group: of the shapes.
        title: of the first column.
    """
    shown = [
        name for name in variants if name in results and results[name]["groups"][group]["shapes"]
    ]
    rows = {name: results[name]["groups"][group]["r0.5"] for name in shown}
    best = {key: ranked(rows, key) for key, _, _ in COLUMNS}
    published = paper.TABLE_3 | paper.TABLE_5
    lines = []
    for name in shown:
        cells = [number(rows[name].get(key), digits) for key, _, digits in COLUMNS]
        cells = [
            f"**{c}**" if name in best[k] else c
            for c, (k, _, _) in zip(cells, COLUMNS, strict=True)
        ]
        cost = facts[name]["seconds_a_step"] / facts[shown[0]]["seconds_a_step"]
        cells += [f"{facts[name]['steps']:,}", f"{cost:.2f}x", _published(published.get(name))]
        lines.append([name.replace("_", " "), *cells])
    header = [
        title,
        *(t for _, t, _ in COLUMNS),
        "steps",
        "cost of a step",
        "*paper: E_MDD / E_angle / E_Exp*",
    ]
    return markdown(header, lines)


def _published(row: paper.Row | None) -> str:
    return "–" if row is None else f"*{row['mdd']} / {row['angle']} / {row['exp']}*"


def report(results: Results, facts: Mapping[str, object], kept: int) -> str:
    """The whole report: every group, every radius and mask, Table 4, settings, failures, notes."""
    groups = ordered(results)
    parts = ["# Tables", ", ".join(f"{k} {v}" for k, v in facts.items())]
    for group in groups:
        count = max(r["groups"][group]["shapes"] for r in results.values())
        parts += [f"## {group} ({count} shapes)", group_table(results, group)]
        for section in SECTIONS[1:]:
            parts += [
                f"### {group}, {described(section)}",
                group_table(results, group, section, False),
            ]
    parts += ["## At the source, Eqs (10) to (12)", at_p_table(results), "## Settings"]
    parts.append("\n".join(f"- {name}: `{r['settings']}`" for name, r in results.items()))
    failed = failures(results)
    parts += ["## Failures", "\n".join(f"- {line}" for line in failed) or "None."]
    parts += ["## Notes", "\n".join(f"- {note}" for note in NOTES)]
    if kept:
        parts.append(
            f"- {kept} rows, with their times, were kept from an earlier, interrupted run."
        )
    return "\n\n".join(parts) + "\n"


def ordered(results: Results) -> list[str]:
    """Groups in the order of the paper's tables, then the others by name."""
    groups = next(iter(results.values()))["groups"]
    known = [name for name in paper.COUNTERPART if name in groups]
    return known + sorted(set(groups) - set(known))


def failures(results: Results) -> list[str]:
    """One line for each shape that a method could not do, with the reason."""
    return [
        f"{name} on {shape}: {reason}"
        for name, result in results.items()
        for shape, reason in result["failed"].items()
    ]


def described(section: str) -> str:
    """A mask in words: "r0.25_tight" -> "radius 0.25, shortest geodesics only"."""
    radius, _, tight = section.removeprefix("r").partition("_")
    return f"radius {radius}" + (", shortest geodesics only" if tight else "")


def _milli(seconds: float | None) -> float | None:
    return None if seconds is None else 1e3 * seconds
