"""A former checkpoint outlives a killed write and a full disk."""

import multiprocessing
import os
import resource
import signal
import time

import pytest
import torch

from lightning_modules import AtomicCheckpointIO

pytestmark = pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forks


@pytest.fixture
def path(tmp_path):
    """A checkpoint of step 1."""
    AtomicCheckpointIO().save_checkpoint(state(1), tmp_path / "last.ckpt")
    return tmp_path / "last.ckpt"


def state(step: int) -> dict:
    """So small that torch does not share the work among threads, which a fork does not have."""
    return {"global_step": step, "weights": torch.full((20_000,), float(step))}


def read(path) -> int:
    """The step of a whole checkpoint."""
    found = AtomicCheckpointIO().load_checkpoint(path)
    assert bool((found["weights"] == found["global_step"]).all())
    return found["global_step"]


def in_child(body, *arguments) -> int:
    """Exit code of a forked process."""
    process = multiprocessing.get_context("fork").Process(target=body, args=arguments)
    process.start()
    process.join(30)
    return process.exitcode


def write_and_be_killed(path, function: str) -> None:
    """kill -9 at the first call of a function of `os` while step 2 is written."""
    setattr(os, function, lambda *_: os.kill(os.getpid(), signal.SIGKILL))
    AtomicCheckpointIO().save_checkpoint(state(2), path)


@pytest.mark.parametrize("function", ["fsync", "replace"])
def test_a_killed_write_leaves_the_former_checkpoint_and_the_next_one_succeeds(path, function):
    assert in_child(write_and_be_killed, path, function) == -signal.SIGKILL
    assert read(path) == 1 and len(list(path.parent.iterdir())) == 2
    AtomicCheckpointIO().save_checkpoint(state(3), path)
    assert read(path) == 3 and list(path.parent.iterdir()) == [path]


def write_for_ever(path) -> None:
    for step in range(2, 1_000_000):
        AtomicCheckpointIO().save_checkpoint(state(step), path)


def test_a_writer_killed_at_any_time_leaves_a_whole_checkpoint(path):
    for _ in range(5):
        writer = multiprocessing.get_context("fork").Process(target=write_for_ever, args=(path,))
        before = path.stat().st_ino
        writer.start()
        latest = time.monotonic() + 60
        while path.stat().st_ino == before:
            assert time.monotonic() < latest, "no checkpoint was written"
        writer.kill()
        writer.join(30)
        assert writer.exitcode == -signal.SIGKILL and read(path) >= 1


def write_to_a_full_disk(path) -> None:
    """Files may not grow beyond 50,000 bytes here; exits with 0 where the error says enough."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
    with pytest.raises(OSError, match=r"checkpoint not written; the former one is kept.*last.ckpt"):
        AtomicCheckpointIO().save_checkpoint(state(2), path)


def test_a_full_disk_leaves_the_former_checkpoint_and_nothing_else(path):
    assert in_child(write_to_a_full_disk, path) == 0
    assert read(path) == 1 and list(path.parent.iterdir()) == [path]
