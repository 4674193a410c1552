"""Organic shapes: smooth unions of round parts in a signed distance grid, then marching cubes.

Distances are negative inside. Parts are only evaluated in their own boxes, so dozens are cheap.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from riemlayer.data.procedural.solids import Rng, from_arrays, to_arrays

Field = Callable[[np.ndarray, np.ndarray, np.ndarray, float], np.ndarray]
FAR = 1e3


@dataclass(frozen=True)
class Part:
    """One signed distance function, the box that holds it, its blend radius, and how it joins."""

    field: Field
    low: np.ndarray
    high: np.ndarray
    blend: float
    removes: bool


def vector(x: ArrayLike) -> np.ndarray:
    return np.asarray(x, float)


class Sculpture:
    """Smooth union of parts, in the order of adding; parts with `removes` are cut away.

    Args:
        blend: Radius over which a new part melts into the rest.
        cells: Number of grid cells.
        thinnest: Smallest radius of a part, in half sides of the whole; at least a grid cell.
    """

    def __init__(self, blend: float = 0.05, cells: float = 0.8e6, thinnest: float = 0.018):
        self.blend, self.cells, self.thinnest = blend, cells, thinnest
        self.parts: list[Part] = []
        self.waves: list[tuple[np.ndarray, float, float]] = []

    def _add(self, field: Field, low, high, blend: float | None, removes: bool) -> None:
        blend = self.blend if blend is None else blend
        self.parts.append(Part(field, vector(low), vector(high), max(blend, 1e-4), removes))

    def cone(self, a, b, ra: float, rb: float | None = None, blend=None, removes=False) -> None:
        """A limb: points within a radius, linear from ra to rb, of the segment from a to b."""
        a, b = vector(a), vector(b)
        rb = ra if rb is None else rb
        axis = b - a
        scale = 1.0 / max(axis @ axis, 1e-12)

        def field(x, y, z, floor):
            r0, r1 = max(ra, floor), max(rb, floor)
            x, y, z = x - a[0], y - a[1], z - a[2]
            t = np.clip((x * axis[0] + y * axis[1] + z * axis[2]) * scale, 0, 1)
            gap = (x - t * axis[0]) ** 2 + (y - t * axis[1]) ** 2 + (z - t * axis[2]) ** 2
            return np.sqrt(gap) - (r0 + t * (r1 - r0))

        low = np.minimum(a - ra, b - rb)
        self._add(field, low, np.maximum(a + ra, b + rb), blend, removes)

    def chain(self, path, radii, blend=None, removes=False) -> None:
        """A limb along a polyline (n, 3) with radii (n,)."""
        path = vector(path)
        radii = np.broadcast_to(vector(radii), len(path))
        for i in range(len(path) - 1):
            joint = 0.6 * min(radii[i], radii[i + 1]) if i and blend is None else blend
            self.cone(path[i], path[i + 1], radii[i], radii[i + 1], joint, removes)

    def ball(self, centre, radii, rotation=None, blend=None, removes=False) -> None:
        """An ellipsoid (first-order distance), with rotation (3, 3) from its axes to space."""
        centre = vector(centre)
        half = np.broadcast_to(vector(radii), 3)
        turn = np.eye(3) if rotation is None else vector(rotation)

        def field(x, y, z, floor):
            x, y, z = _local(x, y, z, centre, turn)
            r = np.maximum(half, floor)
            k0 = np.sqrt((x / r[0]) ** 2 + (y / r[1]) ** 2 + (z / r[2]) ** 2)
            k1 = np.sqrt((x / r[0] ** 2) ** 2 + (y / r[1] ** 2) ** 2 + (z / r[2] ** 2) ** 2)
            return np.where(k0 > 1e-3, k0 * (k0 - 1) / np.maximum(k1, 1e-9), -r.min())

        reach = np.sqrt(((turn * half) ** 2).sum(1))
        self._add(field, centre - reach, centre + reach, blend, removes)

    def block(self, centre, half, rotation=None, round_=0.03, blend=None, removes=False) -> None:
        """A box with half sides (3,) and rounded edges."""
        centre, half = vector(centre), vector(half)
        turn = np.eye(3) if rotation is None else vector(rotation)

        def field(x, y, z, floor):
            x, y, z = _local(x, y, z, centre, turn)
            r = min(round_, 0.99 * half.min())
            inner = np.maximum(half, floor) - r
            x, y, z = np.abs(x) - inner[0], np.abs(y) - inner[1], np.abs(z) - inner[2]
            out = np.maximum(x, 0) ** 2 + np.maximum(y, 0) ** 2 + np.maximum(z, 0) ** 2
            return np.sqrt(out) + np.minimum(np.maximum(np.maximum(x, y), z), 0) - r

        reach = np.abs(turn) @ half
        self._add(field, centre - reach, centre + reach, blend, removes)

    def ring(self, centre, radius: float, thick: float, rotation=None, blend=None, removes=False):
        """A torus about the local z axis."""
        centre = vector(centre)
        turn = np.eye(3) if rotation is None else vector(rotation)

        def field(x, y, z, floor):
            x, y, z = _local(x, y, z, centre, turn)
            return np.hypot(np.hypot(x, y) - radius, z) - max(thick, floor)

        reach = np.abs(turn) @ vector([radius + thick, radius + thick, thick])
        self._add(field, centre - reach, centre + reach, blend, removes)

    def roughen(self, rng: Rng, amplitude: float, wavelength: float, waves: int = 6) -> None:
        """Displace the surface by a sum of random plane waves, too flat to make needles."""
        amplitude = min(amplitude, 0.06 * wavelength)
        for _ in range(waves):
            direction = rng.normal(size=3)
            k = 2 * np.pi / (wavelength * rng.uniform(0.6, 1.7)) / np.linalg.norm(direction)
            self.waves.append((direction * k, rng.uniform(0, 2 * np.pi), amplitude / waves**0.5))

    def grid(self) -> tuple[np.ndarray, np.ndarray, float]:
        """The signed distance on a grid about all parts, its origin and its spacing."""
        solid = [part for part in self.parts if not part.removes]
        low = np.min([part.low for part in solid], 0)
        high = np.max([part.high for part in solid], 0)
        margin = 0.05 * (high - low).max()
        low, high = low - margin, high + margin
        sides = high - low
        step = max((np.prod(sides) / self.cells) ** (1 / 3), sides.max() / 230)
        floor = max(step, self.thinnest * sides.max() / 2)
        axes = [np.arange(low[i], high[i] + step, step, dtype=np.float32) for i in range(3)]
        values = np.full([len(axis) for axis in axes], FAR, np.float32)
        for part in self.parts:
            _join(values, axes, part, floor, 2.5 * step)
        for wave, phase, amplitude in self.waves:
            x, y, z = (np.exp(1j * wave[i] * axes[i]).astype(np.complex64) for i in range(3))
            turn = np.complex64(np.exp(1j * phase) * amplitude)
            values += ((x * turn)[:, None, None] * (y[:, None] * z)).real
        return values, low, float(step)

    def mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (n, 3) and faces (m, 3) of the zero level, thinned where it is flat."""
        values, low, step = self.grid()
        return polygonise(values, low, step)


def polygonise(values: np.ndarray, low: np.ndarray, step: float):
    """Vertices and faces of the zero level of a distance grid, negative inside."""
    from skimage.measure import marching_cubes

    values = np.where(np.abs(values) < 1e-3 * step, np.float32(1e-3 * step), values)
    values = np.pad(np.clip(values, -8 * step, 8 * step), 1, constant_values=8 * step)
    vertices, faces, _, _ = marching_cubes(values, 0.0)
    solid = from_arrays((vertices.astype(float) - 1) * step + low, faces)
    return to_arrays(solid.simplify(0.08 * step))


def _local(x, y, z, centre, turn):
    """Coordinates in a part's own frame: turn^T (x - centre)."""
    x, y, z = x - centre[0], y - centre[1], z - centre[2]
    if np.array_equal(turn, np.eye(3)):
        return x, y, z
    return tuple(turn[0, i] * x + turn[1, i] * y + turn[2, i] * z for i in range(3))


def _join(values: np.ndarray, axes, part: Part, floor: float, pad: float) -> None:
    """Smooth union or cut within a part's box: min(a, b) - h^2 k / 4, h = 1 - |a - b| / k."""
    reach = part.blend + pad + floor
    span = [
        slice(*np.searchsorted(axes[i], [part.low[i] - reach, part.high[i] + reach]))
        for i in range(3)
    ]
    x, y, z = (axes[i][span[i]] for i in range(3))
    new = part.field(x[:, None, None], y[:, None], z, 0.0 if part.removes else floor)
    old = values[tuple(span)]
    sign = -1.0 if part.removes else 1.0
    a, b = sign * old, new
    h = np.maximum(1 - np.abs(a - b) / part.blend, 0)
    values[tuple(span)] = sign * (np.minimum(a, b) - 0.25 * part.blend * h * h)
