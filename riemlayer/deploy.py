"""The decoders as programs that run without riemlayer: `torch.export` and ONNX (ours).

A deployed query has two halves. `prepare` is eager: it looks up what a decoder is told of an
encoded surface, namely z(p), the prior (for Exp the gated walks over the planes, for Log the gated
fans), the planes at p and narrow embeddings. `Decoder` is the other half: hypernetwork, planes, MLP
(Sec. 3.2), the anchoring, and validity. It alone is exported. Encoding, walks and look-ups stay
eager: their sizes and branches depend on the data.

    program = deploy.export(field, "exp")                   # any numbers of sources and queries
    torch.export.save(program, "exp.pt2")                   # runs where torch is
    deploy.export_onnx(program, "exp.onnx")                 # runs where onnxruntime is

    query = deploy.prepare(surface, "exp", p, v)            # eager
    answer = torch.export.load("exp.pt2").module()(**query.inputs)
    q, validity = query.finish(*answer)                     # what surface.exp(p, v) answers

A program computes in the precision of the field's weights; mixed precision is not part of it. What
half precision costs, and what `field.exp_head.decoder.compile(dynamic=True)` brings, measures
`python -m benchmarks.deploy`.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, get_args

import torch
from torch import Tensor, nn
from torch.export import Dim, ExportedProgram

from riemlayer.field import ExpLogField
from riemlayer.heads.branch import MapHead, Prepared
from riemlayer.queries import lay_out
from riemlayer.surface import EncodedSurface

Map = Literal["exp", "log"]
NEEDED = ("onnx", "onnxscript")
"""What writing ONNX imports."""


class Decoder(nn.Module):
    """What is exported of a map: its head given the look-ups, (f(x), validity) in the cube (ours).

    Args:
        field: whose weights.
        which: "exp" or "log".

    Shapes: z (S, C), x (S, 1 + K, 3), prior (S, 1 + K, 3), told (S, 1 + K, ...), site (S, ...),
    trust (S, 1 + K, 1) -> vector (S, 1 + K, 3), that is q - p for Exp and v for Log, and validity
    (S, 1 + K), a probability. The first row of every source is the source itself, x = 0, whose
    vector is 0. Where the head is not anchored (the `paper` preset) the inputs are z (S, C) and x
    (S, K, 3) alone.

    Raises:
        ValueError: another map, or "encode", which stays eager.

    >>> field = ExpLogField.from_preset("tiny").eval()
    >>> points = torch.nn.functional.normalize(torch.randn(500, 3), dim=-1)
    >>> query = prepare(field.encode(points), "log", points[:2, None], points[None, :5])
    >>> [y.shape for y in Decoder(field, "log")(**query.inputs)]  # five queries and the source
    [torch.Size([2, 6, 3]), torch.Size([2, 6])]
    """

    def __init__(self, field: ExpLogField, which: Map) -> None:
        super().__init__()
        self.head = _head(field, which)

    def forward(
        self,
        z: Tensor,
        x: Tensor,
        prior: Tensor | None = None,
        told: Tensor | None = None,
        site: Tensor | None = None,
        trust: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        vector, logit = self.head.answer(z, x, prior, () if told is None else (told,), site, trust)
        return vector, logit.sigmoid()


@dataclass(frozen=True)
class Query:
    """Inputs of a program, and the way from its answer to the user's units."""

    inputs: dict[str, Tensor]
    """By the names of `Decoder.forward`; contiguous."""
    origin: Tensor | None
    """(..., 3) what the answer is added to: p for Exp, None for Log."""
    scale: Tensor
    """(..., 1) user's units in one of the cube."""
    batch: torch.Size
    """Batch shape (...) of the query."""
    first: int
    """Row of a source's first query."""

    def finish(self, vector: Tensor, validity: Tensor) -> tuple[Tensor, Tensor]:
        """What the program answered, as `surface.exp` or `surface.log` would: (..., 3) and (...).

        Answers of onnxruntime pass through `torch.from_numpy` first.
        """
        vector, validity = (
            y[:, self.first :].reshape(*self.batch, *y.shape[2:]) for y in (vector, validity)
        )
        moved = self.scale * vector
        answer = moved if self.origin is None else self.origin + moved
        return answer, validity


def prepare(
    surface: EncodedSurface, which: Map, p: Tensor, x: Tensor, shape: Tensor | None = None
) -> Query:
    """The eager half of `surface.exp(p, x)` or `surface.log(p, x)`: all look-ups, no decoder.

    All queries at once, not in chunks: `inputs` take about 3 MB for 10,000 of them.

    Args:
        surface: an encoded surface.
        which: "exp", then `x` are tangent vectors, or "log", then they are points.
        p: (..., 3) base points.
        x: (..., 3), broadcasting with `p`.
        shape: (...) int64, cloud of each base point; only for a packed batch.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.

    >>> field = ExpLogField.from_preset("tiny").eval()
    >>> points = torch.nn.functional.normalize(torch.randn(500, 3), dim=-1)
    >>> surface = field.encode(points)
    >>> query = prepare(surface, "log", points[:4, None], points[None, :50])
    >>> v, validity = query.finish(*Decoder(field, "log")(**query.inputs))
    >>> v.shape, validity.shape
    (torch.Size([4, 50, 3]), torch.Size([4, 50]))
    """
    head = _head(surface.field, which)
    surface.check(**{"p": p, "v" if which == "exp" else "q": x})
    index = surface._shape_of(p, shape)
    scale, centre = surface.scale[index][..., None], surface.centre[index]
    local = x / scale if which == "exp" else (x - centre) / scale
    batch = torch.broadcast_shapes(p.shape, x.shape, scale.shape)[:-1]
    if not math.prod(batch):
        raise ValueError(
            f"`p` and `x` must hold at least one query, got batch shape {tuple(batch)}"
        )
    found = head.prepare(surface.embedding, *lay_out((p - centre) / scale, local, index))
    return Query(_named(found), p if which == "exp" else None, scale, batch, found.first)


def export(field: ExpLogField, which: Map) -> ExportedProgram:
    """`Decoder` as an `ExportedProgram`, for any numbers of sources and queries (ours).

    `torch.export.save(program, "exp.pt2")` writes it; where it is loaded, torch is enough. Until
    then it shares its weights with the field.

    Args:
        field: whose weights; the program runs on their device.
        which: "exp" or "log".

    Raises:
        ValueError: another map, or "encode", which stays eager.
    """
    decoder = Decoder(field, which)
    with torch.no_grad():
        inputs = _example(field, which)
        free = {name: dict.fromkeys(range(x.ndim - 1), Dim.DYNAMIC) for name, x in inputs.items()}
        with torch.autocast(inputs["z"].device.type, enabled=False):
            return torch.export.export(decoder, (), inputs, dynamic_shapes=free)


def export_onnx(program: ExportedProgram, path: str | Path) -> None:
    """Write a program of `export` as one ONNX file with its weights inside.

    Inputs are called as in `Decoder.forward`, outputs `vector` and `validity`.

    Args:
        program: of float32 weights.
        path: to write.

    Raises:
        ModuleNotFoundError: onnx or onnxscript is not installed.
    """
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise ModuleNotFoundError(
            f"ONNX needs {' and '.join(missing)}; install riemlayer with the extra `deploy`",
            name=missing[0],
        )
    with _quiet():
        written = torch.onnx.export(
            program, output_names=["vector", "validity"], dynamo=True, verbose=False
        )
    assert written is not None  # None is for the exporter of old
    written.save(path, external_data=False)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without what torch and onnxscript say about themselves: no torchvision, a fold left out."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript")]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*LeafSpec", FutureWarning)
        try:
            for logger in loggers:
                logger.setLevel(logging.ERROR)
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)


def _head(field: ExpLogField, which: str) -> MapHead:
    if which in get_args(Map):
        return getattr(field, f"{which}_head")
    mend = "ask for 'exp' or 'log'"
    if which == "encode":
        mend = "encode stays eager, because the octree's sizes depend on the points; " + mend
    raise ValueError(f"`which` must be one of {get_args(Map)}, got {which!r}; {mend}")


def _named(found: Prepared) -> dict[str, Tensor]:
    inputs = {"z": found.z, "x": found.x}
    if found.prior is not None:
        inputs |= {"prior": found.prior, "told": torch.cat(found.told, -1)}
    if found.site is not None and found.trust is not None:
        inputs |= {"site": found.site, "trust": found.trust}
    return {name: x.contiguous() for name, x in inputs.items()}


def _example(field: ExpLogField, which: Map) -> dict[str, Tensor]:
    """Inputs of two sources and two queries, sizes that a trace takes for general ones."""
    points = torch.rand(64, 3, generator=torch.Generator().manual_seed(0))
    points = points.to(next(field.parameters()))
    return prepare(field.encode(points), which, points[:2, None], points[None, :2]).inputs
