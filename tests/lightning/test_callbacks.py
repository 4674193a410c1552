"""The running average of the weights."""

from types import SimpleNamespace

import torch
from torch import nn

from lightning_modules import ExponentialAverage


class Stub(nn.Module):
    """A module whose field can be saved."""

    def __init__(self) -> None:
        super().__init__()
        self.field = nn.Linear(2, 1, bias=False)
        self.saved: list = []
        self.field.save_pretrained = lambda folder: self.saved.append(  # pyright: ignore
            (folder, self.field.weight.detach().clone())
        )


def step(callback: ExponentialAverage, module: Stub, n: int, value: float) -> None:
    """The optimiser's n-th step leaves `value` in every weight."""
    nn.init.constant_(module.field.weight, value)
    callback.on_train_batch_end(SimpleNamespace(global_step=n), module, None, None, n)  # pyright: ignore


def test_average_is_that_of_a_loop():
    callback, module, expected = ExponentialAverage(decay=0.5), Stub(), 3.0
    for n, value in enumerate([3.0, 1.0, 4.0, 1.0, 5.0, 9.0], 1):
        step(callback, module, n, value)
        decay = min(0.5, (1 + n) / (10 + n))
        expected = decay * expected + (1 - decay) * value
        torch.testing.assert_close(callback.average["weight"], torch.full((1, 2), expected))
        assert (module.field.weight == value).all()  # the weights are their own


def test_validation_sees_and_exports_the_average_and_training_goes_on_without(tmp_path):
    callback, module = ExponentialAverage(decay=0.5, export=str(tmp_path)), Stub()
    trainer = SimpleNamespace(global_step=1, sanity_checking=False, is_global_zero=True)
    step(callback, module, 1, 2.0)
    step(callback, module, 2, 8.0)
    average = callback.average["weight"].clone()
    callback.on_validation_start(trainer, module)  # pyright: ignore
    assert torch.equal(module.field.weight, average)
    callback.on_validation_end(trainer, module)  # pyright: ignore
    assert (module.field.weight == 8).all()
    ((folder, saved),) = module.saved
    assert folder == tmp_path and torch.equal(saved, average)


def test_a_sanity_check_before_the_first_step_changes_nothing(tmp_path):
    callback, module = ExponentialAverage(export=str(tmp_path)), Stub()
    before = module.field.weight.detach().clone()
    trainer = SimpleNamespace(global_step=0, sanity_checking=True, is_global_zero=True)
    callback.on_validation_start(trainer, module)  # pyright: ignore
    callback.on_validation_end(trainer, module)  # pyright: ignore
    assert torch.equal(module.field.weight, before) and not module.saved


def test_an_average_is_continued_from_a_checkpoint():
    one, module = ExponentialAverage(decay=0.9), Stub()
    step(one, module, 1, 2.0)
    step(one, module, 2, 3.0)
    other = ExponentialAverage(decay=0.9)
    other.load_state_dict(
        {"average": {k: x.clone() for k, x in one.state_dict()["average"].items()}}
    )
    for callback in (one, other):
        step(callback, module, 3, 7.0)
    assert torch.equal(one.average["weight"], other.average["weight"])
