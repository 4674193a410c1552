"""A run that diverges ends before its weights do, and its last good checkpoint stays."""

from importlib import util
from pathlib import Path

import lightning as L
import pytest
import torch

from lightning_modules import DivergedError, DivergenceGuard, ExpLogPretraining

pytestmark = pytest.mark.filterwarnings("ignore::Warning:lightning")  # it talks of its own matters

spec = util.spec_from_file_location("ranks", Path(__file__).with_name("ranks.py"))
ranks = util.module_from_spec(spec)
spec.loader.exec_module(ranks)


class Spoiled(ExpLogPretraining):
    """Its loss, or its gradient, is spoiled from a step on."""

    def __init__(self, at: int, factor: float, gradient: bool = False) -> None:
        super().__init__("tiny", ranks.LOSSES, warmup=3)
        self.at, self.factor, self.gradient = at, factor, gradient

    def training_step(self, batch, batch_idx):
        loss = super().training_step(batch, batch_idx)
        if self.global_step < self.at:
            return loss
        if self.gradient:
            loss.register_hook(lambda x: self.factor * x)
            return loss
        return self.factor * loss


@pytest.mark.parametrize(
    ("spoiled", "named"),
    [
        ({"factor": float("nan")}, "the loss is nan"),
        ({"factor": float("inf")}, "the loss is inf"),
        ({"factor": float("nan"), "gradient": True}, "the gradient is not finite"),
    ],
)
def test_what_is_not_finite_never_reaches_the_weights(folder, tmp_path, spoiled, named):
    model = Spoiled(3, **spoiled)
    with pytest.raises(DivergedError, match=f"step 3: {named}; go on from .*last.ckpt"):
        ranks.fit(folder, tmp_path, 9, model=model)
    state = torch.load(tmp_path / "last.ckpt", weights_only=False)
    assert state["global_step"] == 3
    for name, x in model.state_dict().items():
        assert bool(x.isfinite().all()) and torch.equal(x, state["state_dict"][name]), name
    healthy = ExpLogPretraining("tiny", ranks.LOSSES, warmup=3)
    assert ranks.fit(folder, tmp_path, 5, resume=True, model=healthy).global_step == 5


def test_the_last_checkpoint_is_from_before_the_loss_exploded(folder, tmp_path):
    """Losses 1000 times the median of five, three in a row; a checkpoint is due at every step."""
    with pytest.raises(DivergedError, match=r"above 10 times its median, .*, for 3 batches"):
        ranks.fit(folder, tmp_path, 20, model=Spoiled(7, 1000.0))
    assert torch.load(tmp_path / "last.ckpt", weights_only=False)["global_step"] == 7


def judged(guard: DivergenceGuard, losses: list[float]) -> None:
    trainer = L.Trainer(accelerator="cpu", logger=False, enable_checkpointing=False)
    for loss in losses:
        guard.on_before_backward(trainer, None, torch.tensor(loss))


def test_single_peaks_are_forgiven_and_a_continued_guard_remembers():
    guard = DivergenceGuard(factor=5, window=4, patience=2)
    judged(guard, [1.0] * 4 + [50.0, 1.0] * 3)
    assert not guard.in_doubt
    other = DivergenceGuard(factor=5, window=4, patience=2)
    other.load_state_dict(guard.state_dict())
    judged(other, [50.0])
    assert other.in_doubt and guard.losses == other.losses
    with pytest.raises(DivergedError, match="start again"):
        judged(other, [50.0])


@pytest.mark.parametrize("name", ["factor", "window", "patience"])
def test_arguments_are_checked(name):
    with pytest.raises(ValueError, match=name):
        DivergenceGuard(**{name: 0})


def test_scaled_losses_are_refused():
    trainer = L.Trainer(accelerator="cpu", logger=False, enable_checkpointing=False)
    trainer.strategy.precision_plugin.precision = "16-mixed"
    with pytest.raises(ValueError, match="bf16-mixed"):
        DivergenceGuard().setup(trainer, None, "fit")
