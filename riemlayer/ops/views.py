"""One cloud encoded in several orientations, whose answers are averaged (ours)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from riemlayer.data.augment import rotation
from riemlayer.numerics import product
from riemlayer.surface import CHUNK, EncodedSurface

if TYPE_CHECKING:
    from riemlayer.field import ExpLogField


class View(NamedTuple):
    """The clouds turned about their centres."""

    turn: Tensor
    """(3, 3) rotation."""
    surface: EncodedSurface
    """The same packed clouds, with their centres at 0, turned."""


@dataclass(frozen=True)
class ViewedSurface(EncodedSurface):
    """An `EncodedSurface` whose Exp and Log are means over several orientations of the cloud.

    Made by `encode_views`. Walks and look-ups err another way where the octree's cells lie another
    way; means err less. All that follows from Exp and Log follows from the means, and the exactness
    at the source is kept: it holds in every view.
    """

    views: tuple[View, ...] = ()
    """Orientations beside the cloud's own."""

    def decode_exp(
        self, p: Tensor, v: Tensor, shape: Tensor | None = None, chunk_size: int = CHUNK
    ) -> tuple[Tensor, Tensor]:
        """Mean of Exp_p(v) (..., 3) and of the validity's logits (...)."""
        index = self._shape_of(p, shape)
        q, logit = super().decode_exp(p, v, shape, chunk_size)
        moved = q - p
        for turn, surface in self.views:
            own = product(p - self.centre[index], turn.T)
            end, validity = surface.decode_exp(own, product(v, turn.T), index, chunk_size)
            moved, logit = moved + product(end - own, turn), logit + validity
        count = 1 + len(self.views)
        return p + moved / count, logit / count

    def decode_log(
        self, p: Tensor, q: Tensor, shape: Tensor | None = None, chunk_size: int = CHUNK
    ) -> tuple[Tensor, Tensor]:
        """Mean of Log_p(q) (..., 3) and of the validity's logits (...)."""
        index = self._shape_of(p, shape)
        centre = self.centre[index]
        vector, logit = super().decode_log(p, q, shape, chunk_size)
        for turn, surface in self.views:
            own, there = (product(x - centre, turn.T) for x in (p, q))
            v, validity = surface.decode_log(own, there, index, chunk_size)
            vector, logit = vector + product(v, turn), logit + validity
        count = 1 + len(self.views)
        return vector / count, logit / count

    def _map(self, change: Callable[[Tensor], Tensor]) -> ViewedSurface:
        views = tuple(View(change(turn), surface._map(change)) for turn, surface in self.views)
        return _with_views(super()._map(change), views)


def encode_views(
    field: ExpLogField,
    points: Tensor,
    views: int = 4,
    batch: Tensor | None = None,
    normals: Tensor | None = None,
) -> ViewedSurface:
    """Encode clouds in several orientations and answer with the mean (ours).

    Costs `views` times the time and memory of `field.encode` and of every query. Orientations are
    always the same, so answers are too.

    Args:
        field: with its weights.
        points: (N, 3) of one cloud, or of several packed one after the other; any unit.
        views: number of orientations, the cloud's own among them; at least 1.
        batch, normals: as for `field.encode`.

    Returns:
        A `ViewedSurface`.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.

    >>> from riemlayer import ExpLogField
    >>> points = torch.nn.functional.normalize(torch.randn(400, 3), dim=-1)
    >>> surface = encode_views(ExpLogField.from_preset("tiny"), points, views=2)
    >>> bool((surface.exp(points[:5], torch.zeros(5, 3)) == points[:5]).all())
    True
    """
    if type(views) is not int or views < 1:
        raise ValueError(f"`views` must be a whole number of at least 1, got {views!r}")
    surface = field.encode(points, batch, normals)
    generator = torch.Generator().manual_seed(0)
    turns = [_turn(generator).to(points) for _ in range(views - 1)]
    return _with_views(surface, tuple(_view(surface, turn, normals) for turn in turns))


def _turn(generator: torch.Generator) -> Tensor:
    """(3, 3) random rotation in double precision."""
    q, r = torch.linalg.qr(rotation(1, generator).double())
    return q * r.diagonal().sign()


def _view(surface: EncodedSurface, turn: Tensor, normals: Tensor | None) -> View:
    """A view at the scale of the cloud, or smaller where it would not fit into the cube."""
    index = surface.batch
    x = product(surface.points - surface.centre[index], turn.T)
    width = x.abs().amax(-1)
    scale = surface.scale.scatter_reduce(0, index, width, "amax")
    told = None if normals is None else product(normals, turn.T)
    cube = (x / scale[index][:, None]).clamp(-1, 1)
    embedding = surface.field.embed(cube, index, told)
    middle = torch.zeros_like(surface.centre)
    return View(
        turn, EncodedSurface(surface.field, embedding, middle, scale, surface.half, x, index)
    )


def _with_views(surface: EncodedSurface, views: tuple[View, ...]) -> ViewedSurface:
    known = {f.name: getattr(surface, f.name) for f in fields(EncodedSurface)}
    return ViewedSurface(**known, views=views)
