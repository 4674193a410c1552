"""The folder that a run of `prepare` writes to: one run at a time, and what failed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from riemlayer.data.sample_file import whole_or_not_at_all


class FolderInUse(OSError):
    """Another run is writing to the folder."""


@contextmanager
def only_run(out: Path) -> Iterator[None]:
    """Holds a lock of a folder, made where missing, that ends with the process, however it ends.

    Raises:
        FolderInUse: another run holds it.
    """
    from filelock import FileLock, Timeout

    out.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(out / ".lock", timeout=0):
            yield
    except Timeout as error:
        message = f"{out} is being written by another run; wait for its end or name another folder"
        raise FolderInUse(message) from error


def record_failure(out: Path, name: str, reason: str) -> None:
    """Appends a line to failures.jsonl (ours)."""
    with open(out / "failures.jsonl", "a", encoding="utf-8") as file:
        file.write(json.dumps({"name": name, "reason": reason}) + "\n")


def read_failures(out: Path) -> dict[str, str]:
    """Names and reasons of the shapes that could not be prepared, by name (ours).

    A last line that a killed run left half written does not count: its shape is tried again.
    """
    path = out / "failures.jsonl"
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    if lines and not _is_json(lines[-1]):
        del lines[-1]
    found = sorted((json.loads(line) for line in lines), key=lambda x: x["name"])
    return {x["name"]: x["reason"] for x in found}


def drop_half_line(out: Path) -> None:
    """Rewrites a failures.jsonl that does not end with a whole line, for more to be appended."""
    path = out / "failures.jsonl"
    text = path.read_text("utf-8") if path.exists() else ""
    if text and not text.endswith("\n"):
        whole, _, last = text.rpartition("\n")
        lines = [*whole.splitlines(), *([last] if _is_json(last) else [])]
        with whole_or_not_at_all(path) as file:
            file.write("".join(f"{line}\n" for line in lines).encode())


def _is_json(line: str) -> bool:
    try:
        json.loads(line)
    except json.JSONDecodeError:
        return False
    return True
