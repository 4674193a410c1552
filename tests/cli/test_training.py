"""`pretrain`, `finetune`, `export` and `tables`."""

import json
import math
import sys

import pytest
import torch
from references import fibonacci_sphere

from riemlayer import ExpLogField
from riemlayer.cli.errors import UserError
from riemlayer.cli.training import library_run, read_settings
from riemlayer.data.closed_form import Sphere
from riemlayer.data.sample_file import write_sample


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
def test_training_goes_on_and_its_weights_can_be_used(
    well, run, samples, shapes, tmp_path, refused
):
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


@pytest.mark.filterwarnings("ignore::Warning:lightning")
@pytest.mark.filterwarnings("ignore::Warning:jsonargparse")
def test_a_run_shorter_than_the_time_between_checkpoints_keeps_its_last_step(
    well, run, samples, tmp_path, refused
):
    pytest.importorskip("lightning")
    import yaml

    words = ["pretrain", samples, "-o", tmp_path / "run", "--preset", "tiny", "--json"]
    flags = ["--trainer.max_steps", "2", "--trainer.logger", "false"]
    flags += ["--data.sources", "2", "--data.vectors", "8"]
    facts = well(*words, *flags).facts
    state = torch.load(facts["checkpoint"], weights_only=False)
    (average,) = (x["average"] for x in state["callbacks"].values() if "average" in x)
    kept = ExpLogField.from_pretrained(facts["weights"]).state_dict()
    assert state["global_step"] == 2 and kept.keys() == average.keys()
    assert all(torch.equal(x, average[name]) for name, x in kept.items())

    settings = read_settings(None)
    del settings["trainer"]["callbacks"]
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(settings))
    words[3] = tmp_path / "other"
    refused(run(*words, "--config", tmp_path / "own.yaml", *flags), "no average", "no last.ckpt")


@pytest.mark.filterwarnings("ignore::Warning:lightning")
@pytest.mark.parametrize("supervised", [True, False])
def test_fine_tuning_moves_the_weights_and_goes_on(
    well, samples, shapes, tiny, tmp_path, supervised
):
    pytest.importorskip("lightning")
    given = [samples] if supervised else [shapes / "cloud.npz", "--self-supervised"]
    words = ["finetune", *given, "-o", tmp_path / "run", "--start-from", tiny, "--json"]
    words += ["--sources", 2, "--vectors", 8, "--unfreeze-at", 1]
    first = well(*words, "--steps", 2).facts
    assert (first["steps"], first["resumed"]) == (2, False)
    assert well(*words, "--steps", 3).facts["resumed"]
    before, after = (ExpLogField.from_pretrained(x) for x in (tiny, first["weights"]))
    pairs = zip(before.parameters(), after.parameters(), strict=True)
    assert any(not torch.equal(x, y) for x, y in pairs)
    assert sorted(x.name for x in (tmp_path / "run").iterdir()) == ["average", "last.ckpt"]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["NONE"], "riemlayer prepare"),
        (["NONE", "--self-supervised"], "none"),
        (["EMPTY", "--self-supervised"], "found none"),
        (["SAMPLES", "--keep", "-1"], "--keep"),
        (["SAMPLES", "--start-from", "nothing"], "--start-from"),
        (["SAMPLES", "--start-from", "EMPTY"], "--start-from"),
    ],
)
def test_what_cannot_be_tuned_on(run, samples, tmp_path, words, named, refused):
    pytest.importorskip("lightning")
    (tmp_path / "empty").mkdir()
    names = {"SAMPLES": samples, "NONE": tmp_path / "none", "EMPTY": tmp_path / "empty"}
    refused(run("finetune", *(names.get(x, x) for x in words), "-o", tmp_path / "out"), named)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["NONE"], "riemlayer prepare"),
        (["SAMPLES", "--start-from", "nothing"], "--start-from"),
        (["SAMPLES", "--preset", "big"], "--preset"),
        (["SAMPLES", "--steps", "0"], "--steps"),
        (["SAMPLES", "--config", "NONE"], "none"),
        (["SAMPLES", "--config", "BAD"], "bad.yaml"),
        (["SAMPLES", "--config", "LIST"], "list.yaml"),
        ([], "DIR"),
    ],
)
def test_what_cannot_be_trained_on(run, samples, tmp_path, words, named, refused):
    pytest.importorskip("lightning")
    (tmp_path / "bad.yaml").write_text("a: [")
    (tmp_path / "list.yaml").write_text("- 1")
    names = {"SAMPLES": samples, "NONE": tmp_path / "none"}
    names |= {"BAD": tmp_path / "bad.yaml", "LIST": tmp_path / "list.yaml"}
    refused(run("pretrain", *(names.get(x, x) for x in words), "-o", tmp_path / "out"), named)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("raised", "code"), [("KeyboardInterrupt", 130), ("SIGTERM", 143), ("usage", 2)]
)
def test_a_training_that_was_stopped_is_no_success(raised, code):
    """As Lightning ends: by exit(1) after Ctrl-C, by a SystemExit without code after SIGTERM."""
    with pytest.raises(SystemExit) as end, library_run():
        try:
            raise KeyboardInterrupt if raised == "KeyboardInterrupt" else ValueError
        except KeyboardInterrupt:
            sys.exit(1)
        except ValueError:
            raise SystemExit(2 if raised == "usage" else None) from None
    assert end.value.code == code


def test_what_cannot_be_exported(run, tmp_path, refused):
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
    row = {"groups": {"spheres": {"E_Exp": 0.1, "E_angle": math.nan}}, "failed": {"s/a": "why"}}

    def record(arguments):
        asked.append(arguments)
        print("a table")
        (tmp_path / "out").mkdir(exist_ok=True)
        (tmp_path / "out" / "tables.json").write_text(json.dumps({"methods": {"base": row}}))

    monkeypatch.setattr("riemlayer.tables.__main__.main", record)
    words = ["tables", tmp_path, "-o", tmp_path / "out", "--fast", "--no-figures", "--limit", 2]
    facts = well(*words, "--weights", "w", "--json").facts
    assert facts["methods"] == {"base": {"spheres": {"E_Exp": 0.1, "E_angle": None}}}
    assert facts["failed"] == {"base": {"s/a": "why"}}
    wanted = [str(tmp_path), "--out", str(tmp_path / "out"), "--weights", "w", "--limit", "2"]
    assert asked == [[*wanted, "--fast", "--no-figures"]]
    assert well(*words).stdout == "a table\n"


def test_what_has_no_tables(run, tmp_path, refused):
    refused(run("tables", tmp_path / "none", "-o", tmp_path / "out"), "none")
    refused(run("tables", "--methods", "magic", tmp_path, "-o", tmp_path / "o"), "riemlayer tables")


def test_a_run_that_diverged_is_told_in_one_line():
    modules = pytest.importorskip("lightning_modules")
    with pytest.raises(UserError, match=r"go on from last\.ckpt"), library_run():
        raise modules.DivergedError("the loss is nan; go on from last.ckpt")
