"""litdata and WebDataset on the same samples: writing, reading, going on in the middle, size.

python -m benchmarks.streams SAMPLES -o benchmarks/results

SAMPLES is a folder by `riemlayer prepare`. litdata is no dependency of riemlayer, since installing
it installs torchvision: without dependencies beside ours, in an environment for this comparison,
`pip install --no-deps litdata boto3 botocore s3transfer jmespath python-dateutil six tifffile
obstore`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from torch.utils.data import DataLoader, Dataset

from riemlayer.data.shards import pack
from riemlayer.data.stream import ShardedSamples

SIZE, ROUNDS, WORKERS = 16, 2, (0, 2)
"""Samples a shard; passes over the data, of which the fastest counts; processes that load."""


def first(samples: list) -> Any:
    """Batches of one sample, as it is."""
    return samples[0]


def digest(data: bytes) -> str:
    """What stands for a sample here: reading it all is part of the measurement."""
    return hashlib.sha256(data).hexdigest()


class ByPlace(Dataset):
    """What riemlayer does: WebDataset's files read by the places that the manifest holds."""

    def __init__(self, shards: Path) -> None:
        self.samples = ShardedSamples([shards])

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, item: tuple[int, int]) -> str:
        """The checksum, which reading has compared with the data."""
        i, _ = item
        self.samples.fetch(i)
        return self.samples.table["sha256"][i].decode()


class Counted(DataLoader):
    """A loader over a `SeededSampler` with the state that `ExpLogDataModule` keeps of it."""

    seen = 0

    def __iter__(self) -> Any:
        for batch in super().__iter__():
            self.seen += 1
            yield batch

    def state_dict(self) -> dict[str, int]:
        return {"seen": self.seen}

    def load_state_dict(self, state: dict[str, int]) -> None:
        self.sampler.resume(0, state["seen"])  # pyright: ignore


def write_litdata(files: Sequence[Path], out: Path) -> None:
    """litdata's own chunks of SIZE samples."""
    from litdata.streaming.cache import Cache

    cache = Cache(str(out), chunk_size=SIZE)
    for i, file in enumerate(files):
        cache[i] = file.read_bytes()
    cache.done()
    cache.merge()


def write_shards(files: Sequence[Path], out: Path) -> None:
    """WebDataset's files, by riemlayer."""
    pack(files[0].parent, out, SIZE)


def read_litdata(out: Path, workers: int) -> Iterable[str]:
    """litdata's streaming data set, shuffled."""
    import litdata

    data = litdata.StreamingDataset(str(out), shuffle=True, seed=0)
    return litdata.StreamingDataLoader(
        data, batch_size=1, num_workers=workers, collate_fn=digest_first
    )


def digest_first(samples: list[bytes]) -> str:
    """The digest of a batch of one."""
    return digest(samples[0])


def read_webdataset(out: Path, workers: int) -> Iterable[str]:
    """WebDataset's own pipeline, shuffled."""
    import webdataset

    urls = [str(x) for x in sorted(out.glob("*.tar"))]
    data = webdataset.WebDataset(urls, shardshuffle=len(urls), seed=0).shuffle(SIZE)
    data = data.map(digest_sample)
    return DataLoader(data, 1, num_workers=workers, collate_fn=first)


def digest_sample(sample: dict[str, Any]) -> str:
    """The digest of WebDataset's sample."""
    return digest(sample["safetensors"])


def read_by_place(out: Path, workers: int) -> Iterable[str]:
    """riemlayer's reader, shuffled."""
    from lightning_modules.datamodule import SeededSampler

    data = ByPlace(out)
    sampler = SeededSampler(len(data), seed=0, shuffle=True)
    return Counted(data, 1, sampler=sampler, num_workers=workers, collate_fn=first)


ENGINES: dict[str, tuple[Callable, Callable]] = {
    "litdata": (write_litdata, read_litdata),
    "WebDataset, its own pipeline": (write_shards, read_webdataset),
    "WebDataset's files, read by place": (write_shards, read_by_place),
}


def goes_on(read: Callable[[], Any], done: int) -> bool | str:
    """Whether a reader stopped after `done` samples draws just the others when it goes on."""
    loader = read()
    if not hasattr(loader, "state_dict"):
        return "has no state"
    whole, stream = list(read()), iter(loader)
    begun = [next(stream) for _ in range(done)]
    state, later = loader.state_dict(), read()
    later.load_state_dict(state)
    return [*begun, *later] == whole


def measure(name: str, files: Sequence[Path], scratch: Path) -> dict[str, Any]:
    """One engine's numbers."""
    write, read = ENGINES[name]
    out, megabytes = scratch / name, sum(f.stat().st_size for f in files) / 1e6
    start = time.perf_counter()
    write(files, out)
    row: dict[str, Any] = {"write MB/s": megabytes / (time.perf_counter() - start)}
    expected = sorted(digest(f.read_bytes()) for f in files)
    for workers in WORKERS:
        seconds = []
        for _ in range(ROUNDS):
            start = time.perf_counter()
            got = sorted(read(out, workers))
            seconds.append(time.perf_counter() - start)
        row[f"read MB/s, {workers} workers"] = megabytes / min(seconds)
        row[f"each sample once, {workers} workers"] = got == expected
        row[f"goes on in an epoch, {workers} workers"] = goes_on(
            partial(read, out, workers), len(files) // 3
        )
    stored = sum(f.stat().st_size for f in out.rglob("*") if f.is_file())
    return row | {"MB stored": stored / 1e6}


def table(report: dict[str, Any]) -> str:
    """The report as Markdown."""
    rows = report["engines"]
    columns = [*next(iter(rows.values()))]
    lines = [
        f"{report['samples']} samples, {report['MB']:.0f} MB; {report['machine']}; "
        + ", ".join(f"{name} {number}" for name, number in report["versions"].items())
        + ". Reading includes a checksum of every sample; files lie in the page cache.",
        "",
        "| | " + " | ".join(columns) + " |",
        "|---" * (len(columns) + 1) + "|",
    ]
    for name, row in rows.items():
        shown = (f"{x:.0f}" if type(x) is float else _word(x) for x in row.values())
        lines.append(f"| {name} | " + " | ".join(shown) + " |")
    return "\n".join(lines) + "\n"


def _word(value: bool | str) -> str:
    return {True: "yes", False: "no"}.get(value, value) if isinstance(value, bool) else value


def main(argv: Sequence[str] | None = None) -> None:
    """The command line of this module."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("samples", type=Path, help="folder by `riemlayer prepare`; only read")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for streams.*")
    parser.add_argument("--limit", type=int, default=200, help="most samples")
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        (scratch / "samples").mkdir()
        for file in sorted(args.samples.glob("[!.]*.safetensors"))[: args.limit]:
            shutil.copy(file, scratch / "samples")
        files = sorted((scratch / "samples").iterdir())
        report = {
            "samples": len(files),
            "MB": sum(f.stat().st_size for f in files) / 1e6,
            "machine": f"{os.cpu_count()} cores, Python {platform.python_version()}",
            "versions": {name: version(name) for name in ("litdata", "webdataset", "torch")},
            "engines": {name: measure(name, files, scratch) for name in ENGINES},
        }
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "streams.json").write_text(json.dumps(report, indent=1) + "\n")
    (args.out / "streams.md").write_text(table(report))
    print(table(report))


if __name__ == "__main__":
    main()
