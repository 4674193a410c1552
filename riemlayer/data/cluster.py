"""Jobs on the machines of a Ray or Dask cluster, through joblib's back ends."""

from __future__ import annotations

import os
import pickle
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

ROUND = 16
"""Jobs a core between two times that results come back: joblib's back ends return lists."""
READY = b"ready"
"""What a job's process says once it has imported the job."""
ATTEMPTS = 3
"""Times that a round is started again after machines were lost."""

Job = Callable[[], Any]
Work = Callable[[str, Job, Path], str | None]


@contextmanager
def connected(address: str) -> Iterator[int]:
    """Lets joblib run on a cluster meanwhile; the number of its cores.

    Args:
        address: `ray` for the cluster that RAY_ADDRESS names, this machine where it is not set;
            `ray://HOST:10001` for another one; `tcp://HOST:8786` or `tls://HOST:8786` for a
            scheduler of Dask.

    Raises:
        ValueError: another address, or one where no cluster answers.
    """
    if address == "ray" or address.startswith("ray://"):
        with _ray(None if address == "ray" else address) as cores:
            yield cores
    elif address.startswith(("tcp://", "tls://")):
        with _dask(address) as cores:
            yield cores
    else:
        known = "ray, ray://HOST:PORT or tcp://HOST:PORT (Dask)"
        raise ValueError(f"cluster must be {known}, got {address}")


@contextmanager
def _ray(address: str | None) -> Iterator[int]:
    import ray
    from joblib import parallel_config
    from ray.util.joblib import register_ray

    register_ray()
    try:
        ray.init(address, ignore_reinit_error=True, log_to_driver=False)
    except ConnectionError as error:
        raise ValueError(
            f"no Ray cluster answers at {address or 'RAY_ADDRESS'}: {error}"
        ) from error
    with parallel_config("ray"):
        yield int(ray.cluster_resources()["CPU"])


@contextmanager
def _dask(address: str) -> Iterator[int]:
    from distributed import Client
    from joblib import parallel_config

    try:
        client = Client(address)
    except OSError as error:
        raise ValueError(f"no Dask scheduler answers at {address}: {error}") from error
    with client, parallel_config("dask"):
        yield sum(client.ncores().values())  # pyright: ignore


def cluster_results(
    todo: Mapping[str, Job], out: Path, address: str, work: Work, seconds: int
) -> Iterator[tuple[str, str | None]]:
    """Pairs of name and reason of failure, round by round; all machines see the folder `out`.

    Each job has a process of its own: one that dies takes neither a worker nor other jobs along.
    A round that loses machines starts again with what has no file.

    Raises:
        OSError: a sample could not be written.
        RuntimeError: a round failed each time; finished samples stay.
    """
    queue = iter(todo.items())
    with connected(address) as cores:
        while chunk := dict(islice(queue, ROUND * cores)):
            yield from _round(chunk, out.absolute(), cores, work, seconds)


def _round(
    chunk: Mapping[str, Job], out: Path, cores: int, work: Work, seconds: int
) -> Iterator[tuple[str, str | None]]:
    from joblib import Parallel, delayed

    lost: Exception | None = None
    for _ in range(ATTEMPTS):
        left = {n: job for n, job in chunk.items() if not (out / f"{n}.safetensors").exists()}
        calls = (delayed(alone)(work, n, job, out, seconds) for n, job in left.items())
        try:
            answers = Parallel(n_jobs=cores, batch_size=1)(calls)  # pyright: ignore
        except Exception as error:  # whatever the cluster's library raises: a job's own is returned
            lost = error
            continue
        reasons = dict(zip(left, answers, strict=True))
        failed = next((x for x in answers if isinstance(x, OSError)), None)
        if failed is not None:
            raise failed
        yield from ((name, reasons.get(name)) for name in chunk)
        return
    raise RuntimeError(f"a round on the cluster failed {ATTEMPTS} times: {lost}") from lost


def alone(work: Work, name: str, job: Job, out: Path, seconds: int) -> str | OSError | None:
    """What `work` returns in a process of its own, or the error of the disk that it raised."""
    import cloudpickle

    threads = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
    child = subprocess.run(
        [sys.executable, "-m", "riemlayer.data.cluster"],
        input=cloudpickle.dumps((work, name, job, out)),
        capture_output=True,
        env=os.environ | threads,
    )
    if not child.stdout.startswith(READY):
        said = child.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise RuntimeError(f"riemlayer does not run on {platform.node()}: {' '.join(said)}")
    answer = child.stdout.removeprefix(READY)
    return pickle.loads(answer) if child.returncode == 0 else died(seconds)


def died(seconds: int) -> str:
    """Reason of a job whose process ended before it."""
    return f"the worker died or took more than {seconds} s"


def main() -> None:
    """Does one job that comes on stdin; the answer goes to stdout, and nothing else does."""
    reply = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    work, *arguments = pickle.load(sys.stdin.buffer)
    reply.write(READY)
    reply.flush()
    try:
        answer = work(*arguments)
    except OSError as error:
        answer = error
    with reply:
        pickle.dump(answer, reply)


if __name__ == "__main__":
    main()
