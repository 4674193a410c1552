"""A run that was killed and started again trains exactly as the undisturbed one."""

import json
import math
import multiprocessing
import os
import signal

import lightning as L
import pytest
import torch
from http_folder import served
from lightning.pytorch.callbacks import ModelCheckpoint, Timer
from safetensors.torch import load_file

from lightning_modules import ExpLogDataModule, ExpLogPretraining, ExponentialAverage
from lightning_modules.export import export
from riemlayer import ExpLogField
from riemlayer.data.augment import Augmentation
from riemlayer.data.shards import pack
from riemlayer.losses import LossWeights

pytestmark = pytest.mark.filterwarnings("ignore::Warning:lightning")  # it talks of its own matters

STEPS = 9


class Watch(L.Callback):
    """Writes down every loss and what each validation saw; kills the run before a step counts."""

    def __init__(self, kill_at: int | None = None) -> None:
        self.kill_at, self.losses, self.validated = kill_at, {}, {}

    def on_train_batch_end(self, trainer, pl_module, outputs, batch, batch_idx) -> None:
        if trainer.global_step == self.kill_at:
            raise KilledError
        self.losses[trainer.global_step] = float(outputs["loss"].detach())

    def on_validation_end(self, trainer, pl_module) -> None:
        self.validated[trainer.global_step] = float(trainer.callback_metrics["val/exp"])


class KilledError(Exception):
    pass


class KillWorker(Watch):
    """Ends one process that loads data, as the system does when memory runs out."""

    def on_train_batch_start(self, trainer, pl_module, batch, batch_idx) -> None:
        if trainer.global_step + 1 == self.kill_at:
            worker = multiprocessing.active_children()[0]
            os.kill(worker.pid, signal.SIGKILL)
            worker.join()

    def on_train_batch_end(self, trainer, pl_module, outputs, batch, batch_idx) -> None:
        self.losses[trainer.global_step] = float(outputs["loss"].detach())


def run(
    folder,
    where,
    kill_at: int | None = None,
    resume: bool = False,
    workers: int = 0,
    watching: type[Watch] = Watch,
) -> Watch:
    """Train a tiny field; the checkpoint of the last step stays in `where`."""
    torch.manual_seed(1)
    watch = watching(kill_at)
    keep = ModelCheckpoint(where, "last", every_n_train_steps=1, enable_version_counter=False)
    trainer = L.Trainer(
        accelerator="cpu",
        max_steps=STEPS,
        val_check_interval=2,
        check_val_every_n_epoch=None,
        num_sanity_val_steps=0,
        gradient_clip_val=1.0,
        callbacks=[ExponentialAverage(0.9, str(where / "average")), Timer(), watch, keep],
        logger=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    weights = LossWeights(geo=0, cyc=0, pairs=0.05, relative=True)
    data = ExpLogDataModule(
        [str(folder)],
        sources=3,
        vectors=16,
        augmentation=Augmentation(points=(600, 800)),
        validation=0.2,
        workers=workers,
    )
    model = ExpLogPretraining("tiny", weights, warmup=3)
    trainer.fit(model, data, ckpt_path=where / "last.ckpt" if resume else None)
    return watch


@pytest.fixture(scope="module")
def undisturbed(folder, tmp_path_factory) -> Watch:
    where = tmp_path_factory.mktemp("undisturbed")
    watch = run(folder, where)
    watch.checkpoint = where / "last.ckpt"
    watch.average = ExpLogField.from_pretrained(where / "average").state_dict()
    return watch


def test_every_step_is_taken_and_its_loss_is_finite(undisturbed):
    assert sorted(undisturbed.losses) == list(range(1, STEPS + 1))
    assert all(math.isfinite(x) for x in undisturbed.losses.values())
    assert len(set(undisturbed.losses.values())) == STEPS
    assert sorted(undisturbed.validated) == [2, 4, 6, 8]


@pytest.mark.parametrize(
    "kill_at",
    [3, 6, pytest.param(5, marks=pytest.mark.slow), pytest.param(7, marks=pytest.mark.slow)],
)
def test_a_killed_run_goes_on_to_the_same_losses(folder, undisturbed, tmp_path, kill_at):
    """Epochs have 5 steps: kills within an epoch, at its end and after it."""
    with pytest.raises(KilledError):
        run(folder, tmp_path, kill_at)
    resumed = run(folder, tmp_path, resume=True)
    assert sorted(resumed.losses) == list(range(kill_at, STEPS + 1))
    for step, loss in resumed.losses.items():
        assert loss == undisturbed.losses[step], f"step {step}"
    for step, error in resumed.validated.items():
        assert error == undisturbed.validated[step], f"validation at step {step}"
    average = ExpLogField.from_pretrained(tmp_path / "average").state_dict()
    for name, x in average.items():
        assert torch.equal(x, undisturbed.average[name]), name


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forked while threads run
def test_with_workers_too_that_have_fetched_ahead(folder, undisturbed, tmp_path):
    with pytest.raises(KilledError):
        run(folder, tmp_path, kill_at=4, workers=2)
    resumed = run(folder, tmp_path, resume=True, workers=2)
    assert sorted(resumed.losses) == list(range(4, STEPS + 1))
    for step, loss in resumed.losses.items():
        assert loss == undisturbed.losses[step], f"step {step}"


@pytest.mark.slow
def test_streamed_shards_give_the_losses_of_the_files_killed_or_not(folder, undisturbed, tmp_path):
    pack(folder, tmp_path / "shards", 2)
    with served(tmp_path / "shards") as url:
        with pytest.raises(KilledError):
            run(url, tmp_path / "run", kill_at=4)
        resumed = run(url, tmp_path / "run", resume=True)
    assert sorted(resumed.losses) == list(range(4, STEPS + 1))
    assert all(loss == undisturbed.losses[step] for step, loss in resumed.losses.items())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forked while threads run
def test_a_killed_data_worker_is_told_of_and_the_run_goes_on(folder, undisturbed, tmp_path):
    pack(folder, tmp_path / "shards", 2)
    with pytest.raises(RuntimeError, match="DataLoader worker"):
        run(tmp_path / "shards", tmp_path / "run", 3, workers=1, watching=KillWorker)
    resumed = run(tmp_path / "shards", tmp_path / "run", resume=True, workers=1)
    assert sorted(resumed.losses)[-1] == STEPS
    assert all(loss == undisturbed.losses[step] for step, loss in resumed.losses.items())


def test_exported_weights_are_the_average_and_the_card_counts(folder, undisturbed, tmp_path):
    card = export(undisturbed.checkpoint, tmp_path / "w.safetensors", {"limits": "x"}, [folder])
    facts = json.loads(card.read_text())
    training = facts["training"]
    assert (training["steps"], training["shapes_a_step"]) == (STEPS, 1)
    assert training["shapes"] == {"spheres": 6} and facts["limits"] == "x"
    assert 0 <= training["hours"] < 1
    saved = load_file(tmp_path / "w.safetensors")
    state = torch.load(undisturbed.checkpoint, weights_only=False)
    (average,) = (x["average"] for x in state["callbacks"].values() if "average" in x)
    assert saved.keys() == average.keys()
    assert all(torch.equal(saved[k], x.half()) for k, x in average.items())


def test_a_checkpoint_of_something_else_is_refused(tmp_path):
    torch.save({"hyper_parameters": {}}, tmp_path / "other.ckpt")
    with pytest.raises(ValueError, match="not written by ExpLogPretraining"):
        export(tmp_path / "other.ckpt", tmp_path / "w.safetensors", {})
