"""Fine-tuning: what is frozen when, what keeps the weights near, and learning without truth."""

import lightning as L
import numpy as np
import pytest
import torch
from references import lumpy

from lightning_modules import CloudDataModule, ExpLogDataModule, ExpLogFineTuning
from lightning_modules.export import export
from riemlayer import ExpLogField
from riemlayer.losses import LossWeights, self_supervised_losses

pytestmark = pytest.mark.filterwarnings("ignore::Warning:lightning")  # it talks of its own matters


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """A folder with weights to start from."""
    folder = tmp_path_factory.mktemp("start")
    torch.manual_seed(0)
    ExpLogField.from_preset("tiny").save_pretrained(folder)
    return str(folder)


def fit(model: ExpLogFineTuning, data: L.LightningDataModule, steps: int) -> ExpLogFineTuning:
    L.seed_everything(0, verbose=False)
    L.Trainer(
        accelerator="cpu",
        logger=False,
        max_steps=steps,
        limit_val_batches=0,
        enable_progress_bar=False,
        enable_model_summary=False,
        enable_checkpointing=False,
    ).fit(model, datamodule=data)
    return model


def moved(model: ExpLogFineTuning, start: str, part: str) -> float:
    before = dict(ExpLogField.from_pretrained(start).named_parameters())
    now = model.field.named_parameters()
    parts = [(x - before[name]).detach().abs().max() for name, x in now if name.startswith(part)]
    return float(torch.stack(parts).max())


def samples(folder) -> ExpLogDataModule:
    return ExpLogDataModule([str(folder)], sources=4, vectors=16)


def test_the_backbone_waits_for_its_milestone(folder, start):
    early = fit(ExpLogFineTuning(start, unfreeze_at=3), samples(folder), 3)
    assert moved(early, start, "backbone") == 0 and moved(early, start, "exp_head") > 0
    late = fit(ExpLogFineTuning(start, unfreeze_at=3), samples(folder), 5)
    assert moved(late, start, "backbone") > 0
    never = fit(ExpLogFineTuning(start, unfreeze_at=-1), samples(folder), 5)
    assert moved(never, start, "backbone") == 0


def test_the_backbone_moves_at_its_own_rate(folder, start):
    model = ExpLogFineTuning(start, learning_rate=1e-3, backbone_rate=0.1, unfreeze_at=0, warmup=0)
    model.trainer = L.Trainer(max_steps=10, accelerator="cpu", logger=False)
    heads, backbone = model.configure_optimizers()["optimizer"].param_groups
    assert backbone["initial_lr"] == pytest.approx(0.1 * heads["initial_lr"])
    counted = sum(x.numel() for g in (heads, backbone) for x in g["params"])
    assert counted == sum(x.numel() for x in model.field.parameters())


def test_keep_holds_the_weights_near_the_start(folder, start):
    distance = {}
    for keep in (0.0, 10.0):
        model = ExpLogFineTuning(start, keep=keep, unfreeze_at=0, warmup=0, learning_rate=3e-3)
        fit(model, samples(folder), 12)
        model.start = [*ExpLogField.from_pretrained(start).parameters()]
        distance[keep] = float(model.distance_from_start().detach())
    assert 0 < distance[10.0] < 0.7 * distance[0.0], distance


@pytest.mark.slow
def test_consistency_alone_brings_log_back_from_exp(tmp_path, start):
    """Self-supervised: |Log(Exp v) - v| falls on a cloud that was not trained on."""
    for i in range(1, 3):
        np.savez(tmp_path / f"{i}.npz", points=lumpy(500 + i).float().numpy())
    data = CloudDataModule(sorted(tmp_path.glob("*.npz")), points=400)
    field = ExpLogField.from_pretrained(start)
    torch.nn.init.normal_(field.log_head.decoder.out.weight, std=0.6)
    field.save_pretrained(tmp_path / "spoilt")
    model = ExpLogFineTuning(
        str(tmp_path / "spoilt"), self_supervised=True, learning_rate=3e-3, warmup=0, sources=8
    )
    before = cycle(model.field)
    fit(model, data, 40)
    assert cycle(model.field) < 0.6 * before


def cycle(field: ExpLogField) -> float:
    points = lumpy(500).float()
    torch.manual_seed(1)
    with torch.no_grad():
        surface = field.encode_in_cube(points / points.abs().max(), torch.zeros(500).long())
        return float(self_supervised_losses(surface, LossWeights(geo=0, cyc=1))["cycle"])


def test_a_checkpoint_becomes_weights_again(folder, start, tmp_path):
    trainer = L.Trainer(accelerator="cpu", logger=False, max_steps=2, enable_progress_bar=False)
    model = ExpLogFineTuning(start, unfreeze_at=0, warmup=0)
    trainer.fit(model, datamodule=samples(folder))
    trainer.save_checkpoint(tmp_path / "tuned.ckpt")
    export(tmp_path / "tuned.ckpt", tmp_path / "model.safetensors", {})
    (tmp_path / "model.json").rename(tmp_path / "config.json")
    tuned = ExpLogField.from_pretrained(tmp_path)
    assert tuned.config == model.field.config
    for name, x in tuned.state_dict().items():
        torch.testing.assert_close(x, model.field.state_dict()[name], rtol=1e-3, atol=1e-5)


def test_what_makes_no_sense_is_refused(tmp_path, start):
    with pytest.raises(ValueError, match="keep must not be negative, got -1"):
        ExpLogFineTuning(start, keep=-1)
    with pytest.raises(ValueError, match="geo or cyc above 0"):
        ExpLogFineTuning(start, losses=LossWeights(geo=0, cyc=0), self_supervised=True)
    with pytest.raises(ValueError, match="at least one cloud"):
        CloudDataModule([])
    np.savez(tmp_path / "cloud.npz", points=lumpy(300).float().numpy())
    with pytest.raises(ValueError, match="no ground truth: train with self_supervised=True"):
        fit(ExpLogFineTuning(start), CloudDataModule([tmp_path / "cloud.npz"]), 1)
