"""Clock and memory: medians of repeated calls, peak memory of a task in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[1]


def median_seconds(run: Callable[[], object], repeats: int, warm_up: int = 2) -> float:
    """Median wall time of `repeats` calls after `warm_up` calls that do not count."""
    for _ in range(warm_up):
        run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return median(times)


def python(arguments: Sequence[str], threads: int, interpreter: str = sys.executable) -> dict:
    """JSON that the last line of a Python command, run from the checkout, prints.

    Raises:
        RuntimeError: the command failed; the message ends with what it wrote.
    """
    environment = os.environ | {"OMP_NUM_THREADS": str(threads)}
    done = subprocess.run(
        [interpreter, *arguments], capture_output=True, text=True, cwd=ROOT, env=environment
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)} failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def memory(entry: str) -> float:
    """Megabytes of an entry of /proc/self/status: VmRSS, memory now, or VmHWM, the most so far.

    Raises:
        RuntimeError: this system has no such file, or no such entry.
    """
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.is_file() else []
    for line in lines:
        if line.startswith(f"{entry}:"):
            return int(line.split()[1]) / 1024
    raise RuntimeError(f"peak memory needs {entry} in {status} (Linux); run with --no-memory")


def warn_if_busy() -> None:
    """Says so when other processes compete for the cores."""
    load, cores = os.getloadavg()[0], os.cpu_count() or 1
    if load > 0.3 * cores:
        print(f"load {load:.1f} on {cores} cores: close other programs for final numbers")


def write_results(folder: Path, name: str, results: dict, table: str) -> None:
    """`name`.json and `name`.md in `folder`, and the table on the terminal."""
    folder.mkdir(parents=True, exist_ok=True)
    for suffix, text in ((".json", json.dumps(results, indent=1)), (".md", table)):
        path = folder / f"{name}{suffix}"
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        temporary.write_text(text + "\n")
        temporary.replace(path)
    print(f"{table}\n\nwritten to {folder}/{name}.json and {name}.md")
