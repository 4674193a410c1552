"""Look-ups of a field's heads, made once and kept: what trains the heads alone, many shapes a step.

    python -m lightning_modules.lookups base --roots DIR --seed 100 -o lookups/0.safetensors

With the backbone fixed, all that a head is told can be looked up beforehand; a batch then mixes
sources of as many shapes as it has rows, and a step takes a tenth of the time
(`ExpLogHeadFitting`).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from itertools import islice, repeat
from pathlib import Path
from typing import Self

import torch
from safetensors.torch import load_file, save
from torch import Tensor, nn

from lightning_modules.datamodule import Batch, ExpLogDataModule
from riemlayer.data.sample_file import whole_or_not_at_all
from riemlayer.field import ExpLogField
from riemlayer.heads.branch import Gate, MapHead

MAPS = ("exp", "log")


@dataclass(frozen=True)
class LookUps:
    """What a head was told of S sources with K queries each, and the truth, in the cube."""

    z: Tensor
    """(S, C)"""
    site: Tensor
    """(S, ...)"""
    x: Tensor
    """(S, 1 + K, 3)"""
    told: Tensor
    """(S, 1 + K, ...) float16"""
    priors: Tensor
    """(S, 1 + K, n, 3) before the gate"""
    truth: Tensor
    """(S, K, 3) q - p for Exp, v for Log"""
    length: Tensor
    """(S, K) of the geodesics"""
    valid: Tensor
    """(S, K) bool"""
    known: Tensor
    """(S, K) bool"""

    def map(self, change: Callable[[Tensor], Tensor]) -> LookUps:
        """The same with `change` applied to every tensor."""
        return LookUps(*(change(getattr(self, f.name)) for f in fields(self)))

    def rows(self, index: Tensor) -> LookUps:
        """Those of some sources."""
        return self.map(lambda x: x[index])

    @classmethod
    def joined(cls, parts: Sequence[LookUps]) -> Self:
        """Those of several, in turn."""
        return cls(*(torch.cat([getattr(x, f.name) for x in parts]) for f in fields(cls)))


class Watched(Gate):
    """A gate, and the priors it was shown."""

    def __init__(self, gate: Gate) -> None:
        nn.Module.__init__(self)
        self.gate, self.priors = gate, torch.empty(0)

    def forward(
        self, priors: list[Tensor], told: list[Tensor], site: Tensor
    ) -> tuple[Tensor, Tensor]:
        self.priors = torch.stack(priors, -2)
        return self.gate(priors, told, site)


@torch.no_grad()
def look_up(field: ExpLogField, batch: Batch) -> dict[str, LookUps]:
    """What both heads of an anchored field are told of a batch.

    Raises:
        ValueError: the heads are not anchored: they are told nothing.
    """
    surface, truth = field.encode_in_cube(batch.points, batch.batch, batch.normals), batch.truth
    found = {}
    for name, x, answer in (
        ("exp", truth.v, truth.q - truth.p[:, None]),
        ("log", truth.q, truth.v),
    ):
        head: MapHead = getattr(field, f"{name}_head")
        if not isinstance(gate := head.gate, Gate):
            raise ValueError("field must have anchored heads, got heads without a gate")
        head.gate = watched = Watched(gate)
        try:
            told = head.prepare(surface.embedding, truth.p, x, truth.shape)
        finally:
            head.gate = gate
        assert told.site is not None  # of an anchored head
        rows = torch.cat(told.told, -1).half()
        facts = (answer, truth.v.norm(dim=-1), truth.valid, truth.known)
        found[name] = LookUps(told.z, told.site, told.x, rows, watched.priors, *facts)
    return found


def write_look_ups(path: Path, found: dict[str, LookUps]) -> None:
    """One safetensors file, whole or not at all: tensors of both heads, `exp/z` and so on."""
    path.parent.mkdir(parents=True, exist_ok=True)
    tensors = {
        f"{name}/{f.name}": getattr(told, f.name).contiguous().clone()  # the heads share some
        for name, told in found.items()
        for f in fields(LookUps)
    }
    with whole_or_not_at_all(path) as file:
        file.write(save(tensors))


def read_look_ups(paths: Sequence[str | Path]) -> dict[str, LookUps]:
    """Those of several files, in turn."""
    files = [load_file(path) for path in paths]
    return {
        name: LookUps.joined(
            [LookUps(*(file[f"{name}/{f.name}"] for f in fields(LookUps))) for file in files]
        )
        for name in MAPS
    }


def collect(field: ExpLogField, data: ExpLogDataModule, samples: int) -> dict[str, LookUps]:
    """Look-ups of that many training batches, epoch after epoch."""
    data.setup("fit")
    parts: dict[str, list[LookUps]] = {name: [] for name in MAPS}
    epochs = (batch for loader in repeat(data.train_dataloader()) for batch in loader)
    for batch in islice(epochs, samples):
        for name, told in look_up(field, batch).items():
            parts[name].append(told)
    return {name: LookUps.joined(told) for name, told in parts.items()}


def main(argv: Sequence[str] | None = None) -> None:
    """Writes the look-ups of training samples."""
    parser = argparse.ArgumentParser(description="Look-ups that train the heads alone.")
    parser.add_argument("weights", help="packaged name or folder")
    parser.add_argument("--roots", nargs="+", required=True, help="folders of samples")
    parser.add_argument("-o", "--out", type=Path, required=True, help="file to write")
    parser.add_argument("--samples", type=int, default=330)
    parser.add_argument("--sources", type=int, default=32, help="a sample")
    parser.add_argument("--vectors", type=int, default=96, help="a source")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(argv)
    data = ExpLogDataModule(
        given.roots, sources=given.sources, vectors=given.vectors, seed=given.seed
    )
    field = ExpLogField.from_pretrained(given.weights).eval()
    write_look_ups(given.out, collect(field, data, given.samples))


if __name__ == "__main__":
    main()
