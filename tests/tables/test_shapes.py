"""Meshes to evaluation shapes: the form, the truth on surfaces where it is known, resumption."""

import json

import numpy as np
import pytest
import torch
import trimesh
from joblib.externals.loky import get_reusable_executor
from references import length

from riemlayer.data.closed_form import Sphere
from riemlayer.tables import shapes, truth
from riemlayer.tables.evaluate import Shape
from riemlayer.tables.run import write_json
from riemlayer.tables.shapes import Preparation, prepare_shapes, procedural_shapes

SOURCES = 3
EVERY = ("remeshed", "nonuniform", "noisy", "raw")


@pytest.fixture(scope="module", autouse=True)
def no_workers_left():
    """The worker processes end with this module."""
    yield
    get_reusable_executor().shutdown(wait=True, kill_workers=True)


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    """An icosphere in a folder of its own, an open box, and a file that is no mesh."""
    folder = tmp_path_factory.mktemp("meshes")
    (folder / "round").mkdir()
    trimesh.creation.icosphere(4).export(folder / "round" / "icosphere.ply")
    box = trimesh.creation.box((1.0, 0.8, 0.6)).subdivide_to_size(0.1)
    box.update_faces(box.triangles_center[:, 2] < 0.299)
    box.export(folder / "box.ply")
    (folder / "torn.ply").write_bytes(b"ply\nformat")
    return folder


def contents(folder):
    return {str(x.relative_to(folder)): x.read_bytes() for x in folder.rglob("*") if x.is_file()}


@pytest.fixture(scope="module")
def prepared(meshes, tmp_path_factory):
    """All of them prepared, with every input: what was there before, the report, the folder."""
    before, out = contents(meshes), tmp_path_factory.mktemp("out")
    return before, prepare_shapes(meshes, out, SOURCES, inputs=EVERY), out


def arrays(path):
    with np.load(path) as file:
        return {name: file[name] for name in file}


@pytest.mark.slow
def test_files_have_the_form_of_an_evaluation_shape(prepared):
    _, _, out = prepared
    x = arrays(out / "round" / "icosphere.npz")
    n, m = len(x["V"]), len(x["F"])
    form = {name: (a.shape, a.dtype.str[1:]) for name, a in x.items()}
    assert form == {
        "V": ((n, 3), "f4"), "F": ((m, 3), "i4"), "points": ((n, 3), "f4"),
        "src": ((SOURCES,), "i4"), "src_normal": ((SOURCES, 3), "f4"),
        "vec": ((SOURCES, 400, 3), "f4"), "end": ((SOURCES, 400, 3), "f4"),
        "ok": ((SOURCES, 400), "b1"), "ok_tight": ((SOURCES, 400), "b1"),
        "log": ((SOURCES, n, 3), "f4"),
        "valid": ((SOURCES, n), "b1"), "valid_tight": ((SOURCES, n), "b1"),
    }  # fmt: skip
    assert Shape.load(out / "round" / "icosphere.npz").F.shape == (m, 3)
    assert np.abs(x["V"]).max() == pytest.approx(1, abs=1e-6)
    assert np.array_equal(x["points"], x["V"])


@pytest.mark.slow
def test_on_a_sphere_the_truth_is_that_of_the_sphere(prepared):
    x = arrays(prepared[2] / "round" / "icosphere.npz")
    sphere = Sphere(float(length(x["V"]).mean()))
    p = torch.from_numpy(x["V"][x["src"]])[:, None].double()
    end = sphere.exp(p, torch.from_numpy(x["vec"]).double()).numpy()
    assert length(end - x["end"]).max() < 5e-3
    log = sphere.log(p, torch.from_numpy(x["V"])[None].double()).numpy()
    inside = length(log) < 0.49
    assert length(log - x["log"])[inside].max() < 0.02
    assert x["valid"][inside].all() and not x["valid"][length(log) > 0.53].any()
    assert x["ok"].all() and x["ok_tight"].mean() > 0.99


@pytest.mark.slow
def test_tight_masks_are_subsets(prepared):
    for path in prepared[2].glob("*/*.npz"):
        x = arrays(path)
        assert not (x["ok_tight"] & ~x["ok"]).any()
        assert not (x["valid_tight"] & ~x["valid"]).any()
        assert x["valid_tight"].any() and x["ok_tight"].any()


@pytest.mark.slow
def test_groups_are_the_folders_and_inputs_share_the_truth(prepared):
    _, report, out = prepared
    files = {str(x.relative_to(out)) for x in out.glob("*/*.npz")}
    clean = {f"round{x}/icosphere.npz" for x in ("", "-nonuniform", "-noisy")}
    shelled = {f"meshes{x}/box.npz" for x in ("", "-nonuniform", "-noisy", "-raw")}
    assert files == clean | shelled
    assert report.written == len(files) and report.skipped == 0
    first = arrays(out / "meshes" / "box.npz")
    for name in shelled:
        other = arrays(out / name)
        assert all(np.array_equal(first[k], other[k]) for k in first if k != "points")
    raw = arrays(out / "meshes-raw" / "box.npz")["points"]
    assert len(raw) == 12_000
    assert not np.array_equal(raw[:9], first["points"][:9])


@pytest.mark.slow
def test_a_broken_mesh_is_recorded_and_the_meshes_stay_as_they_were(prepared, meshes):
    before, report, out = prepared
    assert list(report.failures) == ["meshes/torn"]
    assert "torn.ply" in report.failures["meshes/torn"]
    assert json.loads((out / "failures.json").read_text()) == report.failures
    assert contents(meshes) == before


@pytest.mark.slow
def test_a_second_run_writes_nothing_and_a_lost_file_comes_back_the_same(prepared, meshes):
    _, first, out = prepared
    before = contents(out)
    times = {x: x.stat().st_mtime_ns for x in out.glob("*/*.npz")}
    again = prepare_shapes(meshes, out, SOURCES, inputs=EVERY)
    assert again == Preparation(0, first.written, first.failures)
    assert {x: x.stat().st_mtime_ns for x in out.glob("*/*.npz")} == times
    lost = out / "meshes-noisy" / "box.npz"
    lost.unlink()
    (lost.parent / f".{lost.name}.77.tmp").write_bytes(b"half a shape")
    assert prepare_shapes(meshes, out, SOURCES, inputs=["noisy"]).written == 1
    assert lost.read_bytes() == before["meshes-noisy/box.npz"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["V", "src"])
def test_a_file_of_another_mesh_or_of_other_sources_is_refused(prepared, meshes, name):
    path = prepared[2] / "round" / "icosphere.npz"
    before = path.read_bytes()
    x = arrays(path)
    np.savez_compressed(path, **x | {name: x[name][::-1]})
    try:
        with pytest.raises(ValueError, match=r"out holds another mesh .*icosphere\.npz: remove it"):
            prepare_shapes(meshes, prepared[2], SOURCES)
    finally:
        path.write_bytes(before)


@pytest.mark.slow
def test_a_group_of_given_kinds_leaves_other_failures_alone(tmp_path):
    write_json(tmp_path / "failures.json", {"meshes/torn": "no faces", "thin/1100000": "old"})
    report = procedural_shapes(2, tmp_path, sources=1, kinds=["tray", "cutlery"], group="thin")
    assert report.written == 2 and not report.failures
    names = sorted(path.stem for path in (tmp_path / "thin").glob("*.npz"))
    assert names == ["cutlery-1100001", "tray-1100000"]
    assert json.loads((tmp_path / "failures.json").read_text()) == {"meshes/torn": "no faces"}


def test_procedural_shapes_are_seeds_that_training_never_draws(tmp_path):
    with pytest.raises(ValueError, match=r"seed must be at least 1100000 .* got 1000"):
        procedural_shapes(1, tmp_path, seed=1000)
    report = procedural_shapes(1, tmp_path, sources=2)
    (path,) = tmp_path.glob("procedural/*.npz")
    assert report == Preparation(1, 0, {})
    assert path.stem.endswith("-1100000") and len(Shape.load(path).src) == 2


def test_a_failing_disk_leaves_nothing(tmp_path, monkeypatch):
    def full(file, **_):
        file.write(b"half")
        raise OSError("No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(OSError, match="No space"):
        shapes._write(tmp_path / "a.npz", {"x": np.zeros(3)})
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_prepared_is_said_at_once(tmp_path):
    with pytest.raises(ValueError, match="folder must hold meshes"):
        prepare_shapes(tmp_path, tmp_path / "out")
    (tmp_path / "a.ply").touch()
    with pytest.raises(ValueError, match=r"inputs must be among .*, got rotten"):
        prepare_shapes(tmp_path, tmp_path / "out", inputs=["noisy", "rotten"])
    for name in ("a b.ply", "a_b.ply"):
        (tmp_path / name).touch()
    with pytest.raises(ValueError, match=r"meshes must differ in name, .* repeats meshes/a_b\.ply"):
        prepare_shapes(tmp_path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_names_tell_meshes_apart(tmp_path):
    names = {
        shapes._place(type(tmp_path)(x)) for x in ("c/a/m.obj", "c/b/m.obj", "m.obj", "d/m.obj")
    }
    assert names == {("c", "a-m"), ("c", "b-m"), ("meshes", "m"), ("d", "m")}
    assert truth.INPUTS == EVERY
