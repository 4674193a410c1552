"""The paper's tables by one command: every system on shapes that training never saw.

    python -m riemlayer.tables                    procedural shapes made on the spot, and thin ones
    python -m riemlayer.tables DIR                prepared shapes <group>/<name>.npz, or meshes
    python -m riemlayer.tables DIR --fast         a first look in a minute

Writes tables.md, tables.json and the figures to the output folder. A run that was cut off goes on
at the shape where it stopped.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import torch

from riemlayer.tables import render
from riemlayer.tables.evaluate import Shape
from riemlayer.tables.machine import machine
from riemlayer.tables.run import VERSION, Results, Rows, find_shapes, run, write_json
from riemlayer.tables.shapes import THIN, Preparation, prepare_shapes, procedural_shapes
from riemlayer.tables.sweeps import POINTS
from riemlayer.tables.systems import systems

METHODS = "base,heat,projection,tracing,mesh-affine,mesh-heat,mesh-tracer,floor"
FAST_SOURCES = 2


def main(argv: Sequence[str] | None = None) -> None:
    """The command."""
    options = _parser().parse_args(argv)
    out: Path = options.out
    try:
        if options.ablations and not (options.ablations / "ablation.json").is_file():
            raise ValueError(f"--ablations must hold ablation.json, {options.ablations} does not")
        folder = _prepared(options.directory, out / "shapes", options.fast)
        groups = options.groups.split(",") if options.groups else None
        limit = options.limit or (1 if options.fast else None)
        sources = options.sources or (FAST_SOURCES if options.fast else None)
        shapes = find_shapes(folder, groups, limit)
        fields = {"base": options.weights} | ({"paper": options.paper} if options.paper else {})
        methods = systems([*options.methods.split(","), *list(fields)[1:]], fields)
    except (ValueError, FileNotFoundError) as error:
        raise SystemExit(f"riemlayer.tables: {error}") from error
    rows = Rows(out / "rows.jsonl")
    results = run(shapes, methods, sources, rows)
    facts = machine(torch.get_num_threads())
    text = render.report(results, facts, rows.hits)
    written = {"version": VERSION, "machine": facts, "kept": rows.hits, "methods": results}
    if options.ablations:
        ablations, table = ablated(options.ablations, shapes, sources, rows)
        written, text = written | {"ablations": ablations}, f"{text}\n{table}\n"
    write_json(out / "tables.json", written)
    (out / "tables.md").write_text(text, "utf-8")
    for group in shapes:
        print(render.group_table(results, group), end="\n\n")
    print(render.at_p_table(results), end="\n\n")
    for line in render.failures(results):
        print(f"FAILED {line}")
    if not options.no_figures:
        swept = draw(written, shapes, options.weights, options.fast, out)
        write_json(out / "tables.json", written | {"sweeps": swept})
    print(f"written to {out}/tables.md, tables.json")


def ablated(
    folder: Path, shapes: dict[str, list[Path]], sources: int | None, rows: Rows
) -> tuple[dict, str]:
    """Tables 3, 5 and ours: what `lightning_modules.ablation` trained, group by group."""
    facts = json.loads((folder / "ablation.json").read_text("utf-8"))["variants"]
    weights = {name: str(folder / name) for name in facts}
    results = run(shapes, systems(list(weights), weights), sources, rows)
    tables = {}
    for name, row in facts.items():
        tables.setdefault(row["table"], []).append(name)
    parts = [
        render.ablation_table(results, facts, variants, group, f"{title}: {group}")
        for title, variants in tables.items()
        for group in render.ordered(results)
    ]
    return {"facts": facts, "methods": results}, "\n\n".join(parts)


def draw(
    written: Results, shapes: dict[str, list[Path]], weights: str, fast: bool, out: Path
) -> Results:
    """All figures in `out`, and the numbers that they needed besides the tables."""
    from riemlayer import ExpLogField
    from riemlayer.tables import figures, sweeps

    field = ExpLogField.from_pretrained(weights)
    figures.error_against_radius(written, out / "error_against_radius.png")
    few = [Shape.load(paths[0], FAST_SOURCES) for paths in shapes.values()][: 1 if fast else 4]
    coarse = slice(None, None, 3 if fast else 1)
    points = POINTS[:2] if fast else POINTS
    with torch.inference_mode():
        swept = {
            "noise": sweeps.noise_sweep(field, few, sweeps.LEVELS[coarse]),
            "density": sweeps.density_sweep(field, few, sweeps.DENSITIES[coarse]),
            "points": sweeps.point_times(field, points, repeats=1 if fast else 3),
            "sources": sweeps.source_times(field, sweeps.SOURCES[coarse], repeats=1 if fast else 3),
        }
    figures.error_against_noise(swept["noise"], out / "error_against_noise.png")
    figures.error_against_density(swept["density"], out / "error_against_density.png")
    figures.time_against_points(swept["points"], out / "time_against_points.png")
    figures.time_against_sources(swept["sources"], out / "time_against_sources.png")
    compared = systems(["base", "heat", "projection"], {"base": weights})
    for group, paths in shapes.items():
        figures.checkerboards(Shape.load(paths[0]), compared, out / f"checkerboards_{group}.png")
    return swept


def _prepared(directory: Path | None, out: Path, fast: bool) -> Path:
    """A folder of prepared shapes: the given one, or `out` filled from the given meshes."""
    if directory is None:
        workers = 1 if fast else 2
        _tell(procedural_shapes(2 if fast else 24, out, workers=workers))
        few = 1 if fast else len(THIN)
        _tell(procedural_shapes(few, out, workers=workers, kinds=THIN, group="thin"))
        return out
    if not directory.is_dir():
        raise ValueError(
            f"directory must be a folder of meshes or prepared shapes, got {directory}"
        )
    if any(directory.glob("*/*.npz")):
        return directory
    _tell(prepare_shapes(directory, out, workers=1 if fast else 2))
    return out


def _tell(prepared: Preparation) -> None:
    """What could not be prepared, and why."""
    for name, reason in prepared.failures.items():
        print(f"NOT PREPARED {name}: {reason}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m riemlayer.tables",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add(
        "directory", type=Path, nargs="?", help="prepared shapes or meshes; procedural ones if none"
    )
    add("--fast", action="store_true", help="one shape a group, two sources a shape")
    add("--groups", help="comma-separated; all")
    add("--methods", default=METHODS, help="comma-separated (default %(default)s)")
    add("--weights", default="base", help="name or folder of the field's weights (default base)")
    add("--paper", help="folder of a trained `paper` preset, for a row of its own")
    add("--ablations", type=Path, help="what lightning_modules.ablation wrote, for Tables 3 and 5")
    add("--limit", type=int, help="shapes a group; all")
    add("--sources", type=int, help="sources a shape; all")
    add("--no-figures", action="store_true")
    add("-o", "--out", type=Path, default=Path("tables"), help="output folder (default tables)")
    return parser


if __name__ == "__main__":
    main()
