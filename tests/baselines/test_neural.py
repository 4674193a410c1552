"""The field behind the rivals' interface answers what the field itself answers."""

import numpy as np
import torch

from riemlayer import ExpLogField
from riemlayer.baselines import Neural, SupportsExp, SupportsLog, SupportsPoints


def sphere(n: int = 600) -> np.ndarray:
    return torch.nn.functional.normalize(torch.randn(n, 3), dim=-1).numpy()


def test_the_adapter_asks_the_field():
    field, points = ExpLogField.from_preset("tiny").eval(), sphere()
    method = Neural(field)
    method.prepare(points)
    surface = field.encode(torch.from_numpy(points))
    p, x = points[0], 0.1 * sphere(20)
    expected = surface.exp(torch.from_numpy(p), torch.from_numpy(x)).detach().numpy()
    np.testing.assert_allclose(method.exp(p, x), expected, atol=1e-6)
    expected = surface.log(torch.from_numpy(p), torch.from_numpy(p + x)).detach().numpy()
    np.testing.assert_allclose(method.log(p, p + x), expected, atol=1e-6)


def test_the_adapter_leaves_the_field_in_its_mode_and_without_gradients():
    field = ExpLogField.from_preset("tiny").train()
    method = Neural(field, "tiny")
    method.prepare(sphere())
    assert field.training
    assert all(parameter.grad is None for parameter in field.parameters())
    assert repr(method).startswith("Neural('tiny', ")


def test_the_adapter_loads_what_was_saved(tmp_path):
    field, points = ExpLogField.from_preset("tiny"), sphere()
    field.save_pretrained(tmp_path / "weights")
    first, second = Neural(field), Neural.from_pretrained(str(tmp_path / "weights"))
    for method in (first, second):
        method.prepare(points)
    q = 0.5 * (points + points[0])
    np.testing.assert_array_equal(first.log(points[0], q), second.log(points[0], q))


def test_the_adapter_has_both_maps():
    method = Neural(ExpLogField.from_preset("tiny"))
    assert isinstance(method, SupportsPoints)
    assert isinstance(method, SupportsLog) and isinstance(method, SupportsExp)
