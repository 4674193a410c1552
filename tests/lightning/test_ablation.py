"""Ablations: all variants under one budget, and one that is cut off goes on."""

import json
import math
from dataclasses import replace
from functools import partial

import lightning as L
import pytest
import torch
from safetensors.torch import load_file

from lightning_modules import ExpLogDataModule, ExpLogPretraining, ablation
from lightning_modules.ablation import SHIPPED, VARIANTS, Budget, Variant, ablate
from riemlayer import ExpLogField, FieldConfig
from riemlayer.data.augment import Augmentation
from riemlayer.losses import LossWeights
from riemlayer.storage import WEIGHTS

pytestmark = pytest.mark.filterwarnings("ignore::Warning:lightning")  # it talks of its own matters

TINY = FieldConfig.tiny()
PLAIN = replace(TINY, head=replace(TINY.head, anchored=False, narrow=0, walks=0))
SMALL = {
    "one": Variant(TINY, SHIPPED, "ours"),
    "twin": Variant(TINY, SHIPPED, "Tab. 5"),
    "plain": Variant(PLAIN, LossWeights(geo=0, cyc=0), "Tab. 3", tau=math.inf),
}


@pytest.fixture(scope="module")
def data(folder):
    """What `ablate` asks for samples."""
    return partial(
        ExpLogDataModule,
        [str(folder)],
        sources=3,
        vectors=16,
        augmentation=Augmentation(points=(600, 800)),
        validation=0.2,
    )


def ablate_small(names, data, folder, steps=4, variants=SMALL, **how):
    return ablate(names, Budget(steps), data, folder, variants=variants, keep_every=1, **how)


# ------------------------------------------------------------------------------------ training


@pytest.fixture(scope="module")
def finished(data, tmp_path_factory):
    """All small variants under a budget of four steps: the folder, and the record."""
    where = tmp_path_factory.mktemp("ablation")
    return where, ablate_small(["one", "twin", "plain"], data, where)


def test_the_record_says_what_every_variant_took(finished):
    where, record = finished

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is not JSON")

    text = (where / "ablation.json").read_text()
    assert json.loads(text, parse_constant=refuse) == record
    assert record["settings"]["budget"] == {"steps": 4, "minutes": None}
    assert (record["settings"]["data"]["training"], record["settings"]["data"]["validation"]) == (
        5,
        1,
    )
    assert list(record["variants"]) == ["one", "twin", "plain"]
    for name, facts in record["variants"].items():
        field = ExpLogField.from_pretrained(where / name)
        assert field.config == SMALL[name].config
        assert facts["parameters"] == sum(x.numel() for x in field.parameters())
        assert facts["steps"] == 4 and facts["seed"] == 0 and facts["table"] == SMALL[name].table
        assert facts["seconds"] > 0 and facts["versions"]["torch"] == torch.__version__
        assert set(facts["validation"]) == {"exp", "log", "exp_near", "log_near"}
        assert all(math.isfinite(facts["validation"][x]) for x in ("exp", "log"))
        assert facts["validation"]["log_near"] is None  # these samples have no short vectors
        assert not (where / name / "last.ckpt").exists()
    assert record["variants"]["plain"]["recipe"]["tau"] is None


def test_saved_weights_are_the_validated_average(finished, data):
    where, record = finished
    model = ExpLogPretraining(config=TINY)
    model.field.load_state_dict(load_file(where / "one" / WEIGHTS))
    trainer = L.Trainer(accelerator="cpu", logger=False, enable_progress_bar=False)
    (errors,) = trainer.validate(model, datamodule=data(), verbose=False)
    told = record["variants"]["one"]["validation"]
    for name in ("exp", "log"):
        assert errors[f"val/{name}"] == pytest.approx(told[name], rel=1e-3)


def test_equal_variants_are_trained_once(finished):
    where, record = finished
    one, twin = (record["variants"][name] for name in ("one", "twin"))
    assert twin == one | {"same_as": "one", "table": "Tab. 5"} and "same_as" not in one
    assert (where / "twin" / WEIGHTS).read_bytes() == (where / "one" / WEIGHTS).read_bytes()


class KilledError(Exception):
    pass


@pytest.mark.parametrize(
    "alive",
    [
        pytest.param(2, id="first", marks=pytest.mark.slow),
        pytest.param(4, id="between", marks=pytest.mark.slow),
        pytest.param(7, id="second"),
    ],
)
def test_a_cut_off_ablation_goes_on_and_skips_what_is_finished(
    finished, data, tmp_path, monkeypatch, alive
):
    """Cut off before step `alive` + 1 of the 8 it has; together the two calls take 8 steps."""
    where, record = finished
    taken, step = [], ExpLogPretraining.training_step

    def counted(self, batch, i):
        if len(taken) == alive and not (tmp_path / "restarted").exists():
            raise KilledError
        taken.append(self.global_step)
        return step(self, batch, i)

    monkeypatch.setattr(ExpLogPretraining, "training_step", counted)
    with pytest.raises(KilledError):
        ablate_small(["one", "plain"], data, tmp_path)
    done = json.loads((tmp_path / "ablation.json").read_text())["variants"]
    assert list(done) == (["one"] if alive >= 4 else [])
    (tmp_path / "restarted").touch()
    again = ablate_small(["one", "plain"], data, tmp_path)
    assert taken == [0, 1, 2, 3, 0, 1, 2, 3]
    for name in ("one", "plain"):
        expected, got = (load_file(x / name / WEIGHTS) for x in (where, tmp_path))
        assert expected.keys() == got.keys()
        assert all(torch.equal(expected[k], got[k]) for k in got), name
        facts, undisturbed = again["variants"][name], record["variants"][name]
        assert facts["validation"] == undisturbed["validation"] and facts["steps"] == 4
    ablate_small(["one", "plain"], data, tmp_path)
    assert len(taken) == 8


def test_variants_see_the_same_samples_in_the_same_order(data, tmp_path, monkeypatch):
    seen, step = [], ExpLogPretraining.training_step

    def watched(self, batch, i):
        seen.append((float(batch.points.sum()), float(batch.truth.v.sum())))
        return step(self, batch, i)

    monkeypatch.setattr(ExpLogPretraining, "training_step", watched)
    ablate_small(["one", "plain"], data, tmp_path, steps=3)
    assert len(set(seen)) == 3 and seen[:3] == seen[3:]


def test_a_budget_of_minutes_ends_with_a_falling_rate(data, tmp_path, monkeypatch):
    """And a run that was cut off when its time was up takes no further step."""
    rates, step = [], ExpLogPretraining.training_step

    def watched(self, batch, i):
        rates.append(self.optimizers().param_groups[0]["lr"])
        return step(self, batch, i)

    def killed(self, batch, i):
        raise KilledError

    def run():
        budget = Budget(minutes=3 / 60)
        return ablate(["one"], budget, data, tmp_path, variants=SMALL, keep_every=1)

    monkeypatch.setattr(ExpLogPretraining, "training_step", watched)
    with monkeypatch.context() as patch, pytest.raises(KilledError):
        patch.setattr(ExpLogPretraining, "validation_step", killed)
        run()
    steps = len(rates)
    facts = run()["variants"]["one"]
    assert facts["steps"] == steps == len(rates) and 3 <= facts["seconds"] < 9
    assert rates[-1] < rates[steps // 2]


# ------------------------------------------------------------------------------------ refusals


def test_results_of_other_settings_are_not_mixed(finished, data):
    where, _ = finished
    with pytest.raises(ValueError, match=r"other settings: budget .*4.* now .*5.*another folder"):
        ablate_small(["one"], data, where, steps=5)
    with pytest.raises(ValueError, match="seed 0, now 1"):
        ablate_small(["one"], data, where, seed=1)
    with pytest.raises(ValueError, match=r"'sources': 3.* now .*'sources': 2"):
        ablate_small(["one"], partial(data, sources=2), where)
    other = SMALL | {"one": SMALL["plain"]}
    with pytest.raises(ValueError, match="another recipe"):
        ablate_small(["one"], data, where, variants=other)


def test_unknown_variants_are_named(data, tmp_path):
    with pytest.raises(ValueError, match=r"among .*'one'.* got \['two'\]"):
        ablate_small(["one", "two"], data, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("budget", [(None, None), (5, 1.0), (0, None), (None, -1.0)])
def test_a_budget_is_steps_or_minutes(budget):
    with pytest.raises(ValueError, match="either steps or minutes, and positive"):
        Budget(*budget)


# ------------------------------------------------------------------------------------ by command


def test_one_command(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(VARIANTS, "small", SMALL["plain"])
    where = tmp_path / "out"
    options = ["--roots", str(folder), "-o", str(where), "--variants", "small", "--seed", "3"]
    ablation.main([*options, "--steps", "1"])
    record = json.loads((where / "ablation.json").read_text())
    assert record["variants"]["small"]["steps"] == 1 and record["settings"]["seed"] == 3
    assert record["settings"]["data"]["vectors"] == 768
    with pytest.raises(SystemExit):
        ablation.main(options)
