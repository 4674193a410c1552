"""The ablations of Tab. 3 and Tab. 5, and ours: one budget for every variant, one command.

python -m lightning_modules.ablation --steps 4000 --roots data_cache/procedural -o runs/ablation
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import shutil
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import ModelCheckpoint, Timer

import riemlayer
from lightning_modules.callbacks import ExponentialAverage
from lightning_modules.datamodule import ExpLogDataModule
from lightning_modules.guard import DivergenceGuard
from lightning_modules.pretrain import ExpLogPretraining
from riemlayer.config import FieldConfig
from riemlayer.losses import LossWeights

RECORD, CHECKPOINT = "ablation.json", "last.ckpt"
SHIPPED = LossWeights(geo=0, cyc=0, pairs=0.05, relative=True)
"""The losses of `lightning_modules/configs/base.yaml`."""


@dataclass(frozen=True)
class Variant:
    """One row of an ablation; equal variants are trained once."""

    config: FieldConfig
    losses: LossWeights
    table: str = field(compare=False)
    """Where the row belongs: `Tab. 3`, `Tab. 5` or `ours`."""
    tau: float = 0.5
    """Threshold of the filter, Eq. (8); infinity: no filter."""

    def recipe(self) -> dict[str, Any]:
        """As plain values, for JSON; no filter is `tau` null."""
        tau = self.tau if math.isfinite(self.tau) else None
        return {"config": self.config.to_dict(), "losses": asdict(self.losses), "tau": tau}


def _variants() -> dict[str, Variant]:
    base = FieldConfig.base()

    def head(**changes: Any) -> FieldConfig:
        return replace(base, head=replace(base.head, **changes))

    def backbone(**changes: Any) -> FieldConfig:
        return replace(base, backbone=replace(base.backbone, **changes))

    paper, only_reconstruction = LossWeights(), LossWeights(geo=0, cyc=0)
    widths = {"encoder": (64, 64, 128, 1024), "decoder": (512, 256, 128, 128)}
    pointnet = backbone(kind="pointnet", stem=0, **widths)  # about as wide as in Qi et al. 2017
    siren = head(decoder="siren")  # as wide and deep as the perceptron it replaces
    plain = head(anchored=False, narrow=0, walks=0)
    return {
        "full": Variant(base, paper, "Tab. 3"),
        "no_filtering": Variant(base, paper, "Tab. 3", tau=math.inf),
        "simple_loss": Variant(base, only_reconstruction, "Tab. 3"),
        "octree_triplane": Variant(base, SHIPPED, "Tab. 5"),
        "pointnet_triplane": Variant(pointnet, SHIPPED, "Tab. 5"),
        "octree_siren": Variant(siren, SHIPPED, "Tab. 5"),
        "base": Variant(base, SHIPPED, "ours"),
        "without_anchor": Variant(plain, SHIPPED, "ours"),
        "without_refinement": Variant(head(narrow=0), SHIPPED, "ours"),
        "without_pairs": Variant(base, replace(SHIPPED, pairs=0), "ours"),
        "without_stem": Variant(backbone(stem=0), SHIPPED, "ours"),
        "without_fan": Variant(head(fan_rays=0), SHIPPED, "ours"),
        "one_walk": Variant(head(walks=1), SHIPPED, "ours"),
        "straight_prior": Variant(head(walks=0), SHIPPED, "ours"),
        "paper": Variant(FieldConfig.paper(), paper, "ours"),
    }


VARIANTS = _variants()
"""Tab. 3: the shipped field with the paper's losses, without the filter, with Eq. (2) alone (and
our validity, which does not touch the maps; without the filter it learns to say yes). Tab. 5: the
shipped recipe with another backbone or decoder. Ours: the shipped recipe with one part left out,
and the paper's field with the paper's losses."""


@dataclass(frozen=True)
class Budget:
    """What every variant may spend: steps, or minutes of training; the rate decays to 0 with it."""

    steps: int | None = None
    minutes: float | None = None

    def __post_init__(self) -> None:
        given = [x for x in (self.steps, self.minutes) if x is not None]
        if len(given) != 1 or given[0] <= 0:
            raise ValueError(
                "budget must be either steps or minutes, and positive, got "
                f"steps={self.steps}, minutes={self.minutes}"
            )


def ablate(
    names: Sequence[str],
    budget: Budget,
    data: Callable[..., ExpLogDataModule],
    folder: str | Path,
    seed: int = 0,
    variants: Mapping[str, Variant] = VARIANTS,
    keep_every: int = 250,
) -> dict[str, Any]:
    """Train variants one after the other, from the same seed, on the same samples in one order.

    Writes `folder/NAME/` (averaged weights, by `save_pretrained`) and `folder/ablation.json`.
    Called again it skips what is finished and goes on from the last checkpoint of what is not. Of
    two equal variants the second takes over the result of the first.

    Args:
        names: which variants, in which order.
        budget: of each.
        data: called with `tau`, gives the samples.
        folder: where to write.
        seed: of the weights.
        variants: what the names mean.
        keep_every: steps between checkpoints.

    Returns:
        The content of `ablation.json`: `settings`, and per finished variant steps, seconds,
        parameters, validation errors of the averaged weights, seed, versions and recipe.

    Raises:
        ValueError: a name that is not a variant, or results of other settings in `folder`.
    """
    unknown = [name for name in names if name not in variants]
    if unknown:
        raise ValueError(f"variants must be among {sorted(variants)}, got {unknown}")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    settings = {"budget": asdict(budget), "seed": seed, "precision": precision()}
    record = _open_record(folder / RECORD, settings | {"data": _described(data(tau=0.5))})
    finished = record["variants"]
    for name in names:
        variant, where = variants[name], folder / name
        if name in finished:
            if finished[name]["recipe"] != _plain(variant.recipe()):
                raise ValueError(f"{where} was trained with another recipe: take another folder")
            continue
        twins = [x for x in finished if finished[x]["recipe"] == _plain(variant.recipe())]
        if twins:
            shutil.copytree(folder / twins[0], where, dirs_exist_ok=True)
            facts = finished[twins[0]] | {"same_as": twins[0]}
        else:
            facts = train(variant, budget, data(tau=variant.tau), where, seed, keep_every)
        finished[name] = facts | {"table": variant.table}
        _write(folder / RECORD, record)
        (where / CHECKPOINT).unlink(missing_ok=True)
        print(f"{name}: {facts['steps']} steps, {facts['seconds']} s, {facts['validation']}")
    return record


def train(
    variant: Variant,
    budget: Budget,
    data: ExpLogDataModule,
    folder: Path,
    seed: int = 0,
    keep_every: int = 250,
) -> dict[str, Any]:
    """Train one variant, save its averaged weights in `folder`, and say what it took.

    Goes on from `folder/last.ckpt`; `seconds` adds up all sittings but validation, at the end.
    """
    L.seed_everything(seed, verbose=False)
    model = ExpLogPretraining(losses=variant.losses, config=variant.config)
    average = ExponentialAverage()
    timer = Timer(timedelta(minutes=budget.minutes) if budget.minutes else None, verbose=False)
    keep = ModelCheckpoint(
        folder, "last", every_n_train_steps=keep_every, enable_version_counter=False
    )
    fit = _trainer(
        max_steps=budget.steps or -1,
        max_epochs=-1,
        gradient_clip_val=1.0,
        limit_val_batches=0,
        callbacks=[average, timer, keep, DivergenceGuard()],
    )
    begun = folder / CHECKPOINT if (folder / CHECKPOINT).exists() else None
    fit.fit(model, datamodule=data, ckpt_path=begun)
    model.field.load_state_dict(average.average)
    errors = _trainer().validate(model, datamodule=data, verbose=False)
    model.field.save_pretrained(folder)
    seconds = timer.time_elapsed()
    return {
        "steps": fit.global_step,
        "seconds": round(seconds, 1),
        "seconds_a_step": round(seconds / fit.global_step, 4),
        "parameters": sum(x.numel() for x in model.field.parameters()),
        "validation": {
            name.removeprefix("val/"): x if math.isfinite(x) else None  # nothing to average
            for part in errors
            for name, x in part.items()
        },
        "seed": seed,
        "versions": {
            "riemlayer": riemlayer.__version__,
            "torch": torch.__version__,
            "lightning": L.__version__,
            "python": platform.python_version(),
        },
        "recipe": _plain(variant.recipe()),
    }


def precision() -> str:
    """bfloat16 where the processor multiplies it natively, else float32."""
    native = torch.cuda.is_available() or torch.cpu._is_avx512_bf16_supported()
    return "bf16-mixed" if native else "32-true"


def _trainer(**settings: Any) -> L.Trainer:
    return L.Trainer(
        accelerator="cuda" if torch.cuda.is_available() else "cpu",
        devices=1,
        precision=precision(),  # pyright: ignore[reportArgumentType]
        logger=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        **settings,
    )


def _described(data: ExpLogDataModule) -> dict[str, int]:
    """What identifies the samples, but for the folders they are in."""
    data.setup("fit")
    names = "\n".join(f.name for f in (*data.train.files, *data.held.files))
    return {
        "training": len(data.train),
        "validation": len(data.held),
        "sources": data.sources,
        "vectors": data.vectors,
        "names": zlib.crc32(names.encode()),
    }


def _open_record(path: Path, settings: dict[str, Any]) -> dict[str, Any]:
    """The record in `path`, or a new one that is written there at once."""
    if not path.exists():
        record = {"settings": settings, "variants": {}}
        _write(path, record)
        return record
    record = json.loads(path.read_text())
    kept, asked = record["settings"], _plain(settings)
    other = [name for name in asked if kept.get(name) != asked[name]]
    if other:
        raise ValueError(
            f"{path} holds results of other settings: "
            + "; ".join(f"{name} {kept.get(name)}, now {asked[name]}" for name in other)
            + "; take another folder"
        )
    return record


def _write(path: Path, record: dict[str, Any]) -> None:
    unfinished = path.with_suffix(".tmp")
    unfinished.write_text(json.dumps(record, indent=2) + "\n")
    unfinished.replace(path)


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """As it comes back from JSON: lists for tuples."""
    return json.loads(json.dumps(values))


def main(arguments: Sequence[str] | None = None) -> None:
    """`python -m lightning_modules.ablation (--steps N | --minutes M) --roots DIR... -o DIR`."""
    parser = argparse.ArgumentParser(description="Train the variants of Tab. 3, Tab. 5 and ours.")
    spend = parser.add_mutually_exclusive_group(required=True)
    spend.add_argument("--steps", type=int, help="of each variant")
    spend.add_argument("--minutes", type=float, help="of training of each variant")
    parser.add_argument("--variants", default=",".join(VARIANTS), help="default: %(default)s")
    parser.add_argument("--roots", nargs="+", required=True, help="folders of prepared samples")
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=0, help="processes that load data")
    given = parser.parse_args(arguments)
    data = partial(ExpLogDataModule, given.roots, seed=given.seed, workers=given.workers)
    names = list(filter(None, given.variants.split(",")))
    ablate(names, Budget(given.steps, given.minutes), data, given.output, given.seed)


if __name__ == "__main__":
    main()
