"""`prepare` asks the library for training data."""

import sys

import numpy as np
import pytest

from riemlayer.data.prepare import Report
from riemlayer.data.run_folder import only_run
from riemlayer.data.sample_file import write_sample


@pytest.fixture
def asked(monkeypatch):
    """What the library's preparation was called with; nothing is prepared."""
    calls = []

    def record(*arguments):
        calls.append(arguments)
        return Report(3, 1, 0)

    for name in ("prepare_procedural", "prepare_meshes"):
        monkeypatch.setattr(f"riemlayer.data.prepare.{name}", record)
    return calls


def test_procedural_shapes_are_asked_of_the_library(well, asked, tmp_path):
    words = ["prepare", "--procedural", 4, "--seed", 7, "-o", tmp_path / "out", "--workers", 3]
    facts = well(*words, "--json").facts
    assert asked == [(4, 7, tmp_path / "out", 3, None)]
    assert facts == {"out": str(tmp_path / "out"), "written": 3, "skipped": 1, "failed": 0}


def test_a_cluster_is_asked_of_the_library_and_samples_are_packed(well, asked, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    for name in "abc":
        write_sample(out / f"{name}.safetensors", {"v": np.zeros((2, 3, 3))}, {})
    words = ["prepare", "--procedural", 4, "-o", out, "--cluster", "ray", "--shards", 2]
    facts = well(*words, "--json").facts
    assert asked == [(4, 0, out, 2, "ray")]
    assert facts["packed"] == {"samples": 3, "shards": 2, "written": 2}
    assert len(list((out / "shards").glob("*.tar"))) == 2
    assert "3 samples in 2 shards" in well(*words).stdout


@pytest.mark.parametrize(("module", "option"), [("webdataset", "--shards"), ("ray", "--cluster")])
def test_a_missing_package_is_named_with_its_extra(
    run, refused, monkeypatch, tmp_path, module, option
):
    write_sample(tmp_path / "procedural-000000.safetensors", {"v": np.zeros((2, 3, 3))}, {})
    for name in (module, f"{module}.writer"):
        monkeypatch.setitem(sys.modules, name, None)
    value = {"--shards": 1, "--cluster": "ray"}[option]
    done = run("prepare", "--procedural", 1, "-o", tmp_path, option, value)
    refused(done, module, "riemlayer[scale]")


def test_another_cluster_and_a_second_run_are_refused(run, refused, tmp_path):
    words = ["prepare", "--procedural", 1, "-o", tmp_path / "out"]
    refused(run(*words, "--cluster", "slurm"), "cluster must be ray", "slurm")
    with only_run(tmp_path / "out"):
        refused(run(*words), "being written by another run")


def test_folders_and_files_of_meshes_are_asked_of_the_library(well, asked, shapes, tmp_path):
    done = well("prepare", shapes, shapes / "ball.obj", "-o", tmp_path / "out")
    ((paths, out, workers, _, _),) = asked
    assert sorted(x.name for x in paths) == ["ball.obj", "ball.obj", "ball.ply"]
    assert (out, workers) == (tmp_path / "out", 2)
    assert "3 written, 1 already there" in done.stdout


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ([], "--procedural"),
        (["--procedural", "0"], "--procedural"),
        (["--procedural", "1", "IN"], "--procedural"),
        (["NONE"], "none"),
        (["EMPTY"], "none below"),
        (["IN", "--workers", "0"], "--workers"),
    ],
)
def test_what_cannot_be_prepared(run, asked, shapes, tmp_path, words, named, refused):
    (tmp_path / "empty").mkdir()
    names = {"IN": shapes, "NONE": tmp_path / "none", "EMPTY": tmp_path / "empty"}
    done = run("prepare", *(names.get(x, x) for x in words), "-o", tmp_path / "out")
    refused(done, named)
    assert not asked and not (tmp_path / "out").exists()


def test_meshes_are_never_written_to(run, asked, shapes, tmp_path, refused):
    refused(run("prepare", shapes, "-o", shapes), "--out", "never written to")
    (tmp_path / "file").write_text("mine")
    refused(run("prepare", shapes, "-o", tmp_path / "file"), "--out", "file")
    assert not asked


def test_bad_meshes_are_named(run, tmp_path, refused):
    """The real thing, workers and all."""
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "bad.obj").write_text("v 0 0 0\nv 1 one 1\nf 1 2 3\n")
    done = run("prepare", tmp_path / "in", "-o", tmp_path / "out", "--workers", 1)
    refused(done, "failures.jsonl", "bad")
    assert sorted(x.name for x in (tmp_path / "out").glob("[!.]*")) == ["failures.jsonl"]


@pytest.mark.slow
def test_a_mesh_becomes_a_sample(well, shapes, tmp_path):
    from riemlayer.data.dataset import read_sample

    facts = well("prepare", shapes / "ball.ply", "-o", tmp_path, "--workers", 1, "--json").facts
    assert facts["written"] == 1
    (sample,) = tmp_path.glob("*.safetensors")
    assert read_sample(sample)["v"].shape[-1] == 3
