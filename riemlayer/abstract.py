"""What an operator may ask of a surface: its two maps, its normals, and a check of arguments."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from torch import Tensor

from riemlayer import checks


class AbstractSurface(ABC):
    """A surface with Exp and Log.

    Points and vectors are (..., 3) in the user's units and broadcast; `shape` (...) int64 says
    which shape of a packed batch is meant.
    """

    @abstractmethod
    def decode_exp(
        self, p: Tensor, v: Tensor, shape: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Exp_p(v) (..., 3) and validity logits (...)."""

    @abstractmethod
    def decode_log(
        self, p: Tensor, q: Tensor, shape: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Log_p(q) (..., 3) and validity logits (...)."""

    @abstractmethod
    def normal(self, p: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Unit normals (..., 3); a cloud does not know their sign."""

    @abstractmethod
    def snap(self, p: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Points (..., 3) moved onto the surface."""

    @abstractmethod
    def radius_at(self, p: Tensor, shape: Tensor | None = None) -> Tensor:
        """Trained radius (...) of the shape that each base point belongs to."""

    @property
    def like(self) -> Tensor | None:
        """A tensor of the dtype and on the device that arguments must have; None: of the first."""
        return None

    def in_support(self, p: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """(...) bool: p lies on the surface or near it."""
        return torch.ones_like(p[..., 0], dtype=torch.bool)

    def check(self, **named: Tensor) -> None:
        """Refuse points or vectors, given by their names, that are not (..., 3), finite, alike.

        Raises:
            TypeError, ValueError: naming the argument, what was expected and what came.
        """
        for name, x in named.items():
            checks.check_tensor(name, x)
            like = next(iter(named.values())) if self.like is None else self.like
            checks.check_vectors(name, x, like)
        checks.check_broadcast(**named)
