"""The training module: a configuration of its own, and when the learning rate reaches 0."""

import json
from dataclasses import replace
from datetime import timedelta

import lightning as L
import pytest
import torch
from references import fibonacci_sphere

from lightning_modules import ExpLogPretraining
from lightning_modules.datamodule import collate
from lightning_modules.export import export
from riemlayer import FieldConfig
from riemlayer.data.augment import TrainingSample
from riemlayer.losses import Truth

pytestmark = pytest.mark.filterwarnings("ignore::Warning:lightning")  # it talks of its own matters

TINY = FieldConfig.tiny()
PLAIN = replace(TINY, head=replace(TINY.head, anchored=False, narrow=0, walks=0))


def test_the_rate_falls_with_the_time_where_there_is_no_last_step():
    """Straight to 0 at `max_time`; without steps and time it stays; with steps they decide."""
    minute = timedelta(minutes=1)
    quiet = {"logger": False, "enable_checkpointing": False, "accelerator": "cpu"}
    model = ExpLogPretraining(config=TINY, warmup=0)
    for limits, elapsed, rate in [
        ({"max_epochs": -1, "max_time": minute}, 0, 1),
        ({"max_epochs": -1, "max_time": minute}, 15, 0.75),
        ({"max_epochs": -1, "max_time": minute}, 90, 0),
        ({"max_epochs": -1}, 90, 1),
        ({"max_epochs": -1, "max_steps": 10, "max_time": minute}, 15, 1),
    ]:
        model.trainer = trainer = L.Trainer(**limits, **quiet)
        for callback in trainer.callbacks:
            if isinstance(callback, L.pytorch.callbacks.Timer):
                callback.load_state_dict({"time_elapsed": {"train": elapsed}})
        schedule = model.configure_optimizers()["lr_scheduler"]["scheduler"]
        assert schedule.get_last_lr() == [pytest.approx(1e-3 * rate)], limits


def test_a_field_for_normals_is_trained_on_normals():
    """Its stem and its planes see them: turned inside out, the loss of the same batch differs."""
    config = replace(TINY, backbone=replace(TINY.backbone, normals=True))
    model = ExpLogPretraining(config=config)
    points = fibonacci_sphere(600).float() * 0.9
    p, v = points[:3], 0.1 * torch.randn(3, 8, 3)
    flags = torch.ones(3, 8, dtype=torch.bool)
    truth = Truth(p, v, p[:, None] + v, flags, flags, torch.zeros(3).long())
    losses = []
    for normals in (points / 0.9, -points / 0.9):
        sample = TrainingSample(points, truth, normals)
        losses.append(model.training_step(collate([sample]), 0))
    assert losses[0].item() != losses[1].item()
    losses[0].backward()
    first = model.field.get_parameter("backbone.stem.points.0.weight").grad
    assert first is not None and (first[:, -3:] != 0).any()
    with pytest.raises(ValueError, match="`normals` must be given"):
        model.training_step(collate([TrainingSample(points, truth)]), 0)


def test_a_configuration_takes_the_place_of_a_preset(tmp_path):
    """Through a checkpoint, loaded as plain values, and through the export."""
    trainer = L.Trainer(accelerator="cpu", logger=False, max_steps=1, enable_progress_bar=False)
    for name, model in {
        "config": ExpLogPretraining(config=PLAIN),
        "preset": ExpLogPretraining("tiny"),
    }.items():
        trainer.strategy.connect(model)
        trainer.save_checkpoint(path := tmp_path / f"{name}.ckpt")
        state = torch.load(path, weights_only=True)
        assert ("config" in state["hyper_parameters"]) == (name == "config")
        loaded = ExpLogPretraining.load_from_checkpoint(path)
        assert loaded.field.config == model.field.config == (PLAIN if name == "config" else TINY)
        for key, x in model.state_dict().items():
            assert torch.equal(loaded.state_dict()[key], x)
        state["callbacks"] = {}
        torch.save(state, path)
        card = json.loads(export(path, tmp_path / f"{name}.safetensors", {}).read_text())
        assert FieldConfig.from_dict(card["config"]) == model.field.config
