"""The benchmark of turned and shifted clouds, on maps whose changes are known."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from benchmarks import motions
from riemlayer.config import FieldConfig
from riemlayer.data.closed_form import Sphere
from riemlayer.tables.evaluate import Shape


class Straight:
    """Exp_p(v) = p + v + bias, Log_p(q) = q - p - bias, with a bias that does not turn along."""

    config = FieldConfig.tiny()

    def __init__(self, bias: float) -> None:
        self.bias = torch.tensor([0.0, 0.0, bias])

    def encode(self, points, batch=None):
        return SimpleNamespace(
            exp=lambda p, v: p + v + self.bias, log=lambda p, q: q - p - self.bias
        )

    encode_in_cube = encode


@pytest.fixture
def shape() -> Shape:
    """A sphere with traced vectors, half of them below a tenth."""
    generator = torch.Generator().manual_seed(0)
    sphere = Sphere(1.0)
    V = sphere.sample(50, generator)
    p = V[:4, None]
    v = sphere.project_to_tangent(p, torch.randn(4, 20, 3, generator=generator).double())
    length = torch.linspace(0.01, 0.19, 20, dtype=torch.float64)[:, None]
    v = length * v / v.norm(dim=-1, keepdim=True)
    fields = dict.fromkeys(Shape.__dataclass_fields__, np.zeros(0))
    fields |= {"V": V.numpy(), "points": V.numpy(), "src": np.arange(4), "vec": v.numpy()}
    fields |= {"end": sphere.exp(p, v).numpy(), "ok": np.ones((4, 20), bool)}
    return Shape(**fields)


@pytest.mark.parametrize("move", motions.MOVES.values(), ids=motions.MOVES)
def test_maps_that_turn_along_change_by_nothing_and_err_as_they_do(move, shape):
    p = shape.V[shape.src][:, None]
    apart = np.linalg.norm(p + shape.vec - shape.end, axis=-1)
    near = np.linalg.norm(shape.vec, axis=-1) < 0.1
    rows = list(move(Straight(0), shape, 3))
    assert len(rows) == 3
    for row in rows:
        for radius, error in (("0.5", apart.mean()), ("0.1", apart[near].mean())):
            exp_moved, exp_error, log_moved, log_error = row[radius]
            assert exp_moved < 1e-6 and log_moved < 1e-6
            assert exp_error == pytest.approx(error, rel=1e-4)
            assert log_error == pytest.approx(error, rel=1e-4)


def test_what_does_not_turn_along_shows_under_rotations_alone(shape):
    field = Straight(0.01)
    (turned,) = motions.turned(field, shape, 1)
    turn = motions.rotation(1.0, torch.Generator().manual_seed(len(shape.points)))
    expected = float((field.bias - field.bias @ turn).norm())
    assert turned["0.5"][0] == pytest.approx(expected, rel=1e-3) and expected > 1e-3
    assert turned["0.5"][2] == pytest.approx(expected, rel=1e-3)
    (shifted,) = motions.shifted(field, shape, 1)
    assert shifted["0.5"][0] < 1e-6 and shifted["0.1"][2] < 1e-6


@pytest.mark.slow
def test_the_command_writes_its_table(tmp_path):
    motions.main(["--weights", "base", "-n", "1", "--sources", "2", "-o", str(tmp_path)])
    rows = json.loads((tmp_path / "motions.json").read_text())["rows"]
    assert rows.keys() == motions.MOVES.keys()
    assert all(0 < x < 0.2 for row in rows.values() for numbers in row.values() for x in numbers)
    assert (tmp_path / "motions.md").read_text().startswith("| the cloud is")
