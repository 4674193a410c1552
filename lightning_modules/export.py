"""From a training checkpoint to packaged weights with their model card."""

from __future__ import annotations

import argparse
import json
import platform
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open

import riemlayer
from riemlayer.config import FieldConfig
from riemlayer.data.dataset import sample_files
from riemlayer.field import ExpLogField
from riemlayer.storage import save_field

TOLD = ("preset", "learning_rate", "weight_decay", "warmup")
"""Hyper-parameters that the card names; paths are not among them."""


def export(
    checkpoint: str | Path,
    weights: str | Path,
    facts: dict[str, Any],
    roots: Sequence[str | Path] = (),
) -> Path:
    """Write the averaged weights of a checkpoint as float16 safetensors beside a JSON card.

    The card counts steps, training time and shapes by what the checkpoint and the samples say.

    Args:
        checkpoint: written by Lightning's `ModelCheckpoint`.
        weights: where to write, `NAME.safetensors`; the card becomes `NAME.json`.
        facts: what else the card says, such as licence and limits.
        roots: folders of the training samples.

    Returns:
        The path of the card.

    Raises:
        ValueError: the checkpoint is not one of `ExpLogPretraining`.
    """
    state = torch.load(checkpoint, map_location="cpu", weights_only=False)
    if "preset" not in state.get("hyper_parameters", {}):
        raise ValueError(f"checkpoint {checkpoint} was not written by ExpLogPretraining")
    given = state["hyper_parameters"].get("config")
    config = FieldConfig.from_dict(given) if given else None
    field = ExpLogField(config or FieldConfig.preset(state["hyper_parameters"]["preset"]))
    averages = [x["average"] for x in state["callbacks"].values() if "average" in x]
    own = {k.removeprefix("field."): x for k, x in state["state_dict"].items()}
    field.load_state_dict(averages[0] if averages else own)
    weights = Path(weights)
    card = weights.with_suffix(".json")
    training = {
        "steps": state["global_step"],
        "epochs": state["epoch"],
        **_progress(state),
        **{k: state["hyper_parameters"][k] for k in TOLD},
        "parameters": sum(x.numel() for x in field.parameters()),
    }
    versions = {
        "riemlayer": riemlayer.__version__,
        "torch": torch.__version__,
        "python": platform.python_version(),
    }
    if roots:
        training["shapes"] = shape_counts(roots)
    save_field(field, weights, card, torch.float16, training=training, versions=versions, **facts)
    weights.chmod(0o644)
    return card


def shape_counts(roots: Sequence[str | Path]) -> dict[str, int]:
    """Training samples by where they come from: the generator, or a folder of meshes."""
    counts: Counter[str] = Counter()
    for path in sample_files(list(roots)):
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
        counts[metadata.get("source", "unknown").split("/")[0]] += 1
    return dict(counts.most_common())


def _progress(state: dict[str, Any]) -> dict[str, Any]:
    """Shapes a step and hours of training, where the run's data module and timer kept them."""
    data = state.get("ExpLogDataModule", {})
    timers = [x["time_elapsed"] for x in state["callbacks"].values() if "time_elapsed" in x]
    seconds = sum(float(timer.get("train", 0)) for timer in timers)
    counted = {"shapes_a_step": data["shapes_a_step"]} if "shapes_a_step" in data else {}
    return counted | ({"hours": round(seconds / 3600, 2)} if timers else {})


def main() -> None:
    """`python -m lightning_modules.export CHECKPOINT WEIGHTS [--facts FILE] [--roots DIR ...]`."""
    parser = argparse.ArgumentParser(description="Write packaged weights from a checkpoint.")
    parser.add_argument("checkpoint")
    parser.add_argument("weights", help="for instance riemlayer/weights/base.safetensors")
    parser.add_argument("--facts", help="JSON file with what else the model card says")
    parser.add_argument("--roots", nargs="*", default=[], help="folders of the training samples")
    arguments = parser.parse_args()
    facts = json.loads(Path(arguments.facts).read_text()) if arguments.facts else {}
    print(export(arguments.checkpoint, arguments.weights, facts, arguments.roots))


if __name__ == "__main__":
    main()
