"""Generation in parallel: complete files or none, resumed where it stopped, failures recorded."""

import errno
import json
import os
import resource
import time

import numpy as np
import pytest
import trimesh
from joblib.externals.loky import get_reusable_executor

from riemlayer.data import prepare
from riemlayer.data.dataset import read_sample, sample_files
from riemlayer.data.meshes import is_watertight_manifold
from riemlayer.data.prepare import find_meshes, prepare_meshes, procedural_sample, run
from riemlayer.data.sample_file import remove_stale, write_sample


@pytest.fixture(scope="module", autouse=True)
def no_workers_left():
    """The worker processes end with this module."""
    yield
    get_reusable_executor().shutdown(wait=True, kill_workers=True)


def job(seed):
    """A job that makes a small sample (a closure, so that workers need not import this file)."""

    def make():
        import numpy as np

        rng = np.random.default_rng(seed)
        return {"x": rng.normal(size=(50, 3)).astype(np.float32)}, {"seed": str(seed)}

    return make


def jobs(n):
    return {f"s{seed}": job(seed) for seed in range(n)}


def contents(folder):
    return {f.name: f.read_bytes() for f in folder.glob("*.safetensors")}


# One file


def test_a_sample_is_written_whole(tmp_path):
    write_sample(tmp_path / "a.safetensors", {"x": np.arange(3.0)}, {"kind": "test"})
    assert os.listdir(tmp_path) == ["a.safetensors"]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_failing_disk_leaves_nothing(tmp_path, monkeypatch, call):
    def fails(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, call, fails)
    with pytest.raises(OSError, match="No space left"):
        write_sample(tmp_path / "a.safetensors", {"x": np.arange(3.0)}, {})
    assert os.listdir(tmp_path) == []


def test_a_full_disk_leaves_an_older_sample_as_it_was(tmp_path):
    path = tmp_path / "a.safetensors"
    write_sample(path, {"x": np.arange(3.0)}, {})
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            write_sample(path, {"x": np.arange(100_000.0)}, {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["a.safetensors"]


def test_only_stale_temporary_files_are_removed(tmp_path):
    old, new = tmp_path / ".a.safetensors.1.tmp", tmp_path / ".b.safetensors.2.tmp"
    for file in (old, new, tmp_path / "c.safetensors"):
        file.write_bytes(b"half")
    os.utime(old, (time.time() - 3600,) * 2)
    assert remove_stale(tmp_path) == 1
    assert sorted(os.listdir(tmp_path)) == [new.name, "c.safetensors"]


# A run


@pytest.mark.slow
def test_a_resumed_run_gives_the_files_of_an_undisturbed_one(tmp_path):
    whole, resumed = tmp_path / "whole", tmp_path / "resumed"
    assert run(jobs(6), whole, workers=2) == prepare.Report(written=6, skipped=0, failed=0)
    run(jobs(2), resumed, workers=2)
    (resumed / ".s2.safetensors.99.tmp").write_bytes(b"half a sample")
    assert run(jobs(6), resumed, workers=2) == prepare.Report(written=4, skipped=2, failed=0)
    assert contents(resumed) == contents(whole)
    assert len(contents(whole)) == 6


def test_finished_files_are_not_made_again(tmp_path):
    run(jobs(2), tmp_path, workers=2)
    times = [f.stat().st_mtime_ns for f in sample_files(tmp_path)]
    assert run(jobs(2), tmp_path, workers=2).skipped == 2
    assert [f.stat().st_mtime_ns for f in sample_files(tmp_path)] == times


def test_a_bad_shape_is_recorded_and_the_others_go_on(tmp_path):
    def bad():
        raise ValueError("no such shape")

    report = run({"bad": bad} | jobs(3), tmp_path, workers=2)
    assert report == prepare.Report(written=3, skipped=0, failed=1)
    lines = (tmp_path / "failures.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == [
        {"name": "bad", "reason": "ValueError: no such shape"}
    ]
    assert run({"bad": bad} | jobs(3), tmp_path, workers=2).skipped == 4


@pytest.mark.slow
def test_a_worker_that_dies_takes_only_its_shape_along(tmp_path):
    def dies():
        import os

        os._exit(1)

    report = run({"dies": dies} | jobs(4), tmp_path, workers=2)
    assert (report.written, report.failed) == (4, 1)
    assert "the worker died" in (tmp_path / "failures.jsonl").read_text()


@pytest.mark.slow
def test_a_shape_that_hangs_is_given_up(tmp_path):
    def hangs():
        import time

        time.sleep(3600)

    start = time.monotonic()
    report = run({"hangs": hangs} | jobs(1), tmp_path, workers=1, seconds=2)
    assert (report.written, report.failed) == (1, 1)
    assert time.monotonic() - start < 600


@pytest.mark.slow
def test_a_full_disk_stops_the_run_and_what_is_there_stays_readable(tmp_path):
    def too_large():
        import resource

        import numpy as np

        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, resource.RLIM_INFINITY))
        return {"x": np.zeros(100_000)}, {}

    with pytest.raises(OSError, match="too large"):
        run(jobs(2) | {"large": too_large} | {"later": job(9)}, tmp_path, workers=1)
    get_reusable_executor().shutdown(wait=True, kill_workers=True)  # its limit must not stay
    assert sorted(contents(tmp_path)) == ["s0.safetensors", "s1.safetensors"]
    assert not list(tmp_path.glob(".*.tmp"))
    assert run(jobs(3), tmp_path, workers=2).written == 1


# What is prepared


def test_meshes_are_found_in_a_fixed_shuffled_order(tmp_path):
    for i in range(30):
        folder = tmp_path / f"f{i % 3}"
        folder.mkdir(exist_ok=True)
        (folder / f"m{i}.ply").touch()
    (tmp_path / "notes.txt").touch()
    found = find_meshes(tmp_path)
    assert len(found) == 30
    assert found == find_meshes(tmp_path) != sorted(found)
    with pytest.raises(ValueError, match="folder must hold meshes"):
        find_meshes(tmp_path / "f9")


def test_two_meshes_of_one_name_are_refused(tmp_path):
    with pytest.raises(ValueError, match="paths must differ"):
        prepare_meshes([tmp_path / "a.ply", tmp_path / "a.obj"], tmp_path / "out")


@pytest.mark.slow
def test_meshes_become_samples(tmp_path):
    folder = tmp_path / "raw"
    folder.mkdir()
    trimesh.creation.box((1, 2, 3)).export(folder / "box.ply")
    (folder / "torn.ply").write_bytes(b"ply\nformat")
    out = tmp_path / "out"
    report = prepare_meshes(sorted(folder.iterdir()), out, 2, {"raw": "CC0"})
    assert (report.written, report.failed) == (1, 1)
    assert "torn.ply" in (out / "failures.jsonl").read_text()
    (file,) = sample_files(out)
    assert file.name == "mesh-raw-box.safetensors"
    sample = {name: x.numpy() for name, x in read_sample(file).items()}
    assert sample["v"].shape == sample["q"].shape == (32, 768, 3)
    assert "soup" not in sample
    assert is_watertight_manifold(sample["vertices"].astype(float), sample["faces"])
    np.testing.assert_allclose(np.abs(sample["q"]).max((0, 1)), [1 / 3, 2 / 3, 1], atol=1e-5)
    assert sample["complete"].mean() > 0.999
    assert sample["shortest"].mean() > 0.9


@pytest.mark.slow
def test_a_procedural_sample_depends_on_its_seed_alone():
    tensors, metadata = procedural_sample(4)
    again, _ = procedural_sample(4)
    assert all((tensors[name] == again[name]).all() for name in tensors)
    assert metadata["seed"] == "4"
    assert metadata["kind"]
    assert np.abs(tensors["vertices"]).max() == pytest.approx(1, abs=1e-6)
    assert is_watertight_manifold(tensors["vertices"].astype(float), tensors["faces"])


def test_the_command_line_explains_itself(capsys):
    with pytest.raises(SystemExit) as stop:
        prepare.main(["--help"])
    assert stop.value.code == 0
    said = capsys.readouterr().out
    assert all(word in said for word in ("--procedural", "--meshes", "--workers", "--seed"))
    with pytest.raises(SystemExit):
        prepare.main(["-o", "somewhere"])
