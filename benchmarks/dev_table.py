"""The development table: every method on every prepared shape of a directory.

    python -m benchmarks.dev_table DIR --methods heat,projection,tracing,base,floor -o out.json

prints one table a group of shapes and writes all numbers as JSON. With `--cache FILE` the rivals'
numbers are kept: a later run asks a rival only for what changed, and a run that was cut off goes
on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from zipfile import BadZipFile

from benchmarks.evaluate import Shape, applies, evaluate, pool, summarise
from riemlayer.baselines import Heat, MeshHeat, MeshTracer, Neural, Projection, TrueLog, Walking

VERSION = 3
METHODS: dict[str, Callable[[], object]] = {
    "heat": Heat,
    "projection": Projection,
    "tracing": Walking,
    "floor": TrueLog,
    "mesh-affine": MeshHeat,
    "mesh-heat": lambda: MeshHeat("VectorHeat"),
    "mesh-tracer": MeshTracer,
}
PRINTED = ("r0.5", "r0.25", "r0.1", "r0.5_tight")
COLUMNS = {
    "E_MDD": "mdd",
    "MDD<=1": "mdd_clip",
    "E_angle": "angle",
    "angle T": "angle_true",
    "Log end": "log_end",
    "E_Exp": "exp",
}
TIMES = ("prepare", "log", "exp")


class Cache:
    """Results of the rivals in one JSON file, keyed by settings, sources and the shape's bytes."""

    def __init__(self, path: Path | None):
        self.hits = 0
        self._path = path
        self._rows = json.loads(path.read_text()) if path and path.exists() else {}

    def get(self, key: str, compute: Callable[[], dict]) -> dict:
        """The row of `key`, computed and, unless it failed, written down when it is not known."""
        if key in self._rows:
            self.hits += 1
            return self._rows[key]
        row = compute()
        if self._path is not None and "failed" not in row:
            self._rows[key] = row
            write_json(self._path, self._rows)
        return row


def find_shapes(root: Path, groups: list[str] | None, limit: int | None) -> dict[str, list[Path]]:
    """Files `<group>/<name>.npz` under `root`, at most `limit` a group.

    Raises:
        ValueError: a group has no shapes.
    """
    names = groups or sorted({path.parent.name for path in root.glob("*/*.npz")})
    shapes = {name: sorted((root / name).glob("*.npz"))[:limit] for name in names}
    empty = [name for name, paths in shapes.items() if not paths] if shapes else ["*"]
    if empty:
        raise ValueError(f"{root} must hold <group>/<name>.npz files, found none in {empty}")
    return shapes


def run(
    shapes: dict[str, list[Path]], methods: dict[str, object], sources: int | None, cache: Cache
) -> dict:
    """Evaluate every method on every shape; failures are kept with their reason.

    Returns:
        {method: {"settings", "shapes": {group: {name: row}}, "groups": {group: row}, "failed":
        {"group/name": reason}}}. Rows hold means over sources (of times the median), of one shape
        or of all sources of the group; "shapes" of a group's row says how many it has.
    """
    results = {
        name: {"settings": repr(m), "shapes": {}, "groups": {}, "failed": {}}
        for name, m in methods.items()
    }
    tables = {name: {group: {} for group in shapes} for name in methods}
    for group, path in _progress(shapes):
        try:
            shape, fingerprint = Shape.load(path, sources), zlib.crc32(path.read_bytes())
        except (ValueError, OSError, EOFError, BadZipFile) as error:
            for result in results.values():
                result["failed"][f"{group}/{path.stem}"] = f"{type(error).__name__}: {error}"
            continue
        for name, method in methods.items():
            if not applies(method, shape):
                continue
            store = Cache(None) if isinstance(method, Neural) else cache
            key = f"{VERSION}|{method!r}|{sources}|{group}/{path.stem}|{fingerprint:08x}"
            row = store.get(key, lambda m=method, x=shape: _row_or_reason(m, x))
            if "failed" in row:
                results[name]["failed"][f"{group}/{path.stem}"] = row["failed"]
            else:
                tables[name][group][path.stem] = row
    for name, groups in tables.items():
        for group, rows in groups.items():
            results[name]["shapes"][group] = {k: summarise(row) for k, row in rows.items()}
            mean = summarise(pool(list(rows.values())))
            results[name]["groups"][group] = mean | {"shapes": len(rows)}
    return results


def format_table(results: dict, group: str) -> str:
    """One group as text: a block a section, a line a method."""
    lines = []
    for section in PRINTED:
        lines.append(f"{group}, {section}".ljust(26) + "".join(c.rjust(9) for c in COLUMNS))
        if section == PRINTED[0]:
            lines[-1] += "".join(f"{t} ms".rjust(12) for t in TIMES) + "shapes".rjust(8)
        for name, result in results.items():
            mean = result["groups"][group]
            if not mean["shapes"]:
                continue
            line = "  " + name.ljust(24)
            line += "".join(
                _number(mean.get(section, {}).get(k)).rjust(9) for k in COLUMNS.values()
            )
            if section == PRINTED[0]:
                times = (mean.get("time", {}).get(t) for t in TIMES)
                line += "".join(_number(t and 1e3 * t, 1).rjust(12) for t in times)
                line += str(mean["shapes"]).rjust(8)
            lines.append(line)
    return "\n".join(lines)


def write_json(path: Path, value: object) -> None:
    """Write through a temporary file, so that `path` is never cut short."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(json.dumps(value, indent=1))
    os.replace(temporary, path)


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        description="Every method on every prepared shape of a directory."
    )
    parser.add_argument("directory", type=Path, help="holds <group>/<name>.npz")
    parser.add_argument("--groups", help="comma-separated; all")
    parser.add_argument("--methods", default="heat,projection,tracing,base,floor")
    parser.add_argument("--weights", default="base", help="name or path of the field's weights")
    parser.add_argument("--limit", type=int, help="shapes a group; all")
    parser.add_argument("--sources", type=int, help="sources a shape; all")
    parser.add_argument("--cache", type=Path, help="JSON file that keeps the rivals' numbers")
    parser.add_argument("-o", "--output", type=Path, help="JSON file for every number")
    options = parser.parse_args(arguments)
    known = METHODS | {"base": lambda: Neural.from_pretrained(options.weights)}
    names = options.methods.split(",")
    if unknown := set(names) - set(known):
        parser.error(f"--methods must be among {', '.join(known)}; got {', '.join(unknown)}")
    groups = options.groups.split(",") if options.groups else None
    cache = Cache(options.cache)
    results = run(
        find_shapes(options.directory, groups, options.limit),
        {name: known[name]() for name in names},
        options.sources,
        cache,
    )
    for group in next(iter(results.values()))["groups"]:
        print(format_table(results, group), end="\n\n")
    for name, result in results.items():
        for shape, reason in result["failed"].items():
            print(f"FAILED {name} on {shape}: {reason}")
    if cache.hits:
        print(f"{cache.hits} rows, with the times of an earlier run, come from {options.cache}")
    if options.output:
        write_json(options.output, {"version": VERSION, "methods": results})


def _row_or_reason(method: object, shape: Shape) -> dict:
    """`evaluate`, or the reason why it could not."""
    try:
        return evaluate(method, shape)
    except (ValueError, RuntimeError, ArithmeticError) as error:
        return {"failed": f"{type(error).__name__}: {error}"}


def _progress(shapes: dict[str, list[Path]]) -> Iterator[tuple[str, Path]]:
    """(group, path) of every shape, counted on the terminal."""
    flat = [(group, path) for group, paths in shapes.items() for path in paths]
    for done, (group, path) in enumerate(flat):
        if sys.stderr.isatty():
            print(f"\r[{done}/{len(flat)}] {group}/{path.stem}\033[K", end="", file=sys.stderr)
        yield group, path
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr)


def _number(value: float | None, digits: int = 4) -> str:
    if value is None:
        return "-"
    return f"{value:.{digits}f}" if abs(value) < 1e3 else f"{value:.3g}"


if __name__ == "__main__":
    main()
