"""Every system on every prepared shape of a directory, resumable at the shape where it stopped."""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

from riemlayer.tables.evaluate import Shape, applies, evaluate, pool, summarise

VERSION = 4
"""Raised when what a row says or how it is computed changes: kept rows of before do not count."""

Results = dict[str, Any]


class Rows:
    """Rows of earlier runs in a file of JSON lines, keyed by system, sources and the shape's bytes.

    A line is written as soon as a row is known; one that a killed run left unfinished is ignored.
    """

    def __init__(self, path: Path | None = None):
        self.hits = 0
        self._path = path
        self._rows: dict[str, dict] = {}
        if path is not None and path.exists():
            for line in path.read_text("utf-8").splitlines():
                try:
                    entry = json.loads(line)
                except json.JSONDecodeError:
                    continue
                self._rows[entry["key"]] = entry["row"]

    def get(self, key: str, compute: Callable[[], dict]) -> dict:
        """The row of `key`, computed and, unless it failed, written down when it is not known."""
        if key in self._rows:
            self.hits += 1
            return self._rows[key]
        row = compute()
        if self._path is not None and "failed" not in row:
            self._rows[key] = row
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with open(self._path, "a+b") as file:
                file.seek(0, os.SEEK_END)
                if file.tell():
                    file.seek(-1, os.SEEK_END)
                    if file.read(1) != b"\n":
                        file.write(b"\n")
                file.write(json.dumps({"key": key, "row": row}).encode() + b"\n")
        return row


def find_shapes(
    root: Path, groups: Sequence[str] | None = None, limit: int | None = None
) -> dict[str, list[Path]]:
    """Files `<group>/<name>.npz` under `root`, at most `limit` a group.

    Raises:
        ValueError: there are none, or a named group has none.
    """
    names = groups or sorted({path.parent.name for path in root.glob("*/*.npz")})
    shapes = {name: sorted((root / name).glob("*.npz"))[:limit] for name in names}
    empty = [name for name, paths in shapes.items() if not paths] if shapes else ["*"]
    if empty:
        raise ValueError(f"{root} must hold <group>/<name>.npz files, found none in {empty}")
    return shapes


def run(
    shapes: Mapping[str, Sequence[Path]],
    methods: Mapping[str, object],
    sources: int | None = None,
    rows: Rows | None = None,
) -> Results:
    """Evaluate every method on every shape; failures are kept with their reason.

    Args:
        shapes: files of each group.
        methods: by the name of their row; a method's `repr` must tell its settings apart.
        sources: sources a shape; all when None.
        rows: rows of earlier runs, which are not computed again.

    Returns:
        {method: {"settings", "shapes": {group: {name: row}}, "groups": {group: row}, "failed":
        {"group/name": reason}}}. Rows hold means over sources (of times the median), of one shape
        or of all sources of the group; "shapes" of a group's row says how many it has.
    """
    from tqdm import tqdm

    rows = rows or Rows()
    results: Results = {
        name: {"settings": repr(m), "shapes": {}, "groups": {}, "failed": {}}
        for name, m in methods.items()
    }
    tables = {name: {group: {} for group in shapes} for name in methods}
    flat = [(group, path) for group, paths in shapes.items() for path in paths]
    bar = tqdm(flat, unit="shape", disable=None)
    for group, path in bar:
        bar.set_postfix_str(f"{group}/{path.stem}")
        try:
            shape, fingerprint = Shape.load(path, sources), zlib.crc32(path.read_bytes())
        except (ValueError, OSError, EOFError, BadZipFile) as error:
            for result in results.values():
                result["failed"][f"{group}/{path.stem}"] = f"{type(error).__name__}: {error}"
            continue
        for name, method in methods.items():
            if not applies(method, shape):
                continue
            key = f"{VERSION}|{method!r}|{sources}|{group}/{path.stem}|{fingerprint:08x}"
            row = rows.get(key, lambda m=method, x=shape: _row_or_reason(m, x))
            if "failed" in row:
                results[name]["failed"][f"{group}/{path.stem}"] = row["failed"]
            else:
                tables[name][group][path.stem] = row
    for name, groups in tables.items():
        for group, found in groups.items():
            results[name]["shapes"][group] = {k: summarise(row) for k, row in found.items()}
            mean = summarise(pool(list(found.values())))
            results[name]["groups"][group] = mean | {"shapes": len(found)}
    return results


def write_json(path: Path, value: object) -> None:
    """Write through a temporary file, so that `path` is never cut short."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(json.dumps(value, indent=1), "utf-8")
    os.replace(temporary, path)


def _row_or_reason(method: object, shape: Shape) -> dict:
    """`evaluate`, or the reason why it could not."""
    try:
        return evaluate(method, shape)
    except (ValueError, RuntimeError, ArithmeticError) as error:
        return {"failed": f"{type(error).__name__}: {error}"}
