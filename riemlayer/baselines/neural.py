"""riemlayer's own row: any `ExpLogField` behind the rivals' interface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from riemlayer.baselines.cloud import Array


@dataclass
class Neural:
    """Exp and Log of an `ExpLogField`, one encode a cloud.

    Args:
        weights: name or path given to `ExpLogField.from_pretrained`.
    """

    weights: str = "base"

    def __post_init__(self) -> None:
        from riemlayer import ExpLogField

        self._field = ExpLogField.from_pretrained(self.weights).eval()

    @torch.inference_mode()
    def prepare(self, points: Array) -> None:
        """Encode the cloud (N, 3)."""
        self._surface = self._field.encode(_tensor(points))

    @torch.inference_mode()
    def exp(self, p: Array, v: Array) -> Array:
        """Exp_p(v) of the field."""
        return self._surface.exp(_tensor(p), _tensor(v)).numpy()

    @torch.inference_mode()
    def log(self, p: Array, q: Array) -> Array:
        """Log_p(q) of the field."""
        return self._surface.log(_tensor(p), _tensor(q)).numpy()


def _tensor(x: Array) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(x, dtype=np.float32))
