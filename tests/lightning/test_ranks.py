"""Two ranks, accumulated batches and one large batch have the same gradient; killed ranks."""

import os
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from importlib import util
from pathlib import Path

import pytest
import torch

pytestmark = pytest.mark.filterwarnings("ignore::Warning:lightning")  # it talks of its own matters

ROOT = Path(__file__).parents[2]
PROGRAM = Path(__file__).with_name("ranks.py")
spec = util.spec_from_file_location("ranks", PROGRAM)
ranks = util.module_from_spec(spec)
spec.loader.exec_module(ranks)
PATIENCE = 300
"""Seconds that two ranks may take to start on a busy machine, or the other one to end."""


def environment(**more: str) -> dict[str, str]:
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    return os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "PATH": path} | more


@pytest.fixture(scope="module")
def double_batch(folder, tmp_path_factory) -> dict[str, torch.Tensor]:
    """Gradients of the first step of one process that packs two shapes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("riemlayer.field._has_bfloat16", lambda device: False)
        return gradients(folder, tmp_path_factory.mktemp("double"), batch_size=2)


def gradients(folder, out, **options) -> dict[str, torch.Tensor]:
    recorder = ranks.Gradients(out)
    ranks.fit(folder, out, callbacks=(recorder,), **options)
    return recorder.first


def assert_same_gradients(a: dict, b: dict) -> None:
    largest = max(float(x.abs().max()) for x in b.values())
    assert a.keys() == b.keys() and largest > 1e-3
    for name, x in b.items():
        assert float((a[name] - x).abs().max()) <= 1e-5 * largest, name


def test_two_accumulated_batches_are_a_double_batch(folder, double_batch, tmp_path, monkeypatch):
    monkeypatch.setattr("riemlayer.field._has_bfloat16", lambda device: False)
    once = gradients(folder, tmp_path)
    assert_same_gradients(gradients(folder, tmp_path, accumulate_grad_batches=2), double_batch)
    with pytest.raises(AssertionError):
        assert_same_gradients(once, double_batch)


@pytest.fixture(scope="module")
def killed(folder, tmp_path_factory) -> Path:
    """Where two ranks trained until the second was killed."""
    out = tmp_path_factory.mktemp("killed")
    kill(start(folder, out, "--steps", "400", "--pause", "0.05"), out, victim=1, step=3)
    return out


@pytest.mark.slow
def test_gradients_of_two_ranks_are_those_of_a_double_batch(double_batch, killed):
    for rank in range(2):
        assert_same_gradients(torch.load(killed / f"gradients{rank}.pt"), double_batch)


@pytest.mark.slow
def test_a_run_with_a_killed_rank_ends_and_is_continued(folder, killed):
    """The second rank was killed; then the first is, which writes the checkpoints."""
    first = step_of(killed)
    again = start(folder, killed, "--steps", "400", "--pause", "0.05", "--resume")
    kill(again, killed, victim=0, step=first + 2)
    second = step_of(killed)
    assert 3 <= first < second < 400
    with running(start(folder, killed, "--steps", str(second + 2), "--resume")) as runs:
        assert [run.wait(PATIENCE) for run in runs] == [0, 0]
    assert step_of(killed) == second + 2
    state = torch.load(killed / "last.ckpt", weights_only=False)["state_dict"]
    assert all(bool(x.isfinite().all()) for x in state.values())


def step_of(out: Path) -> int:
    return torch.load(out / "last.ckpt", weights_only=False)["global_step"]


def start(folder, out, *options: str) -> list[subprocess.Popen]:
    """The program on two ranks, which only have each other: nobody looks after them."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    shared = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "WORLD_SIZE": "2", "NODE_RANK": "0"}
    command = [sys.executable, str(PROGRAM), str(folder), str(out), *options]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return [
        subprocess.Popen(command, env=environment(**shared, LOCAL_RANK=str(rank)), **quiet)
        for rank in range(2)
    ]


def kill(runs: list[subprocess.Popen], out: Path, victim: int, step: int) -> None:
    """Kills a rank once both have done a step; the other must end with an error, and in time."""
    end = time.monotonic() + PATIENCE
    with running(runs):
        while any(reached(out, run, rank) < step for rank, run in enumerate(runs)):
            assert time.monotonic() < end, f"step {step} was not reached"
            assert all(run.poll() is None for run in runs), "a rank has ended"
            time.sleep(0.05)
        runs[victim].kill()
        assert runs[1 - victim].wait(PATIENCE) > 0


@contextmanager
def running(runs: list[subprocess.Popen]):
    """Processes that have ended afterwards, also where a test fails."""
    try:
        yield runs
    finally:
        for run in runs:
            run.kill()
            run.wait()


def reached(out: Path, run: subprocess.Popen, rank: int) -> int:
    """Last step that a rank of this run has done."""
    path = out / f"rank{rank}"
    told = path.read_text().split() if path.exists() else []
    return int(told[1]) if len(told) == 2 and int(told[0]) == run.pid else -1


@pytest.mark.slow
def test_the_torchrun_example_runs(folder, tmp_path):
    """Two steps of examples/cluster/torchrun.sh on two ranks, bf16, accumulated; one answer."""
    tiny = ["--preset", "tiny", "--steps", "2", "--json", "--trainer.accumulate_grad_batches", "2"]
    tiny += ["--data.sources", "2", "--data.vectors", "8", "--trainer.precision", "bf16-mixed"]
    tiny += ["--trainer.log_every_n_steps", "1", "--data.validation", "0.34"]
    done = subprocess.run(
        ["bash", ROOT / "examples/cluster/torchrun.sh", *tiny],
        env=environment(RANKS="2", DATA=str(folder), OUT=str(tmp_path)),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count("{") == 1
    assert torch.load(tmp_path / "last.ckpt", weights_only=False)["global_step"] == 2
    metrics = (tmp_path / "lightning_logs/version_0/metrics.csv").read_text()
    assert all(name in metrics for name in ("train/memory_mb", "train/gradient_norm"))


@pytest.mark.parametrize("script", sorted((ROOT / "examples/cluster").iterdir()), ids=str)
def test_cluster_scripts_are_bash(script):
    subprocess.run(["bash", "-n", script], check=True)
