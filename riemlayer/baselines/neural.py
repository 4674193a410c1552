"""riemlayer's own row: any `ExpLogField` behind the rivals' interface."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

import numpy as np
import torch

from riemlayer.baselines.cloud import Array

if TYPE_CHECKING:
    from riemlayer.field import ExpLogField


class Neural:
    """Exp and Log of an `ExpLogField`, one encode a cloud, without gradients.

    Args:
        field: the field; it is asked in evaluation mode and left in the mode it was in.
        name: what `repr` shows, such as the file its weights came from, beside their checksum.
        views: orientations of the cloud whose answers are averaged (`riemlayer.ops.encode_views`).
    """

    def __init__(self, field: ExpLogField, name: str = "field", views: int = 1):
        self._field, self._name, self._views = field, name, views
        self._fingerprint = fingerprint(field)

    @classmethod
    def from_pretrained(cls, weights: str, views: int = 1) -> Neural:
        """The field of a name or path that `ExpLogField.from_pretrained` knows."""
        from riemlayer import ExpLogField

        return cls(ExpLogField.from_pretrained(weights), weights, views)

    def __repr__(self) -> str:
        views = f", views={self._views}" if self._views > 1 else ""
        return f"Neural({self._name!r}, {self._fingerprint:08x}{views})"

    @torch.inference_mode()
    def prepare(self, points: Array) -> None:
        """Encode the cloud (N, 3)."""
        from riemlayer.ops import encode_views

        training = self._field.training
        try:
            self._surface = encode_views(self._field.eval(), _tensor(points), self._views)
        finally:
            self._field.train(training)

    @torch.inference_mode()
    def exp(self, p: Array, v: Array) -> Array:
        """Exp_p(v) of the field."""
        return self._surface.exp(_tensor(p), _tensor(v)).numpy()

    @torch.inference_mode()
    def log(self, p: Array, q: Array) -> Array:
        """Log_p(q) of the field."""
        return self._surface.log(_tensor(p), _tensor(q)).numpy()


def fingerprint(field: ExpLogField) -> int:
    """CRC-32 of the configuration and all weights (ours)."""
    crc = zlib.crc32(repr(field.config).encode())
    for name, weight in field.state_dict().items():
        crc = zlib.crc32(name.encode(), crc)
        crc = zlib.crc32(weight.contiguous().cpu().flatten().view(torch.uint8).numpy(), crc)
    return crc


def _tensor(x: Array) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(x, dtype=np.float32))
