"""The benchmark on surfaces with known geodesics, on maps whose errors are known."""

import json

import numpy as np
import pytest
import torch

from benchmarks import exact
from riemlayer.data.closed_form import Sphere

SPHERE = Sphere()


class Known:
    """The sphere's maps, off by known vectors."""

    def __init__(self, exp: float, log: float) -> None:
        self.off = exp, log

    def prepare(self, points):
        assert points.dtype == np.float32

    def exp(self, p, v):
        return SPHERE.exp(*map(torch.from_numpy, (p, v))).numpy() + np.array([self.off[0], 0, 0])

    def log(self, p, q):
        return SPHERE.log(*map(torch.from_numpy, (p, q))).numpy() + np.array([0, 0, self.off[1]])


class OnlyLog:
    """Says zero."""

    def prepare(self, points): ...

    def log(self, p, q):
        return np.zeros_like(q)


def test_errors_are_told_as_they_are():
    generator = torch.Generator().manual_seed(0)
    points = SPHERE.sample(50, generator)
    p = points[:5]
    v = exact.vectors(SPHERE, p, 7, generator)
    methods = {"known": Known(0.02, 0.003), "only log": OnlyLog()}
    found = exact.errors(methods, SPHERE, points, p, v)
    assert found["exp"] == {"known": pytest.approx(0.02, rel=1e-4)}
    assert found["log"]["known"] == pytest.approx(0.003, rel=1e-2)
    assert found["log"]["only log"] == pytest.approx(float(v.norm(dim=-1).mean()), rel=1e-5)


@pytest.mark.parametrize("name", exact.SURFACES)
def test_geodesics_are_tangent_within_the_radius_and_end_within_the_cloud(name):
    (surface, high), generator = exact.SURFACES[name], torch.Generator().manual_seed(0)
    points = surface.sample(2000, generator)
    p = points[points[:, 2].abs() < high][:20]
    v = exact.vectors(surface, p, 50, generator)
    assert v.shape == (20, 50, 3)
    assert v.norm(dim=-1).max() <= exact.RADIUS + 1e-9
    assert float(v.norm(dim=-1).mean()) == pytest.approx(2 / 3 * exact.RADIUS, rel=0.05)
    assert (v * surface.normal(p)[:, None]).sum(-1).abs().max() < 1e-9
    assert (surface.exp(p[:, None], v).abs() <= points.abs().amax(0) + 0.01).all()


def test_the_best_of_each_map_is_bold():
    row = {"surface": "s", "points": 1000, "exp": {"a": 0.2, "b": 0.1}, "log": {"b": 0.3}}
    head, _, line = exact.table([row], ["a", "b"]).splitlines()
    assert head == "| surface | points | Exp: a | Exp: b | Log: b |"
    assert line == "| s | 1,000 | 0.2000 | **0.1000** | **0.3000** |"


@pytest.mark.slow
def test_the_command_writes_its_table_and_the_field_is_closer_than_projection(tmp_path):
    exact.main(["--points", "1500", "--sources", "3", "--vectors", "20", "-o", str(tmp_path)])
    rows = json.loads((tmp_path / "exact.json").read_text())["rows"]
    assert [row["surface"] for row in rows] == list(exact.SURFACES)
    for row in rows:
        for kind in ("exp", "log"):
            assert 0 < row[kind]["riemlayer"] < row[kind]["Projection"]
    assert (tmp_path / "exact.md").read_text().startswith("| surface | points")
