"""From a training checkpoint to packaged weights with their model card."""

from __future__ import annotations

import argparse
import json
import platform
from pathlib import Path
from typing import Any

import torch

import riemlayer
from riemlayer.config import FieldConfig
from riemlayer.field import ExpLogField
from riemlayer.storage import save_field

TOLD = ("preset", "learning_rate", "weight_decay", "warmup")
"""Hyper-parameters that the card names; paths are not among them."""


def export(checkpoint: str | Path, weights: str | Path, facts: dict[str, Any]) -> Path:
    """Write the averaged weights of a checkpoint as float16 safetensors beside a JSON card.

    Args:
        checkpoint: written by Lightning's `ModelCheckpoint`.
        weights: where to write, `NAME.safetensors`; the card becomes `NAME.json`.
        facts: what else the card says, such as data, licence and metrics.

    Returns:
        The path of the card.

    Raises:
        ValueError: the checkpoint is not one of `ExpLogPretraining`.
    """
    state = torch.load(checkpoint, map_location="cpu", weights_only=False)
    if "preset" not in state.get("hyper_parameters", {}):
        raise ValueError(f"checkpoint {checkpoint} was not written by ExpLogPretraining")
    field = ExpLogField(FieldConfig.preset(state["hyper_parameters"]["preset"]))
    averages = [x["average"] for x in state["callbacks"].values() if "average" in x]
    own = {k.removeprefix("field."): x for k, x in state["state_dict"].items()}
    field.load_state_dict(averages[0] if averages else own)
    weights = Path(weights)
    card = weights.with_suffix(".json")
    training = {
        "steps": state["global_step"],
        "epochs": state["epoch"],
        **{k: state["hyper_parameters"][k] for k in TOLD},
        "parameters": sum(x.numel() for x in field.parameters()),
    }
    versions = {
        "riemlayer": riemlayer.__version__,
        "torch": torch.__version__,
        "python": platform.python_version(),
    }
    save_field(field, weights, card, torch.float16, training=training, versions=versions, **facts)
    weights.chmod(0o644)
    return card


def main() -> None:
    """`python -m lightning_modules.export CHECKPOINT WEIGHTS [--facts FILE]`."""
    parser = argparse.ArgumentParser(description="Write packaged weights from a checkpoint.")
    parser.add_argument("checkpoint")
    parser.add_argument("weights", help="for instance riemlayer/weights/base.safetensors")
    parser.add_argument("--facts", help="JSON file with what else the model card says")
    arguments = parser.parse_args()
    facts = json.loads(Path(arguments.facts).read_text()) if arguments.facts else {}
    print(export(arguments.checkpoint, arguments.weights, facts))


if __name__ == "__main__":
    main()
