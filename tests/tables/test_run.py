"""The table from prepared shapes to JSON, on a flat square where every answer is known."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from riemlayer import ExpLogField
from riemlayer.baselines import MeshTracer, Neural, TrueLog
from riemlayer.tables import __main__ as command
from riemlayer.tables.evaluate import Shape, evaluate, pool, summarise, tangent_frame
from riemlayer.tables.run import Rows, find_shapes, run


class Straight:
    """Exp and Log of a plane; counts the clouds it was given."""

    prepared = 0

    def __repr__(self) -> str:
        return "Straight()"

    def prepare(self, points):
        self.prepared += 1

    def exp(self, p, v):
        return np.asarray(p) + np.asarray(v)

    def log(self, p, q):
        return np.asarray(q) - np.asarray(p)


class LogOnly:
    """Twice too long a Log."""

    def prepare(self, points):
        pass

    def log(self, p, q):
        return 2 * (np.asarray(q) - np.asarray(p))


class Broken(Straight):
    def __repr__(self) -> str:
        return "Broken()"

    def exp(self, p, v):
        return np.asarray(v) * np.nan


def flat_shape(n: int = 33) -> dict[str, np.ndarray]:
    """A square grid of step 1/32 with two sources, as the arrays of a prepared shape."""
    x = (np.arange(n, dtype=np.float32) - n // 2) / 32
    V = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((n, n), np.float32)], -1)
    V = V.reshape(-1, 3)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1)
    F = np.concatenate(
        [np.stack([a, a + n, a + 1], -1), np.stack([a + 1, a + n, a + n + 1], -1)]
    ).astype(np.int32)
    src = np.array([n * n // 2, n * n // 2 + 1], np.int32)
    vec = np.random.default_rng(0).uniform(-0.35, 0.35, (2, 60, 3)).astype(np.float32)
    vec[..., 2] = 0
    log = V - V[src][:, None]
    valid, ok = np.linalg.norm(log, axis=-1) < 0.5, np.ones((2, 60), bool)
    ok[0, :5] = False
    return {
        "V": V, "F": F, "points": V, "src": src, "vec": vec, "end": V[src][:, None] + vec,
        "src_normal": np.tile(np.float32([0, 0, 1]), (2, 1)), "log": log,
        "ok": ok, "ok_tight": ok, "valid": valid, "valid_tight": valid,
    }  # fmt: skip


def means(method: object, shape: Shape) -> dict[str, dict[str, float]]:
    return summarise(evaluate(method, shape))


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    """Two groups; the clouds of `loose` are not the vertices of its mesh."""
    arrays = flat_shape()
    for group, name in (("flat", "a"), ("flat", "b"), ("loose", "c")):
        (tmp_path / group).mkdir(exist_ok=True)
        points = arrays["V"][::2] if group == "loose" else arrays["V"]
        np.savez(tmp_path / group / f"{name}.npz", **arrays | {"points": points})
    return tmp_path


def test_the_truth_scores_zero_on_a_plane(directory):
    row = means(Straight(), Shape.load(directory / "flat" / "a.npz"))
    floor = means(TrueLog(), Shape.load(directory / "flat" / "a.npz"))
    for section in ("r0.5", "r0.25", "r0.1", "r0.5_tight", "r0.25_tight", "r0.1_tight"):
        distortions = {f"{name}{x}" for name in ("mdd", "mdd_clip", "angle") for x in ("", "_true")}
        assert set(row[section]) == distortions | {"log_end", "exp"}
        for name in distortions:
            assert row[section][name] == floor[section][name] == 0
        assert row[section]["log_end"] < 1e-7 and row[section]["exp"] == 0
    assert row["at_p"]["log_zero"] == row["at_p"]["exp_zero"] == 0
    assert row["at_p"]["log_differential"] < 1e-5 > row["at_p"]["exp_differential"]
    assert set(row["time"]) == {"prepare", "log", "exp"}


def test_a_known_error_comes_out_and_a_missing_map_has_no_numbers(directory):
    row = means(LogOnly(), Shape.load(directory / "flat" / "a.npz"))
    assert row["r0.5"]["mdd"] == row["r0.5"]["mdd_clip"] == 0.5
    assert row["r0.5"]["angle"] == pytest.approx(0, abs=1e-3)
    assert "exp" not in row["r0.5"] and "exp" not in row["time"]


def test_a_log_that_leaves_the_tangent_plane_is_found_out():
    """On a bent sheet q - p keeps every length and angle, but it is no tangent vector."""
    arrays = flat_shape()
    V = arrays["V"].copy()
    V[:, 2] = np.abs(V[:, 0])
    shape = Shape(**arrays | {"V": V, "points": V})
    row = means(Straight(), shape)["r0.5"]
    assert row["angle"] > 5 and row["mdd_clip"] > 0.1
    assert row["angle_true"] > 5 and row["mdd_clip_true"] > 0.1


def test_errors_by_length_add_up(directory):
    class Short(Straight):
        def exp(self, p, v):
            return np.asarray(p) + 0.9 * np.asarray(v)

    row = means(Short(), Shape.load(directory / "flat" / "a.npz"))
    assert all(x == pytest.approx(0.1, rel=1e-3) for x in row["relative_by_length"].values())
    assert 0.02 < row["exp_by_length"]["0.2-0.3"] < 0.03


def test_masks_shrink_with_the_radius_and_leave_collapsed_vertices_out():
    arrays = flat_shape()
    arrays["log"] = arrays["log"].copy()
    arrays["log"][0, 0] = 0.01  # a corner 0.7 away, its log map collapsed
    arrays["valid"] = arrays["valid"] | (np.arange(len(arrays["V"])) == 0)
    masks = Shape(**arrays).masks(0)
    assert masks["r0.1"][0].sum() < masks["r0.25"][0].sum() < masks["r0.5"][0].sum()
    assert masks["r0.1"][1].sum() < masks["r0.25"][1].sum() < masks["r0.5"][1].sum()
    assert arrays["valid"][0, 0] and not masks["r0.5"][0][0]


def test_a_source_that_has_nothing_to_measure_is_left_out():
    arrays = flat_shape()
    arrays["valid"] = arrays["valid"].copy()
    arrays["valid"][1] = False
    one = {k: x if k in ("V", "F", "points") else x[:1] for k, x in arrays.items()}
    both, first = means(LogOnly(), Shape(**arrays)), means(LogOnly(), Shape(**one))
    assert both["r0.5"]["mdd"] == first["r0.5"]["mdd"]


def test_a_failure_is_listed_with_its_reason_and_not_averaged(directory):
    methods = {"straight": Straight(), "broken": Broken()}
    results = run(find_shapes(directory, ["flat"], None), methods, None, Rows())
    assert set(results["broken"]["failed"]) == {"flat/a", "flat/b"}
    assert "`prediction` must be finite" in results["broken"]["failed"]["flat/a"]
    assert results["broken"]["groups"]["flat"] == {"shapes": 0}
    assert results["straight"]["groups"]["flat"]["shapes"] == 2


def test_mesh_methods_run_where_the_cloud_has_faces(directory):
    methods = {"tracer": MeshTracer()}
    results = run(find_shapes(directory, None, None), methods, 1, Rows())
    assert results["tracer"]["groups"]["flat"]["r0.25"]["exp"] < 1e-5
    assert results["tracer"]["groups"]["loose"] == {"shapes": 0}
    assert not results["tracer"]["failed"]


def test_a_known_row_is_not_computed_again(directory, tmp_path):
    shapes, path = find_shapes(directory, ["flat"], 1), tmp_path / "rows.jsonl"
    first, second, third = Straight(), Straight(), Straight()
    a = run(shapes, {"straight": first}, 1, Rows(path))
    b = run(shapes, {"straight": second}, 1, Rows(path))
    assert (first.prepared, second.prepared) == (1, 0)
    assert a == b
    arrays = flat_shape() | {"points": flat_shape()["V"][::3]}
    np.savez(directory / "flat" / "a.npz", **arrays)  # the shape changes, so its row must
    run(shapes, {"straight": third}, 1, Rows(path))
    assert third.prepared == 1


def test_every_source_of_a_group_weighs_the_same():
    tables = [
        {"r0.5": {"mdd": [1.0, 3.0], "exp": [4.0]}, "time": {"log": [1.0, 2.0]}},
        {"r0.5": {"mdd": [8.0]}, "time": {"log": [9.0]}},
    ]
    mean = summarise(pool(tables))
    assert mean == {"r0.5": {"mdd": 4.0, "exp": 4.0}, "time": {"log": 2.0}}


def test_a_run_cut_off_goes_on_where_it_stopped(directory, tmp_path):
    class Killed(Straight):
        def prepare(self, points):
            super().prepare(points)
            if self.prepared == 2:
                raise KeyboardInterrupt

    shapes, path = find_shapes(directory, ["flat"]), tmp_path / "rows.jsonl"
    with pytest.raises(KeyboardInterrupt):
        run(shapes, {"s": Killed()}, 1, Rows(path))
    path.write_bytes(path.read_bytes() + b'{"key": "cut of')
    again, rows = Straight(), Rows(path)
    results = run(shapes, {"s": again}, 1, rows)
    assert (again.prepared, rows.hits, results["s"]["groups"]["flat"]["shapes"]) == (1, 1, 2)
    last = Straight()
    run(shapes, {"s": last}, 1, Rows(path))
    assert last.prepared == 0


def test_other_weights_are_another_row():
    torch.manual_seed(0)
    a, b = (Neural(ExpLogField.from_preset("tiny"), "same") for _ in range(2))
    twin = ExpLogField.from_preset("tiny")
    twin.load_state_dict(a._field.state_dict())
    assert repr(a) != repr(b)
    assert repr(a) == repr(Neural(twin, "same"))


def test_the_command_writes_the_tables(directory, tmp_path, capsys):
    out = tmp_path / "out"
    command.main(
        f"{directory} --methods projection,tracing,floor --groups flat --sources 1 --limit 1 "
        f"--no-figures -o {out}".split()
    )
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("| flat | E_MDD | E_MDD, edges clipped at 1 | E_angle")
    assert [line.split("|")[1].strip()[:5] for line in lines[2:5]] == ["Proje", "Traci", "the t"]
    written = json.loads((out / "tables.json").read_text(), parse_constant=pytest.fail)
    assert set(written["methods"]) == {"projection", "tracing", "floor"}
    assert list(written["methods"]["floor"]["shapes"]["flat"]) == ["a"]
    text = (out / "tables.md").read_text()
    assert "radius 0.1, shortest geodesics only" in text and "paper: ours" in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--methods heet", "methods must be among heat, "),
        ("--ablations nowhere", "--ablations must hold ablation.json, nowhere does not"),
        ("--methods floor --groups nowhere", r"found none in \['nowhere'\]"),
    ],
)
def test_what_the_command_cannot_do_it_says(directory, arguments, words):
    with pytest.raises(SystemExit, match=words):
        command.main([str(directory), *arguments.split()])


def test_a_folder_that_is_none_is_named(tmp_path):
    with pytest.raises(SystemExit, match=r"folder of meshes or prepared shapes, got .*nowhere"):
        command.main([str(tmp_path / "nowhere")])


@pytest.mark.parametrize("content", ["arrays", "text", "nothing"])
def test_a_file_that_is_no_shape_is_listed_and_the_rest_measured(directory, content):
    path = directory / "flat" / "bad.npz"
    if content == "arrays":
        np.savez(path, V=np.zeros((3, 3)))
    else:
        path.write_text("no archive" if content == "text" else "")
    results = run(find_shapes(directory, ["flat"], None), {"s": Straight()}, 1, Rows())
    assert list(results["s"]["failed"]) == ["flat/bad"]
    assert results["s"]["groups"]["flat"]["shapes"] == 2


def test_a_failure_is_tried_again_by_the_next_run(directory, tmp_path):
    rows = Rows(tmp_path / "rows.jsonl")
    run(find_shapes(directory, ["flat"], 1), {"broken": Broken()}, 1, rows)
    again = Broken()
    run(find_shapes(directory, ["flat"], 1), {"broken": again}, 1, rows)
    assert again.prepared == 1


@pytest.mark.parametrize("normal", [[0, 0, 1], [1, 0, 0], [0.6, 0, -0.8]])
def test_the_frame_is_orthonormal_and_tangent(normal):
    frame = tangent_frame(np.array(normal, float))
    np.testing.assert_allclose(frame.T @ frame, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(frame.T @ normal, 0, atol=1e-12)
