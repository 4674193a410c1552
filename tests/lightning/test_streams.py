"""Streamed shards train as the files they were packed of; no bad sample is read."""

import json
import multiprocessing
import os
import shutil
import warnings
from collections import Counter
from types import SimpleNamespace

import fsspec
import pytest
import torch
from http_folder import NoRanges, served

from lightning_modules import ExpLogDataModule
from riemlayer.data.dataset import read_sample, sample_files
from riemlayer.data.shards import pack
from riemlayer.data.stream import ShardedSamples

pytestmark = [
    pytest.mark.filterwarnings("ignore::Warning:lightning"),  # it talks of its own matters
    pytest.mark.filterwarnings("ignore:This process:DeprecationWarning"),  # forked with threads
]


@pytest.fixture
def shards(folder, tmp_path):
    """The six spheres, two a shard."""
    pack(folder, tmp_path / "shards", 2)
    return tmp_path / "shards"


def module(root, workers=0, rank=0, world=1, **settings):
    """A data module as a trainer sets it up."""
    data = ExpLogDataModule([str(root)], 1, 3, 16, validation=0.2, workers=workers, **settings)
    if world > 1:
        data.trainer = SimpleNamespace(global_rank=rank, world_size=world)  # pyright: ignore
    data.setup("fit")
    return data


def epoch(data, i):
    data.sampler.set_epoch(i)
    return list(data.train_dataloader())


def same(one, other):
    pairs = zip(one, other, strict=True)
    return all(
        torch.equal(x.points, y.points) and torch.equal(x.truth.q, y.truth.q) for x, y in pairs
    )


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("where", ["folder", "file", "memory", "http"])
def test_a_stream_gives_the_very_batches_of_the_files(folder, shards, where, workers):
    expected = module(folder)
    roots = {"folder": str(shards), "file": f"file://{shards}", "memory": "memory://shards"}
    if where == "memory":
        fsspec.filesystem("memory").put(str(shards), "/shards", recursive=True)
    with served(shards) as url:
        streamed = module(roots.get(where, url), workers)
        for i in (0, 1):
            assert same(epoch(streamed, i), epoch(expected, i))
        assert same(streamed.val_dataloader(), expected.val_dataloader())


def test_several_roots_are_one_data_set(folder, shards, tmp_path):
    shutil.copytree(shards, tmp_path / "more")
    samples = ShardedSamples([shards, tmp_path / "more"])
    assert len(samples) == 12 and len(samples.shards) == 6
    every = range(12)
    for i in every:
        known = read_sample(sample_files(folder)[i % 6])
        assert torch.equal(samples.read(every, i)["q"], known["q"])


def draw(root, rank, seen, queue):
    """One rank's part of an epoch: how many batches, and which samples by their largest points."""
    warnings.simplefilter("default")
    data = module(root, workers=2, rank=rank, world=2)
    data.sampler.resume(1, seen)
    queue.put((rank, [float(batch.truth.q.double().sum()) for batch in epoch(data, 1)]))


def drawn_by_two_ranks(root, seen=0):
    """What two processes with two workers each draw."""
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    ranks = [context.Process(target=draw, args=(root, rank, seen, queue)) for rank in range(2)]
    for process in ranks:
        process.start()
    parts = dict(queue.get(timeout=120) for _ in ranks)
    for process in ranks:
        process.join()
    return parts


@pytest.mark.slow
def test_two_ranks_with_two_workers_lose_and_repeat_nothing(shards):
    """Five training shapes: four in an epoch of two ranks, of which the order of one rank tells."""
    alone = [float(batch.truth.q.double().sum()) for batch in epoch(module(shards), 1)]
    assert len(set(alone)) == 5
    parts = drawn_by_two_ranks(shards)
    assert [parts[0][0], parts[1][0], parts[0][1], parts[1][1]] == alone[:4]
    rest = drawn_by_two_ranks(shards, seen=2)
    assert rest == {0: parts[0][1:], 1: parts[1][1:]}


# Faults


def spoil(shards, how):
    """Makes the second of three shards unreadable, one sample of it or both; its name."""
    shard = shards / "shard-000001.tar"
    if how == "flipped":
        line = json.loads(shard.with_suffix(".jsonl").read_text().splitlines()[0])
        data = bytearray(shard.read_bytes())
        data[line["offset"] + line["bytes"] // 2] ^= 1
        shard.write_bytes(data)
    elif how == "truncated":
        os.truncate(shard, 1000)
    else:
        shard.unlink()
    return shard.name


@pytest.mark.parametrize(("how", "bad"), [("flipped", 1), ("truncated", 2), ("missing", 2)])
def test_bad_samples_are_skipped_named_and_counted(folder, shards, how, bad):
    name = spoil(shards, how)
    samples = ShardedSamples([shards], corrupt=0.4)
    truth = [read_sample(file)["q"] for file in sample_files(folder)]
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for _ in range(2):
            read = [samples.read(range(6), i)["q"] for i in range(6)]
    found = samples.unreadable.nonzero().flatten().tolist()
    assert found == [2, 3][:bad]
    assert len(said) == bad  # once each, not at every attempt
    assert all(name in str(x.message) and "cannot be read" in str(x.message) for x in said)
    substitute = {i: found[-1] + 1 for i in found}
    assert all(torch.equal(q, truth[substitute.get(i, i)]) for i, q in enumerate(read))


@pytest.mark.slow
def test_all_workers_count_bad_samples_together_and_ranks_stay_even(shards):
    spoil(shards, "truncated")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = module(shards, workers=2, corrupt=0.4)
        assert len(epoch(data, 0)) == 5
    assert data.train.samples.unreadable.sum() == 2
    data = module(shards, workers=2)
    with pytest.raises(ValueError, match="more than corrupt allows"):
        epoch(data, 0)


def test_a_server_without_ranges_is_told_of(shards):
    with served(shards, NoRanges) as url, pytest.raises(ValueError, match="ignores ranges"):
        ShardedSamples([url]).read(range(6), 0)


def test_a_missing_or_foreign_manifest_is_named(shards):
    (shards / "manifest.jsonl").write_text('{"shard": 3}\n')
    with pytest.raises(ValueError, match=r"manifest\.jsonl must be the manifest of shards"):
        module(shards)
    (shards / "manifest.jsonl").unlink()
    with pytest.raises(FileNotFoundError, match="riemlayer prepare --shards"):
        module(shards)


def test_training_and_held_out_samples_are_apart(shards):
    data = module(shards)
    names = data.train.samples.table["name"]
    train, held = ({str(names[i]) for i in x.chosen} for x in (data.train, data.held))
    assert held and not train & held
    assert Counter([*train, *held]) == Counter(f"sphere{i}" for i in range(6))
