"""The speed benchmarks run, and what they compute from their clocks is right."""

import json
import time

import pytest
import torch

from benchmarks import scaling, speed
from benchmarks.measure import median_seconds
from benchmarks.scaling import Line, Sample
from benchmarks.speed import Row, table
from benchmarks.tasks import load_field, neighbours, tangent_vectors, torus


def test_torus_lies_in_the_cube_on_the_torus():
    x = torus(2_000)
    ring = torch.stack((x[:, :2].norm(dim=-1) - 2 / 3, x[:, 2]), -1)
    torch.testing.assert_close(ring.norm(dim=-1), torch.full((2_000,), 1 / 3))
    assert x.abs().max() <= 1


def test_vectors_are_tangent_to_the_torus():
    p = torus(5)
    v = tangent_vectors(p, 100, 0.5)
    q = p[:, None] + 1e-3 * v
    ring = torch.stack((q[..., :2].norm(dim=-1) - 2 / 3, q[..., 2]), -1)
    assert (ring.norm(dim=-1) - 1 / 3).abs().max() < 1e-6  # leaves it with the square of the step
    assert v.norm(dim=-1).max() <= 0.5


def test_neighbours_are_the_nearest_points():
    points = torus(300)
    nearest = torch.cdist(points, points, compute_mode="donot_use_mm_for_euclid_dist")
    found = nearest.gather(1, neighbours(points))
    torch.testing.assert_close(found, nearest.topk(16, largest=False)[0])


def test_median_leaves_the_warm_up_out():
    naps = iter((0.05, 0.0, 0.0, 0.05))
    assert median_seconds(lambda: time.sleep(next(naps)), repeats=3, warm_up=1) < 0.04


def test_fit_finds_the_law_behind_exact_times():
    def law(points, leaves):
        return Sample(1, points, leaves, 0.01 + 2e-7 * points + 3e-5 * leaves)

    line = Line.fit([law(n, int(n**0.7)) for n in (1_000, 5_000, 20_000, 300_000, 1_000_000)])
    assert line.fixed == pytest.approx(0.01)
    assert line.point == pytest.approx(2e-7)
    assert line.leaf == pytest.approx(3e-5)
    assert line.r_squared == pytest.approx(1)


def test_table_divides_the_rival_by_the_field():
    row = Row("Log", 0.004, 0.01, 120.4, 600, {"heat": 0.012}, {"heat": 2.0})
    facts = dict.fromkeys(("weights", "processor", "threads", "torch"), "?")
    text = table([row], facts | {"points": 10, "leaves": 5})
    last = text.splitlines()[-1]
    assert last == "| Log | 4 ms | 10 ms | 120 MB | 600 MB | heat | 12 ms | 3.0 | 2 |"


def test_untrained_field_by_preset():
    assert load_field("preset:tiny").config.backbone.depth == 4


@pytest.mark.slow
@pytest.mark.parametrize("benchmark, name", [(speed, "speed"), (scaling, "scaling")])
def test_writes_json_and_markdown(benchmark, name, tmp_path, capsys):
    threads = str(torch.get_num_threads())
    options = ["--fast", "--weights", "preset:tiny", "--threads", threads]
    benchmark.main([*options, "--output", str(tmp_path)])
    results = json.loads((tmp_path / f"{name}.json").read_text())
    assert results["facts"]["weights"] == "preset:tiny"
    assert (tmp_path / f"{name}.md").read_text().strip() in capsys.readouterr().out
    rows = results["rows"] if name == "speed" else results["one_cloud"] + results["packed"]
    assert all(row["seconds"] > 0 for row in rows)
    assert any((row["megabytes"] or 0) > 0 for row in rows)
    if name == "scaling":
        assert (tmp_path / "scaling.png").stat().st_size > 0
