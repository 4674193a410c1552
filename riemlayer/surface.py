"""`EncodedSurface`: an encoded cloud that one can calculate on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Literal, NamedTuple, TypedDict, Unpack, overload

import torch
from torch import Tensor

from riemlayer import checks
from riemlayer.calculus import Calculus
from riemlayer.heads import Embedding, MapOutput, tangent_normals
from riemlayer.octree import HALF_WIDTH, corners
from riemlayer.queries import in_chunks, lay_out, value_and_jacobian

if TYPE_CHECKING:
    from riemlayer.field import ExpLogField

CHUNK = 1 << 14
"""Default number of queries that are decoded at once: about 100 MB of intermediate results."""
SOURCES = 2048
"""Sources whose planes are in memory at once (24 KB each in float32)."""


class MapInfo(NamedTuple):
    """What `return_info=True` adds to an answer; every entry has the batch shape (...)."""

    validity: Tensor
    """Probability that the query lies before the cut locus; low beyond the trained radius too."""
    in_support: Tensor
    """bool: the base point lies in or beside an occupied cell of the octree."""
    cycle_error: Tensor
    """Eq. (4): |Log_p(Exp_p(v)) - v| for Exp, |Exp_p(Log_p(q)) - q| for Log, user's units."""


class How(TypedDict, total=False):
    """What `exp` and `log` may be told besides their arguments."""

    shape: Tensor | None
    chunk_size: int


@dataclass(frozen=True)
class EncodedSurface(Calculus):
    """A cloud after its one pass through the backbone: Exp and Log from any source point.

    Made by `ExpLogField.encode`. Points and vectors are in the user's units. `p` is always the
    first argument and broadcasts with the query: `exp(p[:, None], v)` with p (S, 3) and v (S, K, 3)
    decodes K queries for each of S sources, and generates the planes of each source once.

    Beyond the trained radius (`surface.radius`) answers are extrapolations of low validity. A base
    point off the cloud's support reads the nearest embedding and has `in_support` False. Of a
    packed batch, take `surface[i]`, or pass `shape`, the cloud that each base point belongs to.

    >>> from riemlayer import ExpLogField
    >>> field = ExpLogField.from_preset("tiny")
    >>> points = torch.nn.functional.normalize(torch.randn(500, 3), dim=-1)
    >>> surface = field.encode(points)
    >>> surface.exp(points[:5, None], torch.zeros(5, 7, 3)).shape
    torch.Size([5, 7, 3])
    """

    field: ExpLogField
    embedding: Embedding
    centre: Tensor
    """(B, 3) of each cloud's bounding box, in the user's units."""
    scale: Tensor
    """(B,) half a side of the cube around it: `half`, or more for sparse clouds."""
    half: Tensor
    """(B,) half the longest side of each cloud."""
    points: Tensor
    """(N, 3) the packed clouds, in the user's units."""
    batch: Tensor
    """(N,) int64, cloud of each point."""
    only: int | None = None
    """Set for one cloud of a batch."""

    @property
    def radius(self) -> Tensor:
        """Trained tangent radius of each cloud (B,), user's units; a scalar for one cloud."""
        radius = self.field.config.radius * self.half
        return radius[self.only or 0] if len(self) == 1 else radius

    @property
    def like(self) -> Tensor:
        """What every argument must have the dtype and the device of."""
        return self.centre

    def __len__(self) -> int:
        return 1 if self.only is not None else len(self.scale)

    def __getitem__(self, i: int) -> EncodedSurface:
        if not -len(self) <= i < len(self):
            raise IndexError(f"surface {i} of a batch of {len(self)}")
        if self.only is not None:
            return self
        i %= len(self)
        return replace(self.at((self.batch == i).nonzero().squeeze(-1)), only=i)

    def __iter__(self) -> Iterator[EncodedSurface]:
        return (self[i] for i in range(len(self)))

    def to(self, device: torch.device | str) -> EncodedSurface:
        """The same surface on another device; move `field` there first."""
        return self._map(lambda x: x.to(device))

    def detach(self) -> EncodedSurface:
        """The same surface without the graph of its encoding."""
        return self._map(lambda x: x.detach())

    @overload
    def exp(
        self, p: Tensor, v: Tensor, *, return_info: Literal[False] = ..., **how: Unpack[How]
    ) -> Tensor: ...
    @overload
    def exp(
        self, p: Tensor, v: Tensor, *, return_info: Literal[True], **how: Unpack[How]
    ) -> tuple[Tensor, MapInfo]: ...
    def exp(
        self,
        p: Tensor,
        v: Tensor,
        *,
        shape: Tensor | None = None,
        chunk_size: int = CHUNK,
        return_info: bool = False,
    ) -> Tensor | tuple[Tensor, MapInfo]:
        """Exponential map q = Exp_p(v) (Sec. 3): where the geodesic from p along v ends.

        Args:
            p: (..., 3) base points.
            v: (..., 3) tangent vectors at p, ambient (appendix A), broadcasting with p.
            shape: (...) int64, cloud of each base point; only for a packed batch.
            chunk_size: queries decoded at once; bounds the memory.
            return_info: also return a `MapInfo`.

        Returns:
            (..., 3) points, and the `MapInfo` where asked for.

        Raises:
            TypeError, ValueError: naming the argument, what was expected and what came.
        """
        self.check(p=p, v=v)
        q, logit = self.decode_exp(p, v, shape, chunk_size)
        if not return_info:
            return q
        back, _ = self.decode_log(p, q, shape, chunk_size)
        support = self.in_support(p, shape=shape).expand(logit.shape)
        return q, MapInfo(logit.sigmoid(), support, (back - v).norm(dim=-1))

    @overload
    def log(
        self, p: Tensor, q: Tensor, *, return_info: Literal[False] = ..., **how: Unpack[How]
    ) -> Tensor: ...
    @overload
    def log(
        self, p: Tensor, q: Tensor, *, return_info: Literal[True], **how: Unpack[How]
    ) -> tuple[Tensor, MapInfo]: ...
    def log(
        self,
        p: Tensor,
        q: Tensor,
        *,
        shape: Tensor | None = None,
        chunk_size: int = CHUNK,
        return_info: bool = False,
    ) -> Tensor | tuple[Tensor, MapInfo]:
        """Logarithmic map v = Log_p(q) (Sec. 3): the tangent vector at p that leads to q.

        Past the cut locus the answer is one of several vectors, or between them: see `validity`.

        Args:
            p: (..., 3) base points.
            q: (..., 3) points on the surface, broadcasting with p.
            shape, chunk_size, return_info: as for `exp`.

        Returns:
            (..., 3) ambient tangent vectors, and the `MapInfo` where asked for.

        Raises:
            TypeError, ValueError: naming the argument, what was expected and what came.
        """
        self.check(p=p, q=q)
        v, logit = self.decode_log(p, q, shape, chunk_size)
        if not return_info:
            return v
        there, _ = self.decode_exp(p, v, shape, chunk_size)
        support = self.in_support(p, shape=shape).expand(logit.shape)
        return v, MapInfo(logit.sigmoid(), support, (there - q).norm(dim=-1))

    def jacobian_exp(
        self, p: Tensor, v: Tensor, *, shape: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Exp_p(v) (..., 3) and its Jacobian in v (..., 3, 3), in one forward pass.

        Three tangents are carried through prior, sampler and decoder in forward mode, so a loss on
        J needs only a first-order backward. Arguments and errors as for `exp`.
        """
        self.check(p=p, v=v)
        return value_and_jacobian(lambda x: self.decode_exp(p, x, shape, CHUNK)[0], v)

    def jacobian_log(
        self, p: Tensor, q: Tensor, *, shape: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Log_p(q) (..., 3) and its Jacobian in q (..., 3, 3), in one forward pass.

        Arguments and errors as for `log`.
        """
        self.check(p=p, q=q)
        return value_and_jacobian(lambda x: self.decode_log(p, x, shape, CHUNK)[0], q)

    def normal(self, p: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Unit normals (..., 3) of the tangent planes of `log`, of no certain sign (ours)."""
        x, index, batch = self._in_cube(p, shape)
        plane = self.field.log_head.tangent_plane
        return tangent_normals(plane, self.embedding, x, index).view(*batch, 3)

    def snap(self, p: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """Points (..., 3) dropped onto the cloud's blended planes, in three rounds (ours).

        A point without a plane nearby starts from the nearest leaf's centre.
        """
        x, index, batch = self._in_cube(p, shape)
        x = self.embedding.planes.drop(x, index)
        return (self.centre[index] + self.scale[index][:, None] * x).view(*batch, 3)

    def in_support(self, p: Tensor, *, shape: Tensor | None = None) -> Tensor:
        """(...) bool: p lies in or beside an occupied cell of the octree (ours)."""
        x, index, batch = self._in_cube(p, shape)
        inside = (x.abs() <= HALF_WIDTH).all(-1)
        return (corners(self.embedding.level, x, index).in_support & inside).view(batch)

    def at(self, index: Tensor) -> EncodedSurface:
        """The same surface with fewer points of its own: those of `index` (M,), ascending."""
        return replace(self, points=self.points[index], batch=self.batch[index])

    def radius_at(self, p: Tensor, shape: Tensor | None = None) -> Tensor:
        """Trained radius (...) of the cloud that each base point belongs to."""
        return self.field.config.radius * self.half[self._shape_of(p, shape)]

    def decode_exp(
        self, p: Tensor, v: Tensor, shape: Tensor | None = None, chunk_size: int = CHUNK
    ) -> tuple[Tensor, Tensor]:
        """Exp_p(v) (..., 3) and validity logits (...), without checks: what training calls."""
        index = self._shape_of(p, shape)
        scale = self.scale[index][..., None]
        p_cube, v_cube, flat = lay_out((p - self.centre[index]) / scale, v / scale, index)
        out = self._decode(self.field.exp_head, p_cube, v_cube, flat, chunk_size)
        batch = torch.broadcast_shapes(p.shape, v.shape, scale.shape)[:-1]
        return p + scale * out.vector.view(*batch, 3), out.validity.view(batch)

    def decode_log(
        self, p: Tensor, q: Tensor, shape: Tensor | None = None, chunk_size: int = CHUNK
    ) -> tuple[Tensor, Tensor]:
        """Log_p(q) (..., 3) and validity logits (...), without checks: what training calls."""
        index = self._shape_of(p, shape)
        scale, centre = self.scale[index][..., None], self.centre[index]
        p_cube, q_cube, flat = lay_out((p - centre) / scale, (q - centre) / scale, index)
        out = self._decode(self.field.log_head, p_cube, q_cube, flat, chunk_size)
        batch = torch.broadcast_shapes(p.shape, q.shape, scale.shape)[:-1]
        return scale * out.vector.view(*batch, 3), out.validity.view(batch)

    def _decode(
        self, head: Callable[..., MapOutput], p: Tensor, x: Tensor, shape: Tensor, chunk_size: int
    ) -> MapOutput:
        with self.field.half_precision():
            return in_chunks(partial(head, self.embedding), p, x, shape, chunk_size, SOURCES)

    def _shape_of(self, p: Tensor, shape: Tensor | None) -> Tensor:
        """Index (...) of the cloud that each base point belongs to."""
        if shape is None and len(self) > 1:
            raise ValueError(
                f"`shape` must say which of the {len(self)} clouds each `p` belongs to, got None; "
                "pass an int64 tensor of p's batch shape, or take one cloud with surface[i]"
            )
        if shape is None:
            return torch.full(p.shape[:-1], self.only or 0, device=p.device)
        checks.check_index("shape", shape, len(self.scale), like=p)
        return shape

    def _in_cube(self, p: Tensor, shape: Tensor | None) -> tuple[Tensor, Tensor, torch.Size]:
        """Points (Q, 3) in the cube, the cloud (Q,) of each, and their batch shape."""
        self.check(p=p)
        index = self._shape_of(p, shape)
        batch = torch.broadcast_shapes(index.shape, p.shape[:-1])
        index = index.expand(batch).flatten()
        x = p.expand(*batch, 3).reshape(-1, 3)
        return (x - self.centre[index]) / self.scale[index][:, None], index, batch

    def _map(self, change: Callable[[Tensor], Tensor]) -> EncodedSurface:
        tensors = ("centre", "scale", "half", "points", "batch")
        changed = {name: change(getattr(self, name)) for name in tensors}
        return replace(self, embedding=self.embedding.map(change), **changed)
