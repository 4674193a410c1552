"""Shards: the same samples give the same bytes, whatever happens on the way."""

import errno
import hashlib
import json
import os
import subprocess
import sys
import tarfile
import textwrap

import numpy as np
import pytest
import webdataset
from joblib.externals.loky import get_reusable_executor

from riemlayer.data.dataset import sample_files
from riemlayer.data.prepare import Report, run
from riemlayer.data.run_folder import FolderInUse, only_run, read_failures, record_failure
from riemlayer.data.sample_file import write_sample
from riemlayer.data.shards import Packed, pack


@pytest.fixture(scope="module", autouse=True)
def no_workers_left():
    """The worker processes end with this module."""
    yield
    get_reusable_executor().shutdown(wait=True, kill_workers=True)


def write(folder, name, seed=0):
    rng = np.random.default_rng([seed, *name.encode()])
    tensors = {"vertices": rng.normal(size=(50, 3)), "v": rng.normal(size=(4, 6, 3))}
    metadata = {"name": name, "source": f"from/{name}", "kind": "test", "licence": "MIT"}
    write_sample(folder / f"{name}.safetensors", tensors, metadata)


@pytest.fixture
def samples(tmp_path):
    """Seven samples, one with dots in its name, and a shape that failed."""
    folder = tmp_path / "samples"
    folder.mkdir()
    for name in ("a", "b.1", "b.2", "c", "d", "e", "f"):
        write(folder, name)
    record_failure(folder, "torn", "ValueError: no faces")
    return folder


def contents(folder):
    return {f.name: f.read_bytes() for f in folder.glob("[!.]*") if f.is_file()}


def manifest(folder):
    return [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()]


def test_the_manifest_says_where_each_sample_lies_and_what_failed(samples, tmp_path):
    out = tmp_path / "out"
    assert pack(samples, out, 3) == Packed(samples=7, shards=3, written=3)
    *found, failed = manifest(out)
    assert [x["name"] for x in found] == [f.stem for f in sample_files(samples)]
    for line in found:
        with open(out / line["shard"], "rb") as shard:
            shard.seek(line["offset"])
            data = shard.read(line["bytes"])
        assert data == (samples / f"{line['name']}.safetensors").read_bytes()
        assert line["sha256"] == hashlib.sha256(data).hexdigest()
        assert line["source"] == f"from/{line['name']}"
        assert (line["vertices"], line["sources"], line["vectors"]) == (50, 4, 6)
    assert failed == {"name": "torn", "failed": "ValueError: no faces"}


@pytest.mark.filterwarnings("ignore:Exception ignored in")  # webdataset leaves files to the garbage
def test_webdataset_reads_the_same_samples(samples, tmp_path):
    pack(samples, tmp_path / "out", 3)
    urls = [str(x) for x in sorted((tmp_path / "out").glob("*.tar"))]
    read = [x["safetensors"] for x in webdataset.WebDataset(urls, shardshuffle=False)]
    assert read == [f.read_bytes() for f in sample_files(samples)]


def test_the_same_samples_give_the_same_bytes_and_nothing_is_written_twice(samples, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    pack(samples, one, 3)
    times = {f: f.stat().st_mtime_ns for f in one.glob("shard-*")}
    assert pack(samples, one, 3).written == 0
    assert times == {f: f.stat().st_mtime_ns for f in one.glob("shard-*")}
    pack(samples, two, 2)
    pack(samples, two, 3)  # another size leaves nothing of the first
    assert contents(one) == contents(two)


def test_a_changed_sample_changes_its_shard_alone(samples, tmp_path):
    out = tmp_path / "out"
    pack(samples, out, 3)
    before = contents(out)
    write(samples, "d", seed=1)
    assert pack(samples, out, 3).written == 1
    changed = {name for name, data in contents(out).items() if before[name] != data}
    assert changed == {"shard-000001.tar", "shard-000001.jsonl", "manifest.jsonl"}


def test_a_truncated_shard_is_packed_again(samples, tmp_path):
    out = tmp_path / "out"
    pack(samples, out, 3)
    before = contents(out)
    os.truncate(out / "shard-000000.tar", 2000)
    assert pack(samples, out, 3).written == 1
    assert contents(out) == before


def test_a_corrupt_sample_is_named_and_not_packed(samples, tmp_path):
    os.truncate(samples / "c.safetensors", 500)
    with pytest.raises(ValueError, match=r"c\.safetensors is truncated or corrupt, delete it"):
        pack(samples, tmp_path / "out", 3)
    assert not (tmp_path / "out" / "manifest.jsonl").exists()


def test_a_full_disk_leaves_whole_shards_and_no_manifest(samples, tmp_path, monkeypatch):
    out, sync, calls = tmp_path / "out", os.fsync, iter(range(100))

    def fails(file):
        if next(calls) == 2:  # the second shard's tar file
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(file)

    with monkeypatch.context() as patch, pytest.raises(OSError, match="No space left"):
        patch.setattr(os, "fsync", fails)
        pack(samples, out, 3)
    assert sorted(contents(out)) == ["shard-000000.jsonl", "shard-000000.tar"]
    with tarfile.open(out / "shard-000000.tar") as shard:
        assert len(shard.getmembers()) == 3
    assert pack(samples, out, 3).written == 2


@pytest.mark.parametrize("size", [0, -1])
def test_a_size_below_one_is_refused(samples, tmp_path, size):
    with pytest.raises(ValueError, match="size must be at least 1"):
        pack(samples, tmp_path / "out", size)


# One run a folder; what a killed run leaves


def test_a_second_run_is_refused_and_the_lock_dies_with_its_holder(tmp_path):
    code = f"""
        import pathlib, time
        from riemlayer.data.run_folder import only_run
        with only_run(pathlib.Path({str(tmp_path)!r})):
            print("held", flush=True)
            time.sleep(60)
    """
    command = [sys.executable, "-c", textwrap.dedent(code)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == "held\n"
        with pytest.raises(FolderInUse, match="being written by another run; wait for its end"):
            run({}, tmp_path, workers=1)
        holder.kill()
    with only_run(tmp_path):
        pass


@pytest.mark.parametrize("half", ['{"name": "b', '{"name": "b", "reason": "x{}'])
def test_a_half_written_failure_is_tried_again(tmp_path, half):
    record_failure(tmp_path, "a", "bad")
    with open(tmp_path / "failures.jsonl", "a") as file:
        file.write(half)
    assert read_failures(tmp_path) == {"a": "bad"}

    def bad():
        raise ValueError("no such shape")

    assert run({"a": bad, "b": bad}, tmp_path, workers=1) == Report(0, skipped=1, failed=1)
    assert read_failures(tmp_path) == {"a": "bad", "b": "ValueError: no such shape"}


def test_a_last_failure_without_a_line_end_counts(tmp_path):
    (tmp_path / "failures.jsonl").write_text('{"name": "a", "reason": "bad"}')
    run({}, tmp_path, workers=1)
    record_failure(tmp_path, "b", "worse")
    assert read_failures(tmp_path) == {"a": "bad", "b": "worse"}
