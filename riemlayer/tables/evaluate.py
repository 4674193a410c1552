"""One method on one prepared shape: every metric at every radius, and the times."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from riemlayer import metrics
from riemlayer.baselines import SupportsExp, SupportsLog, SupportsMesh, SupportsPoints, TrueLog

Array = np.ndarray
Table = dict[str, dict[str, list[float]]]
RADII = (0.5, 0.25, 0.1)
COLLAPSED = 1e3  # what an edge of no length counts in E_MDD, which is infinite as printed
BINS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)


@dataclass(frozen=True)
class Shape:
    """A shape of the evaluation set; the fields are the arrays of its file."""

    V: Array
    F: Array
    points: Array
    src: Array
    src_normal: Array
    vec: Array
    end: Array
    ok: Array
    ok_tight: Array
    log: Array
    valid: Array
    valid_tight: Array

    @classmethod
    def load(cls, path: Path, sources: int | None = None) -> Shape:
        """Read `path`, with the first `sources` sources only (all when None).

        Raises:
            ValueError: the file lacks an array.
        """
        with np.load(path) as file:
            missing = [name for name in cls.__dataclass_fields__ if name not in file]
            if missing:
                raise ValueError(
                    f"{path} must hold the arrays of a prepared shape, lacks {missing}"
                )
            arrays = {name: file[name] for name in cls.__dataclass_fields__}
        shared = ("V", "F", "points")
        return cls(**{k: x if k in shared else x[:sources] for k, x in arrays.items()})

    @cached_property
    def edges(self) -> Array:
        """The mesh's undirected edges (E, 2)."""
        return metrics.mesh_edges(self.F).numpy()

    def masks(self, s: int) -> dict[str, tuple[Array, Array]]:
        """Masks of source s, {"r0.5": (vertices (n,), end points (K,)), "r0.5_tight": ..., ...}.

        A vertex counts at radius r when it is valid, |log| < r and, since far from the source the
        table's log maps collapse to short vectors, |V - p| < 1.05 r. The tight masks hold shortest
        geodesics only and are free of such vertices.
        """
        reach, length = (np.linalg.norm(x[s], axis=-1) for x in (self.log, self.vec))
        near = np.linalg.norm(self.V - self.V[self.src[s]], axis=-1) / 1.05
        return {
            f"r{r}{kind}": (
                vertices[s] & (reach < r) & (near < r),
                ends[s] & (length < r),
            )
            for kind, vertices, ends in (
                ("", self.valid, self.ok),
                ("_tight", self.valid_tight, self.ok_tight),
            )
            for r in RADII
        }


def applies(method: object, shape: Shape) -> bool:
    """Whether the shape gives the method what it needs: faces of the input points, for meshes."""
    return not isinstance(method, SupportsMesh) or np.array_equal(shape.points, shape.V)


def evaluate(method: object, shape: Shape) -> Table:
    """Every metric of `method` on `shape`, one number a source, and the times in seconds.

    Returns:
        {"r0.5": {"mdd", "mdd_clip", "angle", "mdd_true", "mdd_clip_true", "angle_true", "log_end",
        "exp"}, ... (one entry a mask; `_true` is measured in the true tangent plane, the others in
        the plane of the method's own answers),
        "exp_by_length": {"0-0.1": ...}, "relative_by_length": ..., "at_p": {"log_zero",
        "log_differential", "exp_zero", "exp_differential"}, "time": {"prepare", "log", "exp"}}.
        A map that the method lacks has no entries; a source whose mask holds no edge, triangle or
        end point gives no number for what is measured on these.

    Raises:
        ValueError: an answer is not finite where it counts.
    """
    rows: list[tuple[str, str, float]] = [("time", "prepare", _timed(_prepare, method, shape)[1])]
    for s in range(len(shape.src)):
        if isinstance(method, SupportsLog):
            rows += _log_rows(method, shape, s)
        if isinstance(method, SupportsExp):
            rows += _exp_rows(method, shape, s)
    table: Table = {}
    for section, name, value in rows:
        table.setdefault(section, {}).setdefault(name, []).append(value)
    return table


def pool(tables: list[Table]) -> Table:
    """The numbers of several shapes side by side, so that every source weighs the same."""
    pooled: Table = {}
    for table in tables:
        for section, row in table.items():
            for name, values in row.items():
                pooled.setdefault(section, {}).setdefault(name, []).extend(values)
    return pooled


def summarise(table: Table) -> dict[str, dict[str, float]]:
    """Mean over the sources of every metric; the median of times."""
    return {
        section: {
            key: float(np.median(x) if section == "time" else np.mean(x)) for key, x in row.items()
        }
        for section, row in table.items()
    }


def _prepare(method: object, shape: Shape) -> None:
    if isinstance(method, TrueLog):
        method.prepare_truth(shape.V, shape.F, shape.src, shape.log)
    elif isinstance(method, SupportsMesh):
        method.prepare_mesh(shape.V, shape.F)
    elif isinstance(method, SupportsPoints):
        method.prepare(shape.points)
    else:
        raise ValueError(f"method must have prepare(points), got {type(method).__name__}")


def _log_rows(method: SupportsLog, shape: Shape, s: int) -> list[tuple[str, str, float]]:
    p, n = shape.V[shape.src[s]], len(shape.V)
    log, seconds = _timed(method.log, p, shape.V)
    at_end = _answer(method.log(p, shape.end[s]), shape.end[s].shape)
    log, masks = _answer(log, (n, 3)), shape.masks(s)
    rows = [("time", "log", seconds)]
    counted = shape.valid[s] | shape.valid_tight[s]
    if counted.any():
        own = metrics.in_plane(log, counted)
        true = metrics.in_plane(log, counted, shape.src_normal[s])
        rows += _distortions(shape, own, counted, masks, "")
        rows += _distortions(shape, true, counted, masks, "_true")
    for section, (_, ends) in masks.items():
        if ends.any():
            error = metrics.log_end_error(shape.vec[s], at_end, ends)
            rows.append((section, "log_end", float(error)))
    frame = tangent_frame(shape.src_normal[s])
    differential = metrics.log_differential_error(method.log, p, frame)
    rows.append(("at_p", "log_zero", float(metrics.log_zero_error(method.log, p))))
    return [*rows, ("at_p", "log_differential", float(differential))]


def _distortions(
    shape: Shape,
    log: torch.Tensor,
    counted: Array,
    masks: dict[str, tuple[Array, Array]],
    kind: str,
) -> list[tuple[str, str, float]]:
    """Eq. (5) and E_MDD of every mask that holds a triangle or an edge, all within `counted`."""
    faces, edges = shape.F[counted[shape.F].all(-1)], shape.edges[counted[shape.edges].all(-1)]
    angle = metrics.triangle_distortion(shape.V, faces, log)
    distance = metrics.edge_distortion(shape.V, edges, log)
    rows = []
    for section, (valid, _) in masks.items():
        angles = angle[torch.from_numpy(valid[faces]).all(-1)]
        distances = distance[torch.from_numpy(valid[edges]).all(-1)]
        for name, x in (
            ("angle", angles),
            ("mdd", distances.clamp(max=COLLAPSED)),
            ("mdd_clip", distances.clamp(max=1)),
        ):
            if len(x):
                rows.append((section, name + kind, float(x.mean())))
    return rows


def _exp_rows(method: SupportsExp, shape: Shape, s: int) -> list[tuple[str, str, float]]:
    p, v, end = shape.V[shape.src[s]], shape.vec[s], shape.end[s]
    q, seconds = _timed(method.exp, p, v)
    q = _answer(q, end.shape)
    rows = [("time", "exp", seconds)]
    for section, (_, ends) in shape.masks(s).items():
        if ends.any():
            rows.append((section, "exp", float(metrics.exp_error(end, q, ends))))
    tight = shape.ok_tight[s]
    error = (torch.from_numpy(end[tight]) - q[tight]).norm(dim=-1)
    length = torch.from_numpy(v[tight]).norm(dim=-1)
    for section, e in (("exp_by_length", error), ("relative_by_length", error / length)):
        means, counts = metrics.mean_by_length(e, length, torch.tensor(BINS))
        rows += [
            (section, f"{low:g}-{high:g}", float(mean))
            for low, high, mean, count in zip(BINS[:-1], BINS[1:], means, counts, strict=True)
            if count
        ]
    frame = tangent_frame(shape.src_normal[s])
    differential = metrics.exp_differential_error(method.exp, p, frame)
    rows.append(("at_p", "exp_zero", float(metrics.exp_zero_error(method.exp, p))))
    return [*rows, ("at_p", "exp_differential", float(differential))]


def tangent_frame(normal: Array) -> Array:
    """Orthonormal tangent axes (3, 2), as columns, at a unit normal (3,)."""
    helper = np.eye(3, dtype=normal.dtype)[np.abs(normal).argmin()]
    first = np.cross(normal, helper)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)], -1)


def _answer(values: object, shape: tuple[int, ...]) -> torch.Tensor:
    values = torch.as_tensor(values, dtype=torch.float32)
    if values.shape != shape:
        raise ValueError(f"a map must answer with shape {shape}, got {tuple(values.shape)}")
    return values


def _timed(function: Callable, *args) -> tuple[object, float]:
    start = time.perf_counter()
    result = function(*args)
    return result, time.perf_counter() - start
