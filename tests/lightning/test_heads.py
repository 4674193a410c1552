"""Heads trained on look-ups: the losses are those of the whole field, and only heads move."""

import lightning as L
import pytest
import torch
from references import shaken

from lightning_modules import ExpLogDataModule, ExpLogHeadFitting, LookUpModule
from lightning_modules.heads import head_losses
from lightning_modules.lookups import look_up, main, read_look_ups, write_look_ups
from riemlayer.field import ExpLogField
from riemlayer.losses import LossWeights, explog_losses

pytestmark = pytest.mark.filterwarnings("ignore::Warning:lightning")  # it talks of its own matters

WEIGHTS = LossWeights(geo=0, cyc=0, pairs=0.3, prior=0.2, relative=True)


@pytest.fixture
def field() -> ExpLogField:
    return shaken("tiny", torch.float32, strength=0.3)


@pytest.fixture
def batch(folder):
    data = ExpLogDataModule([str(folder)], sources=5, vectors=16)
    data.setup("fit")
    return next(iter(data.train_dataloader()))


def test_losses_on_look_ups_are_those_of_the_field(field, batch, full_precision):
    """Look-ups keep what is told in half precision."""
    surface = field.encode_in_cube(batch.points, batch.batch)
    whole = explog_losses(surface, batch.truth, WEIGHTS)
    found = look_up(field, batch)
    own = {}
    for name in ("exp", "log"):
        own |= head_losses(getattr(field, f"{name}_head"), found[name], name, WEIGHTS)
    for term in ("exp", "log"):
        torch.testing.assert_close(own[f"{term}/rec"], whole[term], rtol=2e-3, atol=0)
    for term in ("prior", "validity"):
        both = own[f"exp/{term}"] + own[f"log/{term}"]
        torch.testing.assert_close(both, whole[term], rtol=2e-3, atol=0)
    torch.testing.assert_close(own["log/pairs"], whole["pairs"], rtol=5e-3, atol=0)
    total = own["exp/total"] + own["log/total"]
    torch.testing.assert_close(total, whole["total"], rtol=2e-3, atol=0)


def test_files_hold_what_was_looked_up(field, batch, tmp_path):
    found = look_up(field, batch)
    for name in ("a", "b"):
        write_look_ups(tmp_path / f"{name}.safetensors", found)
    twice = read_look_ups([tmp_path / "a.safetensors", tmp_path / "b.safetensors"])
    for name, told in found.items():
        half = twice[name].rows(torch.arange(5, 10))
        for key, x in vars(told).items():
            assert torch.equal(getattr(half, key), x)


@pytest.mark.parametrize(("part", "rate", "share"), [("_head", 2e-3, 0.9), (".gate.", 2e-2, 1)])
def test_only_heads_or_gates_move_and_the_loss_falls(field, folder, tmp_path, part, rate, share):
    field.save_pretrained(tmp_path / "start")
    words = [str(tmp_path / "start"), "--roots", str(folder), "-o", str(tmp_path / "x.safetensors")]
    main([*words, "--samples", "7", "--sources", "4", "--vectors", "16"])
    gates = part == ".gate."
    model = ExpLogHeadFitting(str(tmp_path / "start"), WEIGHTS, rate, warmup=1, gates_only=gates)
    before = {k: x.clone() for k, x in model.field.state_dict().items()}
    told = read_look_ups([tmp_path / "x.safetensors"])
    assert len(told["exp"].z) == 7 * 4
    start = float(model_loss(model, told))
    trainer = L.Trainer(
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        max_steps=25,
    )
    trainer.fit(model, LookUpModule([tmp_path / "x.safetensors"], sources=10))
    assert float(model_loss(model, told)) < share * start
    for name, x in model.field.state_dict().items():
        before_heads = ("backbone", "tangent_plane", "joint")
        looked_up = any(word in name for word in before_heads)
        assert torch.equal(x, before[name]) == (looked_up or part not in name), name


@torch.no_grad()
def model_loss(model, told) -> torch.Tensor:
    heads = ((model.field.exp_head, "exp"), (model.field.log_head, "log"))
    return sum(head_losses(head, told[x], x, WEIGHTS)[f"{x}/total"] for head, x in heads)  # pyright: ignore


def test_heads_that_are_told_nothing_are_refused(batch):
    paper = ExpLogField.from_preset("tiny")
    paper.exp_head.gate = None
    with pytest.raises(ValueError, match="anchored heads"):
        look_up(paper, batch)
