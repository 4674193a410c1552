"""Predictions of many clouds: as of each alone, each once, and again after a run that stopped."""

import json
from pathlib import Path

import lightning as L
import numpy as np
import pytest
import torch
from references import lumpy, shaken

from lightning_modules import CloudFilesModule, ExpLogPredictor, PredictionFiles
from riemlayer.data.dataset import read_sample
from riemlayer.data.shards import pack
from riemlayer.data.stream import ShardedSamples
from riemlayer.ops import local_geometry

pytestmark = pytest.mark.filterwarnings("ignore::Warning:lightning")  # it talks of its own matters

SIZES = {"a.npz": 200, "b.xyz": 150, "inner/c.npz": 260, "inner/d.npz": 180, "few.xyz": 4}
FAR, UNIT = 1e5, 30.0
"""Where the clouds are, and how large."""


@pytest.fixture(scope="module")
def field():
    torch.manual_seed(0)
    return shaken("tiny", torch.float32, strength=0.3).requires_grad_(False)


@pytest.fixture(scope="module")
def clouds(tmp_path_factory) -> Path:
    """Five clouds and a file that is none."""
    folder = tmp_path_factory.mktemp("clouds")
    (folder / "inner").mkdir()
    for name, n in SIZES.items():
        points = FAR + UNIT * lumpy(n).numpy()
        if name.endswith("xyz"):
            np.savetxt(folder / name, points, fmt="%.17g")
        else:
            np.savez(folder / name, points=points)
    (folder / "bad.ply").write_bytes(b"ply\nnonsense")
    return folder


def names() -> list[str]:
    return sorted([*SIZES, "bad.ply"])


def predict(field, clouds, out, what, batch_size=3, only=None) -> PredictionFiles:
    out.mkdir(exist_ok=True)
    writer = PredictionFiles(out, {"what": what})
    data = CloudFilesModule(clouds, only or names(), writer.finished, batch_size=batch_size)
    trainer = L.Trainer(
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        use_distributed_sampler=False,
        callbacks=[writer],
    )
    model = ExpLogPredictor(field, what, sources=3, neighbours=6)
    trainer.predict(model, datamodule=data, return_predictions=False)
    return writer


def arrays(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as file:
        return {name: file[name] for name in file}


def in_cube(points: np.ndarray) -> tuple[torch.Tensor, float]:
    low, high = points.min(0), points.max(0)
    scale = (high - low).max() / 2
    return torch.from_numpy((points - (low + high) / 2) / scale).float(), float(scale)


@pytest.mark.parametrize("what", ["embedding", "log", "geometry"])
def test_answers_in_batches_are_those_of_each_cloud_alone(field, clouds, tmp_path, what):
    writer = predict(field, clouds, tmp_path / "out", what)
    for name in ("a.npz", "inner/c.npz"):
        found = arrays(writer.target(name))
        x, scale = in_cube(found["points"])
        np.testing.assert_array_equal(found["points"], arrays(clouds / name)["points"])
        surface = field.encode(x)
        if what == "embedding":
            exp = surface.field.exp_head  # reads the embedding at its sources
            p = (x - surface.centre) / surface.scale
            z = exp.prepare(surface.embedding, p, p[:, None], torch.zeros(len(p)).long()).z
            expected = {"z": z}
        elif what == "log":
            v, info = surface.log(x[found["sources"], None], x, return_info=True)
            expected = {"log": v * scale, "validity": info.validity}
            assert len(set(found["sources"])) == 3
        else:
            geometry = local_geometry(surface, 6)._asdict()
            expected = {k: x for k, x in geometry.items() if k != "batch"}
            for length in ("log", "r", "radius"):
                expected[length] = expected[length] * scale
        assert found.keys() - expected.keys() <= {"points", "sources"}
        for key, value in expected.items():
            value = value.double()
            atol = 1e-4 * max(1.0, float(value.abs().max()))
            np.testing.assert_allclose(found[key], value.numpy(), atol=atol, err_msg=key)


def test_bad_files_are_named_and_the_others_answered(field, clouds, tmp_path):
    writer = predict(field, clouds, tmp_path / "out", "geometry")
    lines = (tmp_path / "out/failures.jsonl").read_text().splitlines()
    failed = {x["name"]: x["reason"] for x in map(json.loads, lines)}
    assert failed.keys() == {"bad.ply", "few.xyz"}
    assert "bad.ply: " in failed["bad.ply"] and "k must be less than" in failed["few.xyz"]
    assert [name for name in names() if not writer.finished(name)] == sorted(failed)
    totals = json.loads((tmp_path / "out/throughput.json").read_text())
    assert (totals["written"], totals["failed"], totals["ranks"]) == (4, 2, 1)
    rate = totals["written"] / totals["seconds"]
    assert totals["shapes_per_second"] == pytest.approx(rate, rel=0.05)


def test_a_run_goes_on_where_it_stopped(field, clouds, tmp_path):
    whole = predict(field, clouds, tmp_path / "whole", "embedding")
    first = predict(field, clouds, tmp_path / "out", "embedding", only=["a.npz", "b.xyz"])
    (tmp_path / "out" / ".few.xyz.npz.part").write_bytes(b"left by a killed run")
    before = {name: first.target(name).stat().st_mtime_ns for name in ("a.npz", "b.xyz")}
    second = predict(field, clouds, tmp_path / "out", "embedding", batch_size=1)
    assert second.totals["written"] == 3
    for name, time in before.items():
        assert second.target(name).stat().st_mtime_ns == time
    for name in SIZES:
        pair = (arrays(x.target(name))["z"] for x in (whole, second))
        np.testing.assert_allclose(*pair, atol=1e-4)
    assert not list((tmp_path / "out").rglob("*.part"))
    assert predict(field, clouds, tmp_path / "out", "embedding").totals["written"] == 0


def test_each_name_goes_to_one_rank(clouds):
    for world in (1, 2, 3, 9):
        drawn = []
        for rank in range(world):
            data = CloudFilesModule(clouds, names(), lambda name: name == "a.npz")
            data.trainer = Rank(rank, world)  # pyright: ignore
            data.setup("predict")
            drawn += data.predict_dataloader().dataset.names  # pyright: ignore
        assert sorted(drawn) == [name for name in names() if name != "a.npz"]


class Rank:
    """What the data module asks a trainer for."""

    def __init__(self, rank: int, world: int) -> None:
        self.global_rank, self.world_size = rank, world
        self.strategy = self

    def broadcast(self, x):
        return x


@pytest.mark.parametrize(
    ("given", "named"), [({"what": "curvature"}, "what"), ({"sources": 0}, "sources")]
)
def test_arguments_are_checked(field, given, named):
    with pytest.raises(ValueError, match=named):
        ExpLogPredictor(field, **given)


def test_samples_of_shards_are_answered_at_their_vertices(field, folder, tmp_path, full_precision):
    """As a file of the same points; one whose bytes changed is named, and the others are there."""
    shards, clouds = tmp_path / "shards", tmp_path / "clouds"
    pack(folder, shards, size=2)
    clouds.mkdir()
    vertices = read_sample(folder / "sphere1.safetensors")["vertices"]
    np.savez(clouds / "one.npz", points=vertices.numpy())
    lines = [json.loads(line) for line in (shards / "manifest.jsonl").read_text().splitlines()]
    bad = next(x for x in lines if x["name"] == "sphere3")
    with open(shards / bad["shard"], "r+b") as file:
        file.seek(bad["offset"] + bad["bytes"] - 1)
        file.write(b"?")
    wanted = ShardedSamples([shards]).names()
    writer = predict(field, str(shards), tmp_path / "out", "log", only=wanted)
    assert [x.name for x in writer.failures] == ["sphere3"]
    assert "checksum" in writer.failures[0].reason
    assert sorted(x.stem for x in (tmp_path / "out").glob("*.npz")) == sorted(
        set(wanted) - {"sphere3"}
    )
    predict(field, clouds, tmp_path / "alone", "log", only=["one.npz"])
    found, alone = arrays(tmp_path / "out/sphere1.npz"), arrays(tmp_path / "alone/one.npz.npz")
    for name, x in found.items():
        np.testing.assert_allclose(x, alone[name], rtol=0, atol=1e-5, err_msg=name)
