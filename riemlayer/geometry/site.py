"""Places of queries: which shape of a batch, and which scale, each is looked up in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Site:
    """What look-ups must know of the places of Q queries; gathered once for a walk of many steps.

    All but `place` may have 1 for Q, where it is the same for all.
    """

    place: Tensor
    """(Q,) int64"""
    scale: Tensor
    """(Q,) int64, its scale"""
    scaling: Tensor
    """(3, 4, Q) see `Grids`."""
    strides: Tensor
    """(3, 3, Q) see `Grids`."""
    corners: Tensor
    """(3, 8, Q) see `Grids`; of the shapes of the queries."""

    def __getitem__(self, rows: Tensor) -> Site:
        """That of some of the queries."""
        place, scale = self.place[rows], self.scale[rows]
        return self._each(place, scale, lambda y: y.index_select(-1, rows))

    def repeat(self, times: int) -> Site:
        """That of `times` queries at each place: of all of them, and of all of them again."""
        place, scale = self.place.repeat(times), self.scale.repeat(times)
        return self._each(place, scale, lambda y: y.repeat(1, 1, times))

    def repeat_interleave(self, times: int) -> Site:
        """That of `times` queries at each place, one place after the other."""
        place, scale = (y.repeat_interleave(times) for y in (self.place, self.scale))
        if len(self.place) == 1:
            return Site(place, scale, self.scaling, self.strides, self.corners)
        return self._each(place, scale, lambda y: y.repeat_interleave(times, -1))

    def _each(self, place: Tensor, scale: Tensor, change: Callable[[Tensor], Tensor]) -> Site:
        parts = self.scaling, self.strides, self.corners
        return Site(place, scale, *(y if y.shape[-1] == 1 else change(y) for y in parts))


Place = Tensor | Site
"""Places (Q,), or what look-ups must know of them."""


def place_of(place: Place) -> Tensor:
    """The places (Q,) themselves."""
    return place.place if isinstance(place, Site) else place
