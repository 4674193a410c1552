"""Faults while samples are made and packed: kill -9 at any moment, a lost worker, a full disk."""

import json
import os
import random
import signal
import subprocess
import threading
import time

import numpy as np
import pytest
from joblib.externals.loky import get_reusable_executor
from tqdm import tqdm

from riemlayer.data.dataset import sample_files
from riemlayer.data.prepare import prepare_meshes, run
from riemlayer.data.run_folder import read_failures
from riemlayer.data.shards import pack


@pytest.fixture(scope="module", autouse=True)
def no_workers_left():
    """The worker processes end with this module, and forks share no lock that dies with them."""
    tqdm.set_lock(threading.RLock())
    yield
    get_reusable_executor().shutdown(wait=True, kill_workers=True)


def contents(folder):
    return {f.name: f.read_bytes() for f in folder.glob("[!.]*") if f.is_file()}


def manifest(folder):
    return [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()]


def shape(i):
    """A cheap job: a sample, now and then a failure."""

    def make():
        import time

        time.sleep(0.02)
        if i % 9 == 4:
            raise ValueError(f"shape {i} is bad")
        return {"v": np.random.default_rng(i).normal(size=(20, 30, 3))}, {"seed": str(i)}

    return make


def killed(work, after):
    """Do `work` in a process that is killed after some seconds; say whether it was still at it."""
    child = os.fork()
    if child == 0:
        try:
            work()
        finally:
            os._exit(0)
    time.sleep(after)
    os.kill(child, signal.SIGKILL)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def kill(work, after):
    """Do `work` until a kill interrupts it, each time sooner: its speed depends on the load."""
    while not killed(work, after):
        after /= 2


def timed(work):
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forked while threads run
def test_twenty_kills_at_any_moment_change_nothing(tmp_path):
    get_reusable_executor().shutdown(wait=True, kill_workers=True)  # none is shared by forks
    whole, often = tmp_path / "whole", tmp_path / "often"
    jobs, rng = {f"s{i:02d}": shape(i) for i in range(48)}, random.Random(0)
    making = timed(lambda: run(jobs, whole, workers=2))
    packing = timed(lambda: pack(whole, whole / "shards", 4))
    get_reusable_executor().shutdown(wait=True, kill_workers=True)
    for i in range(6, 54, 6):  # there is always something left to do
        some = dict(list(jobs.items())[:i])
        kill(lambda some=some: run(some, often, 2), making * rng.uniform(0.1, 0.7))
    run(jobs, often, workers=2)
    for i in range(12):  # other sizes, other shards: each call writes them all
        after = packing * rng.uniform(0, 0.9)
        kill(lambda i=i: pack(often, often / "shards", 3 + i % 3), after)
    pack(often, often / "shards", 4)
    assert len(list((whole / "shards").glob("*.tar"))) == 11
    assert contents(often / "shards") == contents(whole / "shards")
    assert {f.name: f.read_bytes() for f in sample_files(often)} == {
        f.name: f.read_bytes() for f in sample_files(whole)
    }
    assert read_failures(often) == read_failures(whole)


@pytest.mark.slow
def test_a_killed_worker_costs_no_shape(tmp_path):
    """One worker is killed from outside, once: its shape is made all the same."""

    def victim(marker=tmp_path / "killed"):
        import os
        import signal

        if not marker.exists():
            marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return shape(1)()

    jobs = {f"s{i}": shape(i) for i in range(3)} | {"victim": victim}
    report = run(jobs, tmp_path / "out", workers=1)
    assert (report.written, report.failed) == (4, 0)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forked while threads run
def test_the_real_pipeline_killed_and_resumed_gives_the_same_shards(tmp_path):
    import trimesh

    mesh = tmp_path / "box.ply"
    trimesh.creation.box((1, 2, 3)).export(mesh)
    get_reusable_executor().shutdown(wait=True, kill_workers=True)  # none is shared by the fork
    seconds = timed(lambda: prepare_meshes([mesh], tmp_path / "whole", 1))
    get_reusable_executor().shutdown(wait=True, kill_workers=True)
    kill(lambda: prepare_meshes([mesh], tmp_path / "killed", 1), seconds / 2)
    assert prepare_meshes([mesh], tmp_path / "killed", 1).written == 1
    for name in ("killed", "whole"):
        pack(tmp_path / name, tmp_path / name / "shards", 1)
    assert contents(tmp_path / "killed" / "shards") == contents(tmp_path / "whole" / "shards")


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 300 kB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", disk], capture_output=True
    )
    if mounted.returncode:
        pytest.skip("mounting needs root")
    yield disk
    subprocess.run(["umount", "-l", disk], check=True)


@pytest.mark.slow
def test_a_really_full_disk_loses_no_finished_sample(small_disk, tmp_path):
    def large():

        return {"v": np.zeros((20, 300, 3))}, {}  # 144 kB

    jobs = {"a": large, "b": large, "c": large}
    with pytest.raises(OSError, match="No space left"):
        run(jobs, small_disk, workers=1)
    assert [f.stem for f in sample_files(small_disk)] == ["a", "b"]
    assert not list(small_disk.glob(".*.tmp"))
    with pytest.raises(OSError, match="No space left"):
        pack(small_disk, small_disk / "shards", 1)
    assert not list(small_disk.rglob("*.tar"))
    pack(small_disk, tmp_path / "elsewhere", 1)
    assert len(manifest(tmp_path / "elsewhere")) == 2
