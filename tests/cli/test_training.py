"""`prepare`, `pretrain`, `tables`, `export`, `info` and `bench`."""

import json

import numpy as np
import pytest
import torch
from references import fibonacci_sphere

from riemlayer import ExpLogField
from riemlayer.data.closed_form import Sphere
from riemlayer.data.prepare import Report
from riemlayer.data.sample_file import write_sample


def refused(done, *words):
    assert done.code == 2 and done.stderr.splitlines()[-1].startswith("riemlayer ")
    assert all(word in done.stderr.splitlines()[-1] for word in words), done.stderr


# prepare


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
    assert asked == [(4, 7, tmp_path / "out", 3)]
    assert facts == {"out": str(tmp_path / "out"), "written": 3, "skipped": 1, "failed": 0}


def test_folders_and_files_of_meshes_are_asked_of_the_library(well, asked, shapes, tmp_path):
    done = well("prepare", shapes, shapes / "ball.obj", "-o", tmp_path / "out")
    ((paths, out, workers),) = asked
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
def test_what_cannot_be_prepared(run, asked, shapes, tmp_path, words, named):
    (tmp_path / "empty").mkdir()
    names = {"IN": shapes, "NONE": tmp_path / "none", "EMPTY": tmp_path / "empty"}
    done = run("prepare", *(names.get(x, x) for x in words), "-o", tmp_path / "out")
    refused(done, named)
    assert not asked and not (tmp_path / "out").exists()


def test_meshes_are_never_written_to(run, asked, shapes, tmp_path):
    refused(run("prepare", shapes, "-o", shapes), "--out", "never written to")
    (tmp_path / "file").write_text("mine")
    refused(run("prepare", shapes, "-o", tmp_path / "file"), "--out", "file")
    assert not asked


def test_bad_meshes_are_named(run, tmp_path):
    """The real thing, workers and all."""
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "bad.obj").write_text("v 0 0 0\nv 1 one 1\nf 1 2 3\n")
    done = run("prepare", tmp_path / "in", "-o", tmp_path / "out", "--workers", 1)
    refused(done, "failures.jsonl", "bad")
    assert [x.name for x in (tmp_path / "out").iterdir()] == ["failures.jsonl"]


@pytest.mark.slow
def test_a_mesh_becomes_a_sample(well, shapes, tmp_path):
    from riemlayer.data.dataset import read_sample

    facts = well("prepare", shapes / "ball.ply", "-o", tmp_path, "--workers", 1, "--json").facts
    assert facts["written"] == 1
    (sample,) = tmp_path.glob("*.safetensors")
    assert read_sample(sample)["v"].shape[-1] == 3


# pretrain and export


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """Eight prepared spheres."""
    folder = tmp_path_factory.mktemp("samples")
    vertices = fibonacci_sphere(600)
    faces = torch.zeros(1, 3).int()
    for i in range(8):
        generator = torch.Generator().manual_seed(i)
        p = vertices[torch.randperm(600, generator=generator)[:6], None]
        v = 0.1 * torch.randn(6, 32, 3, generator=generator, dtype=torch.float64)
        v = Sphere().project_to_tangent(p, v)
        known = torch.ones(6, 32, dtype=torch.bool)
        sample = {"vertices": vertices, "p": p[:, 0], "normal": p[:, 0], "v": v}
        sample = {k: x.float() for k, x in (sample | {"q": Sphere().exp(p, v)}).items()}
        sample |= {"faces": faces, "complete": known, "divergence": 0.1 * known}
        arrays = {k: x.numpy() for k, x in sample.items()}
        write_sample(folder / f"s{i}.safetensors", arrays, {"name": f"s{i}", "source": "spheres"})
    return folder


@pytest.mark.filterwarnings("ignore::Warning:lightning")
@pytest.mark.filterwarnings("ignore::Warning:jsonargparse")
def test_training_goes_on_and_its_weights_can_be_used(well, run, samples, shapes, tmp_path):
    pytest.importorskip("lightning")
    words = ["pretrain", samples, "-o", tmp_path / "run", "--preset", "tiny", "--json"]
    small = [
        "--data.sources",
        "2",
        "--data.vectors",
        "8",
        "--trainer.enable_model_summary",
        "false",
    ]
    small += ["--trainer.logger", "false", "--trainer.enable_progress_bar", "false"]
    first = well(*words, "--steps", 2, *small).facts
    assert not first["resumed"]
    assert ExpLogField.from_pretrained(first["weights"]).config.radius == 0.5
    assert well(*words, "--steps", 3, *small).facts["resumed"]
    state = torch.load(first["checkpoint"], weights_only=False)
    assert state["global_step"] == 3

    out = tmp_path / "weights"
    well("export", first["checkpoint"], "-o", out, "--samples", samples)
    assert sorted(x.name for x in out.iterdir()) == ["config.json", "model.safetensors"]
    card = well("info", "--weights", out, "--json").facts["card"]
    assert card["steps"] == 3 and card["shapes"] == {"spheres": 8}
    log = ["log", shapes / "cloud.npz", "-s", 0, "-o", tmp_path / "log.npz", "--weights", out]
    assert well(*log).code == 0
    refused(run("export", first["checkpoint"], "-o", out), "--out", "exists")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["NONE"], "riemlayer prepare"),
        (["SAMPLES", "--preset", "big"], "--preset"),
        (["SAMPLES", "--steps", "0"], "--steps"),
        (["SAMPLES", "--config", "NONE"], "none"),
        (["SAMPLES", "--config", "BAD"], "bad.yaml"),
        (["SAMPLES", "--config", "LIST"], "list.yaml"),
        ([], "DIR"),
    ],
)
def test_what_cannot_be_trained_on(run, samples, tmp_path, words, named):
    pytest.importorskip("lightning")
    (tmp_path / "bad.yaml").write_text("a: [")
    (tmp_path / "list.yaml").write_text("- 1")
    names = {"SAMPLES": samples, "NONE": tmp_path / "none"}
    names |= {"BAD": tmp_path / "bad.yaml", "LIST": tmp_path / "list.yaml"}
    refused(run("pretrain", *(names.get(x, x) for x in words), "-o", tmp_path / "out"), named)
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_exported(run, tmp_path):
    pytest.importorskip("lightning")
    (tmp_path / "cut.ckpt").write_bytes(b"PK\x03\x04")
    torch.save({"other": 1}, tmp_path / "other.ckpt")
    torch.save(torch.ones(3), tmp_path / "tensor.ckpt")
    (tmp_path / "facts.json").write_text("[1]")
    for name in ("none.ckpt", "cut.ckpt", "other.ckpt", "tensor.ckpt"):
        refused(run("export", tmp_path / name, "-o", tmp_path / "out"), name)
    words = ["--facts", tmp_path / "facts.json"]
    refused(run("export", tmp_path / "cut.ckpt", "-o", tmp_path / "out", *words), "facts.json")
    refused(run("export", tmp_path / "cut.ckpt", "-o", tmp_path / "a" / "b"), "mkdir")
    names = {"cut.ckpt", "other.ckpt", "tensor.ckpt", "facts.json"}
    assert {x.name for x in tmp_path.iterdir()} == names


# tables


def test_tables_are_asked_of_the_library(well, monkeypatch, tmp_path):
    asked = []
    row = {"methods": {"base": {"groups": {"spheres": {"E_Exp": 0.1}}}}}

    def record(arguments):
        asked.extend(arguments)
        print("a table")
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "tables.json").write_text(json.dumps(row))

    monkeypatch.setattr("riemlayer.tables.__main__.main", record)
    words = ["tables", tmp_path, "-o", tmp_path / "out", "--fast", "--no-figures", "--limit", 2]
    done = well(*words, "--weights", "w", "--json")
    assert done.facts["methods"] == {"base": {"spheres": {"E_Exp": 0.1}}}
    assert "a table" in done.stderr
    wanted = [str(tmp_path), "--out", str(tmp_path / "out"), "--weights", "w", "--limit", "2"]
    assert asked == [*wanted, "--fast", "--no-figures"]


def test_what_has_no_tables(run, tmp_path):
    refused(run("tables", tmp_path / "none", "-o", tmp_path / "out"), "none")
    refused(run("tables", "--methods", "magic", tmp_path, "-o", tmp_path / "o"), "riemlayer tables")


# info and bench


def test_info_tells_the_card_the_versions_and_the_shape(well, shapes, ball):
    facts = well("info", shapes / "ball.ply", "--json").facts
    card = json.loads((_weights() / "base.json").read_text())
    assert facts["card"]["parameters"] == card["training"]["parameters"]
    assert facts["card"]["licence"] == card["licence"]
    assert facts["versions"]["torch"] == torch.__version__
    assert facts["extras"]["viz"] == []
    shape = facts["shape"]
    assert (shape["kind"], shape["points"], shape["faces"]) == ("mesh", 642, 1280)
    assert shape["longest_side"] == pytest.approx(10) and shape["low"][0] == pytest.approx(95)
    assert shape["trained_radius"] == pytest.approx(2.5)
    assert len(ball.vertices) == 642
    text = well("info", shapes / "ball.ply").stdout
    assert "riemlayer: " in text and "ball.ply" in text and card["licence"] in text


def _weights():
    from pathlib import Path

    import riemlayer

    return Path(riemlayer.__file__).parent / "weights"


def test_info_names_what_an_extra_lacks(well, monkeypatch):
    from importlib import metadata

    version = metadata.version

    def without(name):
        if name == "pyvista":
            raise metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(metadata, "version", without)
    assert 'viz: lacks pyvista: pip install "riemlayer[viz]"' in well("info").stdout


@pytest.mark.parametrize("shape", [None, "cloud.npz"])
def test_bench_times_encode_log_and_exp(well, shapes, tiny, shape):
    given = [] if shape is None else [shapes / shape]
    words = ["bench", *given, "--points", 500, "--repeats", 2, "--weights", tiny, "--json"]
    facts = well(*words, "--threads", 1).facts
    assert len(facts["milliseconds"]) == 3 and min(facts["milliseconds"].values()) > 0
    assert facts["points"] == (600 if shape else 500)
    assert np.isfinite(list(facts["milliseconds"].values())).all()
