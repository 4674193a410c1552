"""The bill for a thousand, a million and a billion shapes, from what was measured.

    python -m benchmarks.bill --cores 1000 --price 0.04

reads axes.json and scaling.json of benchmarks/results and writes bill.json and bill.md there. Only
divisions: nothing is measured here, and what is assumed is named in the text.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from benchmarks.measure import write_results
from benchmarks.speed import RESULTS

COUNTS = (10**3, 10**6, 10**9)
BATCH = 4


def row(what: str, shapes: list[dict[str, Any]], cores: int, price: float) -> dict[str, Any]:
    """What one kind of work costs for each of `COUNTS`.

    Args:
        what: as in axes.json.
        shapes: the measured rows there.
        cores: of the cluster, one rank each.
        price: of a core for an hour.

    Raises:
        ValueError: the work was not measured on one rank and on two.
    """
    rates = {x["ranks"]: x for x in shapes if x["what"] == what and x["batch"] in (1, BATCH)}
    if not {1, 2} <= rates.keys():
        raise ValueError(f"axes.json must hold {what} on 1 and 2 ranks; run benchmarks.axes again")
    alone, pair = (rates[n]["shapes_per_second"] for n in (1, 2))
    efficiency = min(1.0, pair / (2 * alone))
    megabytes = rates[1].get("megabytes_a_shape")
    bills = []
    for count in COUNTS:
        hours = count / alone / 3600 / efficiency
        bills.append(
            {
                "shapes": count,
                "core_hours": hours,
                "cluster_hours": hours / cores,
                "cost": hours * price,
                "terabytes": None if megabytes is None else count * megabytes / 2**20,
            }
        )
    return {"what": what, "shapes_per_second": alone, "efficiency": efficiency, "bills": bills}


def encoding(fit: dict[str, float], points: int, leaves: int) -> dict[str, float]:
    """Seconds to encode one cloud by the line of scaling.json, part by part."""
    parts = {"fixed": fit["fixed"], "points": fit["point"] * points, "leaves": fit["leaf"] * leaves}
    return {"cloud_points": points, **parts, "seconds": sum(parts.values())}


def table(results: dict[str, Any]) -> str:
    """The bill in Markdown, with its arithmetic."""
    cores, price, machine = (results[k] for k in ("cores", "price", "machine"))
    first = results["rows"][0]
    bill = first["bills"][1]
    rate, efficiency = first["shapes_per_second"], first["efficiency"]
    lines = [
        f"Measured on {machine['processor']}, {machine['cores']} cores, with a load of "
        f"{machine['load_before']} before (benchmarks/results/axes.json). Assumed: {cores:,} such "
        f"cores, one rank each, as efficient together as two were; {price} USD a core and hour.\n",
        f"For instance {first['what']}, a million shapes: 10^6 / ({rate:.3g} shapes a second) / "
        f"3600 / (efficiency {efficiency:.2f}) = {number(bill['core_hours'])} core "
        f"hours; / {cores:,} = {number(bill['cluster_hours'])} hours; x {price} = "
        f"{number(bill['cost'])} USD.\n",
        "| what | shapes | core hours | hours on the cluster | USD | TB written |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for work in results["rows"]:
        for x in work["bills"]:
            size = "-" if x["terabytes"] is None else number(x["terabytes"])
            cells = [number(x[k]) for k in ("core_hours", "cluster_hours", "cost")]
            power = f"10^{len(str(x['shapes'])) - 1}"
            lines.append(f"| {' | '.join([work['what'], power, *cells, size])} |")
    encoded = results["encoding"]
    lines.append(
        f"\nEncoding alone, by the line of scaling.json ({results['encoding_threads']} threads, "
        f"load {results['encoding_load']} before):\n"
    )
    lines += ["| points | fixed | points' part | leaves' part | seconds |", "|--:|--:|--:|--:|--:|"]
    for x in encoded:
        parts = [f"{x[k]:.3f}" for k in ("fixed", "points", "leaves", "seconds")]
        cells = [f"{x['cloud_points']:,}", *parts]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def number(x: float) -> str:
    """Three digits, with commas where there are more before the point.

    >>> number(1234567.0), number(12.345), number(0.0012345)
    ('1,230,000', '12.3', '0.00123')
    """
    rounded = float(f"{x:.3g}")
    return f"{rounded:,.0f}" if rounded >= 100 else f"{rounded:.3g}"


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description="The bill for many shapes.")
    parser.add_argument("--cores", type=int, default=1000, help="of the cluster")
    parser.add_argument("--price", type=float, default=0.04, help="USD of a core for an hour")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder to read from")
    parser.add_argument("--output", type=Path, help="folder to write to; that of the results")
    options = parser.parse_args(arguments)
    axes, scaling = (
        json.loads((options.results / f"{name}.json").read_text()) for name in ("axes", "scaling")
    )
    kinds = list(dict.fromkeys(x["what"] for x in axes["shapes"]))
    results = {
        "machine": axes["machine"],
        "cores": options.cores,
        "price": options.price,
        "rows": [row(what, axes["shapes"], options.cores, options.price) for what in kinds],
        "encoding": [
            encoding(scaling["fit"], x["points"], x["leaves"]) for x in scaling["one_cloud"]
        ],
        "encoding_threads": scaling["facts"]["threads"],
        "encoding_load": scaling["facts"]["load_before"],
    }
    write_results(options.output or options.results, "bill", results, table(results))


if __name__ == "__main__":
    main()
