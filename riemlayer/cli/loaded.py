"""A shape from a file, encoded: asked and answering in the file's own units.

The field sees the cube in single precision. Centring and scaling happen here in double precision,
so that neither the unit nor the place of a shape costs digits.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from riemlayer.cli.command import Options
from riemlayer.cli.errors import UserError, blame
from riemlayer.cli.nearest import nearest_on_shape
from riemlayer.cli.options import At, Device, Points, Seed, Shape, Source, Weights
from riemlayer.cli.progress import stage, track

if TYPE_CHECKING:
    import torch

    from riemlayer import EncodedSurface, ExpLogField
    from riemlayer.data import RawShape

Array = NDArray[np.float64]
CHUNK = 1 << 14
FARTHEST = 20.0
"""Coordinates farther out, in the cube, are likely in another unit than the file."""


class Place(NamedTuple):
    """A point of the shape that the user named."""

    point: Array
    """(3,) file's units."""
    index: int | None
    """Of the vertex or point, where it was named by index."""
    moved: float
    """How far it was moved onto the shape."""

    def facts(self) -> dict:
        """Plain values."""
        return {"index": self.index, "point": self.point.tolist(), "snapped_by": self.moved}

    def __str__(self) -> str:
        x = ", ".join(f"{value:.6g}" for value in self.point)
        return f"({x})" if self.index is None else f"point {self.index} at ({x})"


@dataclass(frozen=True)
class Where(Options):
    """One point of the shape."""

    source: Source = None
    at: At = None


class Map(NamedTuple):
    """Exp or Log of many queries, file's units."""

    value: Array
    """(..., 3)"""
    validity: Array
    """(...) probability that the query lies before the cut locus."""
    valid: NDArray[np.bool_]
    """(...) the answer is to be believed."""


@dataclass(frozen=True)
class Loaded:
    """A shape and its encoded surface."""

    path: Path
    points: Array
    """(n, 3) vertices of the mesh or points of the cloud, in the file's order and units."""
    faces: NDArray[np.int64] | None
    surface: EncodedSurface
    """In the cube."""
    centre: Array
    scale: float
    """cube = (file - centre) / scale"""

    @property
    def radius(self) -> float:
        """Trained tangent radius, file's units."""
        return float(self.surface.radius) * self.scale

    def inward(self, x: Array) -> torch.Tensor:
        """Points (..., 3) in the cube, for the field."""
        return self.tensor((x - self.centre) / self.scale)

    def outward(self, x: torch.Tensor) -> Array:
        """Points (..., 3) of the cube in the file's units."""
        return numbers(x) * self.scale + self.centre

    def tensor(self, x: Array) -> torch.Tensor:
        """An array in the field's precision and place."""
        import torch

        like = self.surface.centre
        return torch.from_numpy(np.ascontiguousarray(x)).to(like.device, like.dtype)

    def frame(self, p: Array) -> Array:
        """(3, 3) e1, e2 and the normal at p, as columns (appendix A)."""
        return numbers(self.surface.frame(self.inward(p)))

    def distance(self, p: Array, q: Array, log: Map) -> Array:
        """Geodesic distances (N,) by Log_p(q), never below the chord (as `EncodedSurface.dist`)."""
        return np.maximum(np.linalg.norm(log.value, axis=1), np.linalg.norm(q - p, axis=1))

    def log(self, p: Array, q: Array) -> Map:
        """Log_p(q) of one p (3,) and many q (N, 3); valid as `EncodedSurface.valid_mask` says."""
        p_, parts = self.inward(p), []
        for x in track(self.inward(q).split(CHUNK), "Log"):
            v, logit = self.surface.decode_log(p_, x)
            parts.append((v, logit, self.surface.comes_back(p_, x, v)))
        answer = self._map(parts, 0.0)
        return answer._replace(valid=answer.valid & bool(self.surface.in_support(p_)))

    def exp(self, p: Array, v: Array) -> Map:
        """Exp_p(v) of one p (3,) and many v (N, 3); valid where the validity is above one half."""
        p_, parts = self.inward(p), []
        for x in track(self.tensor(v / self.scale).split(CHUNK), "Exp"):
            q, logit = self.surface.decode_exp(p_, x)
            parts.append((q, logit, logit.isfinite()))
        return self._map(parts, self.centre)

    def _map(self, parts: list, shift: Array | float) -> Map:
        import torch

        value, logit, trusted = (torch.cat(x) for x in zip(*parts, strict=True))
        validity = numbers(logit.sigmoid())
        valid = (validity > 0.5) & trusted.cpu().numpy()
        return Map(numbers(value) * self.scale + shift, validity, valid)

    def asked(self) -> torch.Tensor:
        """All points in the cube; of a mesh its samples follow, for few vertices carry no chart."""
        points = self.inward(self.points)
        if self.faces is None:
            return points
        import torch

        return torch.cat((points, self.surface.points))

    def place(self, where: Where) -> Place:
        """The point that --source or --at names."""
        if (where.source is None) == (where.at is None):
            raise UserError("source: give one of --source INDEX and --at X,Y,Z")
        if where.source is not None:
            return self.at_index(where.source, "--source")
        return self.at_point(coordinates(where.at or "", "--at"), "--at")

    def at_index(self, index: int, option: str) -> Place:
        """The vertex or point of this index."""
        if not 0 <= index < len(self.points):
            kind = "points" if self.faces is None else "vertices"
            raise UserError(
                f"{option} must lie in 0 to {len(self.points) - 1}, "
                f"{self.path} has {len(self.points)} {kind}, got {index}"
            )
        return Place(self.points[index], index, 0.0)

    def at_point(self, x: Array, option: str) -> Place:
        """The place on the shape that is nearest to x (3,)."""
        with np.errstate(over="ignore"):
            asked = (x - self.centre) / self.scale
        if not np.abs(asked).max() <= FARTHEST:
            raise UserError(
                f"{option} must lie near the shape, which is {2 * self.scale:.4g} long, got "
                f"{','.join(f'{value:.6g}' for value in x)}; is it in the file's unit?"
            )
        near = nearest_on_shape(asked, (self.points - self.centre) / self.scale, self.faces)
        p = near * self.scale + self.centre
        return Place(p, None, float(np.linalg.norm(p - x)))


@dataclass(frozen=True)
class Encoding(Options):
    """A file and the field that encodes it."""

    shape: Shape
    weights: Weights = "base"
    points: Points = 10_000
    seed: Seed = 0
    device: Device = "cpu"

    def load(self) -> Loaded:
        """Reads the file and encodes its cloud."""
        stage(f"reading {self.shape.name}")
        raw = read(self.shape)
        with blame(self.shape):
            cloud = raw.cloud(self.points, self.seed)
        points = raw.positions if raw.vertices is None else raw.vertices
        low, high = cloud.min(0), cloud.max(0)
        centre, scale = (low + high) / 2, float((high - low).max() / 2)
        if not scale > 0:
            raise UserError(f"{self.shape}: all points are in one place, so the shape has no size")
        stage("loading the field")
        field = load_field(self.weights, self.device)
        stage(f"encoding {len(cloud):,} points")
        import torch

        with blame(self.shape):
            weight = next(field.parameters())
            inside = torch.from_numpy((cloud - centre) / scale).to(weight.device, weight.dtype)
            surface = field.encode(inside)
        return Loaded(self.shape, points, raw.faces, surface, centre, scale)


def read(path: Path) -> RawShape:
    """The content of a file; whatever is wrong with it is the user's to mend."""
    from riemlayer.data import read_shape

    try:
        return read_shape(path)
    except (ValueError, OSError) as error:
        raise UserError(str(error)) from error


def load_field(weights: str, device: str) -> ExpLogField:
    """The field of a packaged name, a folder or a hub id, on a device."""
    import torch

    from riemlayer import ExpLogField

    try:
        where = torch.device(device)
        torch.empty(0, device=where)
    except (RuntimeError, AssertionError) as error:
        raise UserError(f"--device {device} cannot be used here: {str(error)[:200]}") from error
    check_weights(weights, "--weights")
    try:
        return ExpLogField.from_pretrained(weights).to(where).requires_grad_(False)
    except Exception as error:  # the hub's errors are of many kinds
        raise UserError(f"--weights {weights}: {error}") from error


def check_weights(weights: str, option: str) -> None:
    """Refuses what can be neither packaged nor a folder nor a hub id, before anyone is asked."""
    packaged = Path(__file__).parents[1] / "weights" / f"{weights}.safetensors"
    if not (packaged.is_file() or Path(weights).is_dir() or weights.count("/") == 1):
        raise UserError(
            f"{option} must be `base`, a folder by save_pretrained or a hub id, got {weights}"
        )


def coordinates(text: str, option: str) -> Array:
    """(3,) numbers of "x,y,z".

    >>> coordinates("1,-2,3e4", "--at").tolist()
    [1.0, -2.0, 30000.0]
    """
    try:
        x = np.array([float(word) for word in text.split(",")])
    except ValueError:
        x = np.zeros(0)
    if x.shape != (3,) or not np.isfinite(x).all():
        raise UserError(f"{option} must be three numbers as 0.1,-2,3 without blanks, got {text!r}")
    return x


def numbers(x: torch.Tensor) -> Array:
    """A tensor as an array in double precision."""
    return x.double().cpu().numpy()
