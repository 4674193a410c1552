"""What is drawn: a shape, a log map or numbers on it, geodesics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from riemlayer.viz.canvas import Canvas
from riemlayer.viz.view import to_numpy

Array = np.ndarray
PATTERNS = {"checker": 1, "polar": 2}
"""Numbers of the tile patterns in `surface.glsl`."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """One shape with what was calculated on it; tensors and arrays are both welcome.

    A surface shows one of: tiles of `log` (tinted with `colours` where both are given), `values` by
    colour map, `colours`, or nothing.

    Args:
        points: (N, 3) vertices of a mesh, or a cloud (drawn as small discs); or a `Canvas`, which
            several drawings of one shape can share.
        faces: (M, 3) triangles, or None for a cloud.
        log: (N, 2) tangent coordinates of every point (`tangent_coordinates`), drawn as tiles;
            NaN is drawn plain.
        p: (3,) source, drawn as a ball.
        dots: (D, 3) points to mark, such as the cloud that stands for the mesh.
        paths: (K, T, 3) polylines such as geodesics from `p`.
        reference: polylines to hold `paths` against, drawn thinner and in black.
        title: a few words above the picture.
        radius: tiles end at |log| = radius.
        period: side of a tile, in the unit of `log`; width of a ring of the polar grid.
        colours: (N, 3) in [0, 1], a colour for every point.
        texture: tiles are `"checker"` or `"polar"` (rings and sectors).
        values: (N,) numbers for every point, with a colour bar; NaN is drawn plain.
        limits: ends of the colour bar; by default the least and the greatest of the drawn values.
        label: words beside the colour bar.
        valid: (N,) nothing is drawn where this is below 1/2, such as a bool mask or `validity`.

    Raises:
        ValueError: naming the argument, what was expected and what came.

    Example:
        >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
        >>> Drawing(square, [[0, 1, 2], [0, 2, 3]], values=[0.0, 2.0, 5.0, np.nan]).limits
        (0.0, 5.0)
    """

    points: Any
    faces: Any = None
    log: Any = None
    p: Any = None
    dots: Any = None
    paths: Sequence[Any] = ()
    reference: Sequence[Any] = ()
    title: str = ""
    radius: float = 0.5
    period: float = 0.1
    colours: Any = None
    texture: Literal["checker", "polar"] = "checker"
    values: Any = None
    limits: tuple[float, float] | None = None
    label: str = ""
    valid: Any = None
    canvas: Canvas = field(init=False)
    """The shape as it is drawn."""
    slope: Array | None = field(init=False, default=None)
    """(N, m, 3) derivative of `log` or `values` along the surface, for the discs of a cloud."""

    def __post_init__(self) -> None:
        canvas = self.points
        if not isinstance(canvas, Canvas):
            canvas = Canvas(self.points, self.faces)
        n = len(canvas.points)
        put: dict[str, Any] = {"canvas": canvas, "points": canvas.points, "faces": canvas.faces}
        for name, shape in {
            "log": (n, 2),
            "colours": (n, 3),
            "values": (n,),
            "valid": (n,),
        }.items():
            put[name] = _checked(name, getattr(self, name), shape)
        for name in ("p", "dots"):
            value = getattr(self, name)
            put[name] = None if value is None else to_numpy(value, float)
        for name in ("paths", "reference"):
            put[name] = tuple(to_numpy(path, float) for path in getattr(self, name))
        if self.texture not in PATTERNS:
            raise ValueError(f"`texture` must be one of {', '.join(PATTERNS)}, got {self.texture}")
        if put["values"] is not None:
            if put["log"] is not None or put["colours"] is not None:
                raise ValueError("`values` must stand alone, got `log` or `colours` beside them")
            put |= self._numbers(put["values"], put["valid"])
            put["slope"] = canvas.slope(put["values"][:, None], put["valid"] >= 0.5)
        if put["log"] is not None:
            whole = np.isfinite(put["log"]).all(1)
            if not whole.all():
                put["log"] = np.where(whole[:, None], put["log"], 0.0)
                put["valid"] = whole * (1.0 if put["valid"] is None else put["valid"])
            drawn = None if put["valid"] is None else put["valid"] >= 0.5
            put["slope"] = canvas.log_slope(put["log"], drawn)
        for name, value in put.items():
            object.__setattr__(self, name, value)

    def replace(self, **changes: Any) -> Drawing:
        """The same drawing with other arguments, on the same canvas."""
        return replace(self, points=self.canvas, **changes)

    @property
    def pattern(self) -> int:
        """Number in `surface.glsl` of what the surface shows."""
        if self.values is not None:
            return 3
        if self.log is None:
            return 0 if self.colours is None else 4
        return PATTERNS[self.texture] if self.colours is None else 5

    @property
    def normals(self) -> Array:
        """(n, 3) unit normals of the drawn vertices, see `Canvas`."""
        return self.canvas.normals

    @property
    def spacing(self) -> float:
        """Typical distance of neighbouring points."""
        return self.canvas.spacing

    def _numbers(self, values: Array, valid: Array | None) -> dict[str, Any]:
        """Values without holes, where they are valid, and the ends of the colour bar."""
        valid = np.isfinite(values) * (1.0 if valid is None else valid)
        drawn = valid >= 0.5
        limits = self.limits
        if limits is None:
            shown = values[drawn] if drawn.any() else np.zeros(1)
            limits = shown.min(), shown.max()
        low, high = map(float, limits)
        if not low <= high:
            raise ValueError(f"`limits` must be (low, high), got {limits}")
        values = np.where(np.isfinite(values), values, low)
        return {"values": values, "valid": valid, "limits": (low, high)}


def _checked(name: str, value: Any, shape: tuple[int, ...]) -> Array | None:
    if value is None:
        return None
    if np.shape(value) != shape:
        mend = "; flatten vectors with tangent_coordinates(log, normal)" if name == "log" else ""
        raise ValueError(f"`{name}` must have shape {shape}, got {np.shape(value)}{mend}")
    return to_numpy(value, float)
