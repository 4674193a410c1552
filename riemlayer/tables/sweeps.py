"""The numbers of the figures that no table has: errors against noise and density, times.

Every function returns plain lists and dictionaries, for JSON and for `figures`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from statistics import median

import numpy as np
import torch
from torch import Tensor

from riemlayer import EncodedSurface, ExpLogField
from riemlayer.baselines import Neural
from riemlayer.data.closed_form import Torus
from riemlayer.tables.evaluate import Shape, evaluate, pool, summarise
from riemlayer.tables.systems import RIVALS
from riemlayer.tables.truth import NOISE, cloud

Array = np.ndarray
SECTION = "r0.5_tight"
"""The mask that errors are measured on: shortest geodesics, up to the trained radius."""
METRICS = ("exp", "log_end", "angle")
LEVELS = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03)
DENSITIES = (500, 1_000, 2_000, 4_000, 8_000, 15_000)
POINTS = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
SOURCES = (1, 4, 16, 64, 256, 1024)


def noise_sweep(
    field: ExpLogField, shapes: Sequence[Shape], levels: Sequence[float] = LEVELS
) -> dict:
    """Mean errors against the largest displacement of the points, uniform as in Sec. 4.1.

    A point moves in the same direction at every level, and in proportion to it.

    Args:
        field: our row, "base", beside heat, projection and tracing.
        shapes: prepared shapes; their `points` are moved.
        levels: largest displacements, in the cube.

    Returns:
        {"x": levels, "shapes": number, "methods": {name: {"exp", "log_end", "angle": a number a
        level}}, "failed": {"name at x": reason}}. A map that a method lacks has no entry; where
        the method failed on a shape stands None.
    """

    def moved(shape: Shape, level: float, index: int) -> Array:
        step = cloud("noisy", shape.points, shape.F, index) - shape.points
        return (shape.points + level / NOISE * step).astype(np.float32)

    return _sweep(field, shapes, levels, moved)


def density_sweep(
    field: ExpLogField, shapes: Sequence[Shape], counts: Sequence[int] = DENSITIES
) -> dict:
    """Mean errors against the number of points, drawn from the surface uniformly by area.

    Args:
        field, shapes: as for `noise_sweep`; the clouds are samples of the shapes' meshes.
        counts: numbers of points.

    Returns:
        As `noise_sweep`.
    """
    from riemlayer.data.meshes import sample_surface

    def sampled(shape: Shape, count: float, index: int) -> Array:
        rng = np.random.default_rng(index)
        return sample_surface(shape.V, shape.F, int(count), rng).astype(np.float32)

    return _sweep(field, shapes, counts, sampled)


def _sweep(
    field: ExpLogField,
    shapes: Sequence[Shape],
    x: Sequence[float],
    points: Callable[[Shape, float, int], Array],
) -> dict:
    """Errors of our field and its rivals on the clouds that `points` makes of the shapes at x."""
    from tqdm import tqdm

    methods = {"base": Neural(field)}
    methods |= {name: RIVALS[name]() for name in ("heat", "projection", "tracing")}
    rows: dict[str, list[dict]] = {name: [] for name in methods}
    failed: dict[str, str] = {}
    for value in tqdm(x, disable=None):
        clouds = [replace(s, points=points(s, value, i)) for i, s in enumerate(shapes)]
        for name, method in methods.items():
            try:
                row = summarise(pool([evaluate(method, shape) for shape in clouds]))
            except (ValueError, RuntimeError, ArithmeticError) as error:
                failed[f"{name} at {value:g}"] = f"{type(error).__name__}: {error}"
                row = {}
            rows[name].append(row.get(SECTION, {}))
    curves = {
        name: {
            metric: [row.get(metric) for row in found]
            for metric in METRICS
            if any(metric in row for row in found)
        }
        for name, found in rows.items()
    }
    return {"x": [*x], "shapes": len(shapes), "methods": curves, "failed": failed}


def point_times(
    field: ExpLogField,
    counts: Sequence[int] = POINTS,
    sources: int = 16,
    queries: int = 400,
    repeats: int = 3,
) -> dict:
    """Seconds to encode a cloud and to ask it, against its number of points.

    Args:
        field: in the precision it is.
        counts: points of a torus, one cloud each.
        sources, queries: vectors are asked at `sources` points, `queries` at each.
        repeats: the median of so many calls counts, after one that does not.

    Returns:
        {"x": counts, "encode", "exp", "log": seconds a count, "sources", "queries", "threads"}.
    """
    times: dict[str, list[float]] = {"encode": [], "exp": [], "log": []}
    with torch.inference_mode():
        for count in counts:
            points = _torus(count)
            times["encode"].append(_seconds(lambda x=points: field.encode(x), repeats))
            for name, spent in _ask(field.encode(points), points, sources, queries, repeats):
                times[name].append(spent)
    facts = {"sources": sources, "queries": queries, "threads": torch.get_num_threads()}
    return {"x": [*counts], **times, **facts}


def source_times(
    field: ExpLogField,
    counts: Sequence[int] = SOURCES,
    points: int = 10_000,
    queries: int = 400,
    repeats: int = 3,
) -> dict:
    """Seconds to ask one encoded cloud, against the number of sources.

    Args:
        field, repeats: as for `point_times`.
        counts: numbers of sources, each asked `queries` vectors; at most `points`.
        points: of the cloud.

    Returns:
        {"x": counts, "exp", "log": seconds a count, "points", "queries", "threads"}.
    """
    times: dict[str, list[float]] = {"exp": [], "log": []}
    with torch.inference_mode():
        on = _torus(points)
        surface = field.encode(on)
        for count in counts:
            for name, spent in _ask(surface, on, count, queries, repeats):
                times[name].append(spent)
    facts = {"points": points, "queries": queries, "threads": torch.get_num_threads()}
    return {"x": [*counts], **times, **facts}


def _torus(count: int) -> Tensor:
    return Torus().sample(count, torch.Generator().manual_seed(0)).float()


def _ask(
    surface: EncodedSurface, points: Tensor, sources: int, queries: int, repeats: int
) -> list[tuple[str, float]]:
    """Seconds of Exp at the first `sources` points, and of Log at the end points."""
    p = points[:sources, None]
    v = torch.randn(sources, queries, 3, generator=torch.Generator().manual_seed(0))
    v = 0.3 * torch.nn.functional.normalize(Torus().project_to_tangent(p, v), dim=-1)
    q = surface.exp(p, v)
    return [
        ("exp", _seconds(lambda: surface.exp(p, v), repeats)),
        ("log", _seconds(lambda: surface.log(p, q), repeats)),
    ]


def _seconds(run: Callable[[], object], repeats: int) -> float:
    """Median wall time after one call that does not count."""
    run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return median(times)
