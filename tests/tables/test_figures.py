"""Figures and the numbers they are made of, on a small sphere."""

import json

import numpy as np
import pytest
import torch
import trimesh

from riemlayer import ExpLogField
from riemlayer.baselines import Heat, Projection, Walking
from riemlayer.tables import figures, sweeps
from riemlayer.tables.evaluate import Shape
from riemlayer.tables.figures import (
    checkerboards,
    error_against_density,
    error_against_noise,
    error_against_radius,
    look,
    time_against_points,
    time_against_sources,
)
from riemlayer.tables.systems import ORACLES, TITLES
from riemlayer.tables.truth import shape_arrays


@pytest.fixture(scope="module")
def sphere() -> Shape:
    """An icosphere of 2,562 vertices with two sources; the cloud is its vertices."""
    mesh = trimesh.creation.icosphere(4)
    arrays = shape_arrays(np.asarray(mesh.vertices), np.asarray(mesh.faces), 2, 0)
    return Shape(**arrays, points=arrays["V"])


@pytest.fixture(scope="module")
def field() -> ExpLogField:
    torch.manual_seed(0)
    return ExpLogField.from_preset("tiny").eval()


def results(groups: int) -> dict:
    """Tables as the command writes them, of four methods of which one has no Exp."""
    row = {
        "shapes": 3,
        "exp_by_length": {"0-0.1": 0.01, "0.1-0.2": 0.02, "0.4-0.5": 0.05},
        **{f"r{r}_tight": {"log_end": r / 9, "exp": r / 5} for r in (0.1, 0.25, 0.5)},
    }
    without = {name: x for name, x in row.items() if name != "exp_by_length"}
    names = [f"group_{i}" for i in range(groups)]
    rows = {"base": row, "heat": without, "mesh-affine": without, "own": row}
    return {"methods": {m: {"groups": dict.fromkeys(names, x)} for m, x in rows.items()}}


def pixels(path) -> np.ndarray:
    """The picture (h, w, 3), which must not be empty: many colours, and more than white."""
    image = pytest.importorskip("PIL.Image")
    rows = np.asarray(image.open(path).convert("RGB"))
    assert len(np.unique(rows.reshape(-1, 3), axis=0)) > 50
    assert 0.01 < (rows.min(-1) < 250).mean() < 0.9
    return rows


def shows(rows: np.ndarray, colour: str) -> bool:
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return bool((np.abs(rows.astype(int) - wanted).max(-1) < 3).sum() > 30)


# Looks


def test_every_method_has_a_look_of_its_own_and_keeps_it():
    names = [name for name in TITLES if not name.startswith("mesh-")]
    looks = [look(name) for name in names]
    for key in ("color", "marker", "label"):
        assert len({x[key] for x in looks}) == len(names)
    assert look("somebody's") == look("somebody's")
    assert look("somebody's")["color"] not in {x["color"] for x in looks}
    assert all(look(name)["linestyle"] == ":" for name in ORACLES)


@pytest.mark.parametrize("groups", [1, 3, 6])
def test_radius_figure_shows_its_methods_in_their_colours(tmp_path, groups):
    path = error_against_radius(results(groups), tmp_path / "new" / "radius.png")
    rows = pixels(path)
    for name in ("base", "heat", "own"):
        assert shows(rows, look(name)["color"])
    assert not shows(rows, look("projection")["color"])
    assert [x.name for x in path.parent.iterdir()] == ["radius.png"]


def test_radius_figure_reads_bins_and_radii():
    row = results(1)["methods"]["base"]["groups"]["group_0"]
    assert figures._by_length(row) == (pytest.approx([0.05, 0.15, 0.45]), [0.01, 0.02, 0.05])
    assert figures._within_radius(row) == ([0.1, 0.25, 0.5], [0.1 / 9, 0.25 / 9, 0.5 / 9])
    assert figures._by_length({}) == figures._within_radius({}) == ([], [])


@pytest.mark.parametrize("empty", [{"methods": {}}, {"methods": {"base": {"groups": {}}}}])
def test_no_results_no_figure(tmp_path, empty):
    with pytest.raises(ValueError, match="results must hold a method"):
        error_against_radius(empty, tmp_path / "radius.png")
    assert list(tmp_path.iterdir()) == []


# Errors against noise and density


def test_noise_sweep_is_finite_and_starts_at_the_clean_cloud(field, sphere, tmp_path):
    numbers = sweeps.noise_sweep(field, [sphere], (0.0, 0.02))
    clean, noisy = (sweeps.noise_sweep(field, [sphere], (x,)) for x in (0.0, 0.02))
    assert json.loads(json.dumps(numbers)) == numbers and numbers["failed"] == {}
    assert {name: [*x] for name, x in numbers["methods"].items()} == {
        "base": ["exp", "log_end", "angle"],
        "heat": ["log_end", "angle"],
        "projection": ["exp", "log_end", "angle"],
        "tracing": ["exp"],
    }
    for name, errors in numbers["methods"].items():
        for metric, values in errors.items():
            assert np.isfinite(values).all() and min(values) > 0
            assert values[0] == pytest.approx(clean["methods"][name][metric][0])
            assert values[1] == pytest.approx(noisy["methods"][name][metric][0])
    tracing = numbers["methods"]["tracing"]["exp"]
    assert tracing[1] > 1.5 * tracing[0]
    rows = pixels(error_against_noise(numbers, tmp_path / "noise.png"))
    for name in numbers["methods"]:
        assert shows(rows, look(name)["color"])


def test_more_points_help_and_the_shape_stays_as_it_was(field, sphere, tmp_path):
    before = sphere.points.copy()
    numbers = sweeps.density_sweep(field, [sphere], (150, 3000))
    snapped = numbers["methods"]["projection"]["exp"]
    assert snapped[1] < snapped[0]
    assert np.array_equal(sphere.points, before)
    rows = pixels(error_against_density(numbers, tmp_path / "density.png"))
    for name in numbers["methods"]:
        assert shows(rows, look(name)["color"])


def test_a_method_that_fails_leaves_a_gap_with_a_reason(field, sphere, tmp_path, monkeypatch):
    class Fragile(Walking):
        def prepare(self, points):
            if np.abs(points).max() > 1.01:
                raise RuntimeError("too noisy for me")
            super().prepare(points)

    monkeypatch.setitem(sweeps.RIVALS, "tracing", Fragile)
    numbers = sweeps.noise_sweep(field, [sphere], (0.0, 0.03))
    assert numbers["failed"] == {"tracing at 0.03": "RuntimeError: too noisy for me"}
    assert numbers["methods"]["tracing"]["exp"][1] is None
    pixels(error_against_noise(numbers, tmp_path / "noise.png"))


# Times


def test_times_are_positive_and_drawn(field, tmp_path):
    numbers = sweeps.point_times(field, (500, 2000), sources=2, queries=10, repeats=1)
    asked = sweeps.source_times(field, (1, 8), points=500, queries=10, repeats=1)
    for x, names in ((numbers, ("encode", "exp", "log")), (asked, ("exp", "log"))):
        assert json.loads(json.dumps(x)) == x
        assert all(len(x[name]) == len(x["x"]) and min(x[name]) > 0 for name in names)
    for path in (
        time_against_points(numbers, tmp_path / "points.png"),
        time_against_sources(asked, tmp_path / "sources.png"),
    ):
        rows = pixels(path)
        assert shows(rows, look("base")["color"]) and not shows(rows, look("heat")["color"])


def test_what_is_asked_lies_on_the_torus_within_reach(field):
    """The median of the time says nothing when the queries are nonsense."""
    points = sweeps._torus(200)
    ring = points[:, :2].norm(dim=-1) - 0.7
    torch.testing.assert_close(torch.hypot(ring, points[:, 2]), torch.full((200,), 0.3))


# Checkerboards


def test_checkerboards_are_grey_outside_the_mask_and_nowhere_else():
    flat = np.random.default_rng(0).uniform(-0.8, 0.8, (300, 2))
    flat[0] = 0
    seen = np.random.default_rng(1).random(300) < 0.5
    seen[0] = False
    drawn = figures._masked(flat, seen)
    assert np.array_equal(np.linalg.norm(drawn, axis=1) <= figures.RADIUS + 1e-12, seen)
    short = seen & (np.linalg.norm(flat, axis=1) < figures.RADIUS)
    np.testing.assert_allclose(drawn[short], flat[short])


def test_a_column_a_method_and_one_for_the_truth(field, sphere, tmp_path):
    methods = {"heat": Heat(), "projection": Projection()}
    path = checkerboards(sphere, methods, tmp_path / "boards.png", source=0, size=160)
    rows = pixels(path)
    assert rows.shape[1:] == (3 * 160, 3) and 160 <= len(rows) < 200  # a line of titles on top
    rows = rows[-160:]
    blue = (rows[..., 2].astype(int) - rows[..., 0] > 60).reshape(160, 3, 160).sum((0, 2))
    assert blue.min() > 100
    assert blue[0] == pytest.approx(blue[2], rel=0.2)


def test_a_method_without_log_has_no_checkerboard(sphere, tmp_path):
    with pytest.raises(ValueError, match="methods must have prepare and log, 'tracing' lacks one"):
        checkerboards(sphere, {"tracing": Walking()}, tmp_path / "boards.png")


def test_the_source_that_is_drawn_has_something_to_show(sphere):
    hidden = np.zeros_like(sphere.valid)
    for s in (0, 1):
        hidden[:] = False
        hidden[s] = sphere.valid[s]
        only = Shape(
            **{k: getattr(sphere, k) for k in Shape.__dataclass_fields__} | {"valid": hidden}
        )
        assert figures._seen_well(only) == s
