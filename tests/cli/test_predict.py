"""`riemlayer predict`."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from references import lumpy

from riemlayer.data.sample_file import write_sample
from riemlayer.data.shards import pack

pytest.importorskip("lightning")
pytestmark = pytest.mark.filterwarnings("ignore::Warning:lightning")

ROOT = Path(__file__).parents[2]


@pytest.fixture
def clouds(tmp_path) -> Path:
    """Five clouds."""
    folder = tmp_path / "clouds"
    folder.mkdir()
    for i in range(5):
        np.savez(folder / f"{i}.npz", points=lumpy(150 + 20 * i).numpy())
    return folder


def test_answers_are_counted_and_a_second_call_skips_them(well, arrays, clouds, tiny, tmp_path):
    words = ["predict", clouds, "-o", tmp_path / "out", "--weights", tiny, "--json"]
    first = well(*words, "--what", "log", "--sources", 2).facts
    assert (first["written"], first["skipped"], first["failed"]) == (5, 0, 0)
    assert first["shapes_per_second"] > 0
    assert arrays(tmp_path / "out" / "3.npz.npz")["log"].shape == (2, 210, 3)
    second = well(*words, "--what", "log", "--sources", 2).facts
    assert (second["written"], second["skipped"]) == (0, 5)


def test_a_bad_file_is_told_by_the_exit_code_too(run, clouds, tiny, tmp_path):
    (clouds / "bad.off").write_text("OFF\n3 1")
    done = run("predict", clouds, "-o", tmp_path / "out", "--weights", tiny, "--json")
    assert done.code == 2 and done.facts["failed"] == 1 and done.facts["written"] == 5
    line = done.stderr.splitlines()[-1]
    assert line.startswith("riemlayer predict: ") and "bad.off" in line


def test_answers_to_another_question_are_not_mixed(run, well, refused, clouds, tiny, tmp_path):
    words = ["predict", clouds, "--weights", tiny, "-o"]
    well(*words, tmp_path / "out")
    refused(run(*words, tmp_path / "out", "--what", "geometry"), "what embedding", "geometry")
    refused(run(*words, clouds / "out"), "lies in")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "x.npz").touch()
    refused(run(*words, tmp_path / "other"), "something else")
    refused(run("predict", tmp_path / "none", "-o", tmp_path / "out"), "none", "folder")


@pytest.mark.slow
def test_two_ranks_answer_each_cloud_once(clouds, tiny, tmp_path):
    """Five clouds and one bad file on two ranks: one answer on stdout, nothing lost or doubled."""
    (clouds / "bad.xyz").write_text("1 2 3\n")
    command = [sys.executable, "-m", "riemlayer", "predict", str(clouds), "-o", tmp_path / "out"]
    command += ["--weights", tiny, "--devices", "2", "--json"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 2, done.stderr[-2000:]
    (line,) = done.stdout.splitlines()
    assert '"written": 5' in line and '"failed": 1' in line and '"ranks": 2' in line
    found = sorted(x.name for x in (tmp_path / "out").iterdir())
    kept = ["failures.jsonl", "settings.json", "throughput.json"]
    assert found == sorted([f"{i}.npz.npz" for i in range(5)] + kept)


def test_shards_are_read_too_and_need_their_manifest(run, well, refused, tiny, tmp_path):
    samples, shards = tmp_path / "samples", tmp_path / "shards"
    samples.mkdir()
    names = ("vertices", "faces", "p", "normal", "v", "q", "divergence", "complete")
    for name in ("one", "two"):
        arrays = {x: lumpy(200).float().numpy() for x in names}
        write_sample(samples / f"{name}.safetensors", arrays, {"name": name})
    pack(samples, shards)
    words = ["predict", shards, "-o", tmp_path / "out", "--weights", tiny]
    assert well(*words, "--json").facts["written"] == 2
    assert (tmp_path / "out" / "two.npz").is_file()
    (shards / "manifest.jsonl").unlink()
    refused(run(*words), "manifest.jsonl", "riemlayer prepare --shards")
    refused(run("predict", "nowhere://x", "-o", tmp_path / "o", "--weights", tiny), "nowhere")
