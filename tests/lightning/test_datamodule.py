"""Order and packing of training samples."""

from pathlib import Path

import pytest
import torch
from lightning.pytorch.cli import LightningCLI

from lightning_modules import ExpLogDataModule, ExpLogPretraining
from lightning_modules.datamodule import SeededSampler, collate
from riemlayer.data.augment import TrainingSample
from riemlayer.losses import Truth

CONFIGS = sorted(Path(__file__).parents[2].glob("lightning_modules/configs/*.yaml"))


def epoch(sampler: SeededSampler, i: int) -> list[tuple[int, int]]:
    sampler.set_epoch(i)
    return list(sampler)


def test_an_epoch_draws_every_item_once_and_is_a_function_of_seed_and_epoch():
    sampler = SeededSampler(20, seed=3, shuffle=True)
    first, second = epoch(sampler, 0), epoch(sampler, 1)
    for drawn in (first, second):
        assert sorted(i for i, _ in drawn) == list(range(20))
        assert len({seed for _, seed in drawn}) == 20
    assert [i for i, _ in first] != [i for i, _ in second]
    assert not {seed for _, seed in first} & {seed for _, seed in second}
    assert epoch(SeededSampler(20, seed=3, shuffle=True), 1) == second
    assert epoch(SeededSampler(20, seed=4, shuffle=True), 1) != second


def test_validation_is_always_the_same_in_order():
    sampler = SeededSampler(6, seed=3, shuffle=False)
    assert epoch(sampler, 0) == epoch(sampler, 5)
    assert [i for i, _ in sampler] == list(range(6))


def test_a_resumed_epoch_goes_on_and_the_next_is_whole():
    whole, resumed = (SeededSampler(10, seed=3, shuffle=True) for _ in range(2))
    resumed.resume(4, seen=7)
    assert epoch(resumed, 4) == epoch(whole, 4)[7:]
    assert epoch(resumed, 5) == epoch(whole, 5)


@pytest.mark.parametrize("size", [10, 11])
def test_ranks_share_an_epoch_without_duplicates(size):
    whole = SeededSampler(size, seed=3, shuffle=True)
    ranks = [SeededSampler(size, 3, True, rank, world=2) for rank in range(2)]
    drawn = [epoch(rank, 1) for rank in ranks]
    assert [len(x) for x in drawn] == [len(rank) for rank in ranks] == [5, 5]
    assert [item for pair in zip(*drawn, strict=True) for item in pair] == epoch(whole, 1)[:10]
    for rank in ranks:
        rank.resume(1, seen=6)
    assert [epoch(rank, 1) for rank in ranks] == [x[3:] for x in drawn]


def sample(n: int, s: int) -> TrainingSample:
    flags = torch.ones(s, 4, dtype=torch.bool)
    p, v, q = torch.rand(s, 3), torch.rand(s, 4, 3), torch.rand(s, 4, 3)
    return TrainingSample(torch.rand(n, 3), Truth(p, v, q, flags, flags, torch.zeros(s).long()))


def test_collate_packs_clouds_and_says_whose_each_source_is():
    samples = [sample(5, 2), sample(7, 3)]
    batch = collate(samples)
    assert torch.equal(batch.points, torch.cat([s.points for s in samples]))
    assert batch.batch.tolist() == [0] * 5 + [1] * 7
    assert batch.truth.shape.tolist() == [0] * 2 + [1] * 3
    assert torch.equal(batch.truth.q, torch.cat([s.truth.q for s in samples]))
    moved = batch.to(torch.device("cpu"))
    assert torch.equal(moved.truth.v, batch.truth.v)


@pytest.mark.filterwarnings("ignore::Warning:lightning")
@pytest.mark.parametrize("config", CONFIGS, ids=lambda path: path.name)
def test_shipped_configurations_are_understood(config, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cli = LightningCLI(
        ExpLogPretraining, ExpLogDataModule, run=False, args=["--config", str(config)]
    )
    assert isinstance(cli.model, ExpLogPretraining) and cli.trainer.max_steps > 0
