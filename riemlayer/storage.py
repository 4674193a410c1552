"""Saving and loading: safetensors beside a JSON card, packaged names offline, hub by mixin."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Any, Self

import torch
from huggingface_hub import ModelHubMixin, hf_hub_download
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from riemlayer.config import FieldConfig

WEIGHTS, CARD = "model.safetensors", "config.json"


class Pretrained(ModelHubMixin, library_name="riemlayer", tags=["geometry"]):
    """`from_pretrained`, `save_pretrained` and `push_to_hub`, by huggingface_hub's mixin."""

    config: FieldConfig

    @classmethod
    def from_pretrained(cls, pretrained_model_name_or_path: str | Path, **kwargs: Any) -> Self:  # pyright: ignore
        """A trained field: a packaged name such as "base" (offline), a directory, or a hub id.

        Raises:
            FileNotFoundError: a directory without weights.
            ValueError: truncated weights, or weights of another configuration.

        >>> from riemlayer import ExpLogField
        >>> ExpLogField.from_pretrained("base").config.radius
        0.5
        """
        name = str(pretrained_model_name_or_path)
        packaged = resources.files("riemlayer") / "weights" / f"{name}.safetensors"
        if name == Path(name).name and packaged.is_file():
            with resources.as_file(packaged) as weights:
                return cls._read(weights, weights.with_suffix(".json"))
        return super().from_pretrained(pretrained_model_name_or_path, **kwargs)  # pyright: ignore

    @classmethod
    def _from_pretrained(cls, *, model_id: str, **kwargs: Any) -> Self:
        folder = Path(model_id)
        if folder.is_dir():
            for name in (WEIGHTS, CARD):
                if not (folder / name).is_file():
                    raise FileNotFoundError(
                        f"{folder} holds no {name}: not saved by save_pretrained"
                    )
            return cls._read(folder / WEIGHTS, folder / CARD)
        known = ("revision", "cache_dir", "force_download", "token", "local_files_only")
        options = {k: kwargs[k] for k in known if k in kwargs}
        files = [hf_hub_download(model_id, name, **options) for name in (WEIGHTS, CARD)]
        return cls._read(Path(files[0]), Path(files[1]))

    def _save_pretrained(self, save_directory: Path) -> None:
        save_field(self, save_directory / WEIGHTS, save_directory / CARD)  # pyright: ignore

    @classmethod
    def _read(cls, weights: Path, card: Path) -> Self:
        facts = json.loads(card.read_text())
        if "config" not in facts:
            raise ValueError(f"{card} holds no `config`: not saved by save_pretrained")
        field = cls(FieldConfig.from_dict(facts["config"]))  # pyright: ignore
        try:
            state = load_file(weights)
        except (SafetensorError, OSError) as error:
            raise ValueError(f"weights file {weights} is truncated or corrupt: {error}") from error
        expected, got = _shapes(field.state_dict()), _shapes(state)  # pyright: ignore
        other = sorted(k for k in expected | got if expected.get(k) != got.get(k))
        if other:
            raise ValueError(
                f"weights {weights} do not fit the configuration in {card}: {len(other)} tensors "
                f"differ, such as {other[0]} of shape {got.get(other[0])}, expected "
                f"{expected.get(other[0])}; load them with the {card.name} saved beside them"
            )
        double = any(x.dtype == torch.float64 for x in state.values())
        field.to(torch.float64 if double else torch.float32)  # pyright: ignore
        field.load_state_dict(state)  # pyright: ignore
        return field.eval()  # pyright: ignore


def _shapes(state: dict[str, Tensor]) -> dict[str, tuple[int, ...]]:
    return {name: tuple(x.shape) for name, x in state.items()}


def save_field(
    field: torch.nn.Module,
    weights: Path,
    card: Path,
    dtype: torch.dtype | None = None,
    **facts: Any,
) -> None:
    """Write the weights, as `dtype` where given, and a JSON card of configuration and `facts`."""
    state = {
        k: x.detach().cpu().to(dtype or x.dtype).contiguous() for k, x in field.state_dict().items()
    }
    save_file(state, weights)
    card.write_text(json.dumps({"config": field.config.to_dict(), **facts}, indent=2) + "\n")  # pyright: ignore
