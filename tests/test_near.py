"""The benchmark of errors close to a source, on maps whose errors are known."""

import json
from dataclasses import asdict
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from benchmarks import near
from riemlayer.data.closed_form import Sphere
from riemlayer.tables.evaluate import Shape
from riemlayer.tables.shapes import procedural_shapes

SPHERE = Sphere(1.0)


class Wrong:
    """The sphere's maps, off by known vectors, and normals that lean by known angles."""

    def __init__(self, exp: float = 0.0, log: float = 0.0, lean: tuple[float, ...] = (0, 0)):
        self.exp, self.log = (torch.tensor([x, 0, 0]) for x in (exp, log))
        self.lean = torch.tensor(lean).deg2rad()[:, None]

    def encode(self, points):
        def normal(p):
            n = SPHERE.normal(p)
            aside = torch.nn.functional.normalize(torch.linalg.cross(n, n.roll(1, -1)), dim=-1)
            return -(self.lean.cos() * n + self.lean.sin() * aside)

        return SimpleNamespace(
            exp=lambda p, v: SPHERE.exp(p, v) + self.exp,
            log=lambda p, q: SPHERE.log(p, q) + self.log,
            normal=normal,
        )


@pytest.fixture
def shape() -> Shape:
    """A sphere; from two of three sources geodesics are known that are shorter than a tenth."""
    V = SPHERE.sample(50, torch.Generator().manual_seed(0))
    p = V[:3, None]
    v = SPHERE.project_to_tangent(p, torch.randn(3, 20, 3).double())
    length = torch.linspace(0.03, 0.15, 20, dtype=torch.float64)[:, None]
    v = length * v / v.norm(dim=-1, keepdim=True)
    fields = dict.fromkeys(Shape.__dataclass_fields__, np.zeros(0))
    fields |= {"V": V.numpy(), "points": V.numpy(), "src": np.arange(3), "vec": v.numpy()}
    fields |= {"src_normal": SPHERE.normal(V[:3]).numpy(), "end": SPHERE.exp(p, v).numpy()}
    known = np.ones((3, 20), bool)
    known[1, length[:, 0] < 0.1] = False
    sure = known & (np.arange(20) < 5)
    return Shape(**fields | {"ok": known, "ok_tight": sure})


def test_errors_and_the_tangent_plane_are_told_as_they_are(shape):
    found = near.sources(Wrong(0.01, 0.002, (0.0, 9.0, 30.0)), shape, 0.1)
    assert len(found) == 2  # from the second source no geodesic is known that is short enough
    length = np.linalg.norm(shape.vec[0], axis=-1)
    for source, off in zip(found, (0.0, 30.0), strict=True):
        assert source.off == pytest.approx(off, abs=0.05)
        assert source.exp == pytest.approx(0.01, rel=1e-3)
        assert source.log == pytest.approx(0.002, rel=1e-3)
        assert source.distance == pytest.approx(length[length < 0.1].mean(), rel=1e-4)
        assert source.share == pytest.approx(100 * source.log / source.distance)
        assert (source.shortest, source.exp_shortest) == (5, pytest.approx(0.01, rel=1e-3))
        assert 0 < source.tracing_shortest < length[4]  # 50 points: it walks, if badly


def test_a_row_has_means_medians_and_those_of_planes_that_are_well_told():
    values = (1, 0.001), (0, 0.003), (20, 0.02)
    found = [near.Source(off, x, 2 * x, 0.05, 0, 0.0, 0.0) for off, x in values]
    count, off, *errors, told, exp, log, share = near.row(found)
    assert (count, off, told) == ("3", "7.0", "67%")
    assert errors == ["0.0080", "0.0030", "0.0160", "0.0060", "32.0", "12.0"]
    assert (exp, log, share) == ("0.0020", "0.0040", "8.0")
    assert near.row(found[2:])[-3:] == ["–"] * 3


def test_shortest_geodesics_count_alike_whatever_source_they_start_from():
    found = [near.Source(0, 1, 1, 1, n, x, 2 * x) for n, x in ((3, 0.01), (1, 0.03), (0, 0.0))]
    assert near.compared(found) == ["4", "0.0150", "0.0300"]
    assert near.compared(found[2:]) == ["0", "–", "–"]


@pytest.mark.slow
def test_the_command_writes_its_table(tmp_path):
    made = procedural_shapes(1, tmp_path / "shapes", sources=3)
    assert not made.failures
    near.main([str(tmp_path / "shapes"), "--radius", "0.2", "-o", str(tmp_path)])
    (found,) = json.loads((tmp_path / "near.json").read_text())["groups"].values()
    assert found and all(0 <= row["exp"] < 0.1 and 0 <= row["off"] <= 90 for row in found)
    assert asdict(near.Source(**found[0])) == found[0]
    assert (tmp_path / "near.md").read_text().startswith("| group | sources")


def test_an_empty_folder_is_told(tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        near.main([str(tmp_path)])
    assert stopped.value.code == 2
    assert "holds no GROUP/SHAPE.npz" in capsys.readouterr().err
