"""The tables' numbers as pictures: errors against radius, noise and density, times, checkerboards.

A method has one colour and one marker in every figure. Needs the extra `viz` (matplotlib; pyvista
for the checkerboards).
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from riemlayer.baselines import SupportsLog, SupportsPoints
from riemlayer.tables.evaluate import RADII, Shape
from riemlayer.tables.systems import ORACLES, TITLES, UNRANKED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {
    "base": "#0072b2",
    "paper": "#56b4e9",
    "heat": "#d55e00",
    "projection": "#009e73",
    "tracing": "#cc79a7",
    "floor": "#777777",
}
"""Okabe and Ito's palette, which no kind of colour blindness merges."""
MARKERS = {"base": "o", "paper": "v", "heat": "s", "projection": "^", "tracing": "D", "floor": ""}
OTHERS = ("#e69f00", "#000000", "#8c564b", "#4b3f8f")
STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.0,
    "legend.frameon": False,
    "savefig.dpi": 160,
}
EXP, LOG = "Exp error (cube units)", "Log error (cube units)"
WIDTH = 8.4
"""Inches; at 160 dots an inch sharp in a page of 840 pixels."""
GROUPS_A_ROW = 4
RADIUS = max(RADII)


def title(name: str) -> str:
    """What a method is called in a legend."""
    return TITLES.get(name, name).split(" (")[0]


def look(name: str) -> dict[str, Any]:
    """Colour, marker and line of a method, the same in every figure."""
    other = OTHERS[zlib.crc32(name.encode()) % len(OTHERS)]
    return {
        "label": title(name),
        "color": COLOURS.get(name, other),
        "marker": MARKERS.get(name, "x"),
        "linestyle": ":" if name in ORACLES else "-",
        "linewidth": 2.2 if name == "base" else 1.4,
        "zorder": 3 if name == "base" else 2,
    }


def error_against_radius(results: Mapping[str, Any], path: str | Path) -> Path:
    """Exp error by geodesic length and Log error within a radius, a column a group of shapes.

    Both on the tight mask. Rivals that see the mesh and means of several views are left out; the
    truth's own Log error, from reading it between the vertices, is the dotted line.

    Args:
        results: what `python -m riemlayer.tables` writes to tables.json.
        path: of the .png; it appears only when it is complete.

    Raises:
        ValueError: no method has a result.
    """
    methods = {
        name: result["groups"]
        for name, result in results["methods"].items()
        if name not in UNRANKED or name == "floor"
    }
    groups = [
        name
        for name in next(iter(methods.values()), {})
        if any(rows.get(name, {}).get("shapes") for rows in methods.values())
    ]
    if not groups:
        raise ValueError("results must hold a method with a group of shapes, got none")
    columns = min(len(groups), GROUPS_A_ROW)
    bands = -(-len(groups) // columns)
    alone = len(groups) == 1  # then the two panels stand side by side
    inches = (WIDTH, 2.9) if alone else (WIDTH * max(2, columns) / GROUPS_A_ROW, 3.6 * bands)
    with _figure(path, inches) as figure:
        axes = figure.subplots(*((1, 2) if alone else (2 * bands, columns)), squeeze=False)
        axes = axes.T if alone else axes
        exp, log = list(axes[0::2].flat), list(axes[1::2].flat)
        for i, (above, below) in enumerate(zip(exp, log, strict=True)):
            if i >= len(groups):
                above.set_visible(False)
                below.set_visible(False)
                continue
            for name, rows in methods.items():
                _line(above, name, *_by_length(rows[groups[i]]))
                _line(below, name, *_within_radius(rows[groups[i]]))
            above.set(title=groups[i].replace("_", " "), xlabel="geodesic length", xlim=(0, 0.5))
            below.set(xlabel="within radius", xlim=(0, 0.52))
            if alone:
                below.set_title(above.get_title())
        for row, label in ((exp, EXP), (log, LOG)):
            _share_y(row[: len(groups)], columns, label)
        _legend(figure)
    return Path(path)


def error_against_noise(numbers: Mapping[str, Any], path: str | Path) -> Path:
    """Exp and Log error against the noise of the cloud, of `sweeps.noise_sweep`."""
    return _draw_sweep(numbers, path, "largest displacement of a point (cube units)", "linear")


def error_against_density(numbers: Mapping[str, Any], path: str | Path) -> Path:
    """Exp and Log error against the number of points, of `sweeps.density_sweep`."""
    return _draw_sweep(numbers, path, "points", "log")


def time_against_points(numbers: Mapping[str, Any], path: str | Path) -> Path:
    """Seconds to encode and to ask against the number of points, of `sweeps.point_times`."""
    asked = f"{numbers['sources']} sources x {numbers['queries']} queries"
    panels = {"Encode the cloud": ("encode",), f"Ask it: {asked}": ("exp", "log")}
    return _draw_times(numbers, path, "points of the cloud", panels)


def time_against_sources(numbers: Mapping[str, Any], path: str | Path) -> Path:
    """Seconds to ask an encoded cloud against the sources, of `sweeps.source_times`."""
    asked = f"{numbers['points']:,} points, {numbers['queries']} queries a source"
    return _draw_times(numbers, path, "sources", {asked: ("exp", "log")})


def checkerboards(
    shape: Shape,
    methods: Mapping[str, object],
    path: str | Path,
    source: int | None = None,
    size: int = 420,
) -> Path:
    """Log maps of one source as checkerboards, a column a method, the truth last.

    Vertices outside the mask are grey in all of them; longer vectors than `RADIUS` are drawn as
    long as that.

    Args:
        shape: a prepared shape; methods see its `points`, the map is drawn on its mesh.
        methods: by name, each with `prepare` and `log`.
        path: of the .png.
        source: which of the shape's sources; by default one that is seen well.
        size: of a column, in pixels.

    Raises:
        ValueError: a method has no `log`, or cannot be prepared from points.
    """
    from riemlayer.viz import Drawing, tangent_coordinates, viewpoint, write_png

    s = _seen_well(shape) if source is None else source
    p, normal, seen = shape.V[shape.src[s]], shape.src_normal[s], shape.valid[s]
    answers = {}
    for name, method in methods.items():
        if not isinstance(method, SupportsLog) or not isinstance(method, SupportsPoints):
            raise ValueError(f"methods must have prepare and log, {name!r} lacks one")
        method.prepare(shape.points)
        answers[title(name)] = method.log(p, shape.V)
    drawings = []
    for words, log in (answers | {"truth": shape.log[s]}).items():
        flat = _masked(tangent_coordinates(log, normal), seen)
        drawings.append(Drawing(shape.V, shape.F, log=flat, p=p, title=words, radius=RADIUS))
    return write_png(path, *drawings, view=viewpoint(shape.V, normal), size=size)


def _masked(flat: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Tangent coordinates (n, 2) with a length up to `RADIUS` where `seen`, and above it elsewhere.

    Directions stay, so that tiles run straight to the border of the mask.
    """
    reach = np.linalg.norm(flat, axis=-1, keepdims=True)
    flat = np.where(reach > 1e-9, flat / np.maximum(reach, 1e-9), [1.0, 0.0])
    inside, outside = reach.clip(max=RADIUS), reach.clip(min=1.04 * RADIUS)
    return flat * np.where(seen[:, None], inside, outside)


def _seen_well(shape: Shape) -> int:
    """The source with many valid vertices, and most of the shape behind it."""
    offset = shape.V - shape.V[shape.src][:, None]
    behind = ((offset * shape.src_normal[:, None]).sum(-1) <= 0).mean(1)
    return int((shape.valid.mean(1) * behind).argmax())


def _by_length(rows: Mapping[str, Any]) -> tuple[list[float], list[float]]:
    """Middles of the bins of geodesic length, and the Exp error in each."""
    bins = rows.get("exp_by_length", {})
    return [float(np.mean([float(x) for x in name.split("-")])) for name in bins], [*bins.values()]


def _within_radius(rows: Mapping[str, Any]) -> tuple[list[float], list[float]]:
    """Radii of the tight masks, and the Log error within each."""
    names = [f"r{r}_tight" for r in sorted(RADII)]
    found = [name for name in names if "log_end" in rows.get(name, {})]
    return [float(x[1:].split("_")[0]) for x in found], [rows[x]["log_end"] for x in found]


def _draw_sweep(numbers: Mapping[str, Any], path: str | Path, label: str, scale: str) -> Path:
    with _figure(path, (WIDTH, 2.9)) as figure:
        axes = figure.subplots(1, 2)
        for axis, key, words in zip(axes, ("exp", "log_end"), (EXP, LOG), strict=True):
            for name, errors in numbers["methods"].items():
                values = [np.nan if y is None else y for y in errors.get(key, ())]
                _line(axis, name, numbers["x"][: len(values)], values)
            axis.set(xlabel=label, ylabel=words, xscale=scale, ylim=(0, None))
            _plain_ticks(axis, numbers["x"])
        _legend(figure)
    return Path(path)


def _draw_times(
    numbers: Mapping[str, Any], path: str | Path, label: str, panels: Mapping[str, Sequence[str]]
) -> Path:
    """Log-log panels; all lines are ours, so they differ in style alone."""
    styles = {"encode": ("-", "o"), "exp": ("-", "o"), "log": ("--", "s")}
    with _figure(path, (WIDTH * max(0.6, len(panels) / 2), 2.9)) as figure:
        for axis, (words, keys) in zip(
            np.ravel(figure.subplots(1, len(panels))), panels.items(), strict=True
        ):
            for key in keys:
                line, marker = styles[key]
                axis.plot(
                    numbers["x"], numbers[key], line, marker=marker, color=COLOURS["base"],
                    label=key.capitalize(),
                )  # fmt: skip
            axis.set(title=words, xlabel=label, ylabel="seconds", xscale="log", yscale="log")
            if len(keys) > 1:
                axis.legend()
    return Path(path)


@contextmanager
def _figure(path: str | Path, inches: tuple[float, float]) -> Iterator[Figure]:
    """A figure in the house style, written through a temporary file at the end."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.png")
    with rc_context(STYLE):
        figure = Figure(figsize=inches, layout="constrained")
        yield figure
        figure.savefig(temporary)
    os.replace(temporary, path)


def _line(axis: Axes, name: str, x: Sequence[float], y: Sequence[float]) -> None:
    if len(x):
        axis.plot(x, y, **look(name))


def _share_y(axes: Sequence[Axes], columns: int, label: str) -> None:
    """One logarithmic range for all; figures and words in the first column."""
    for axis in axes:
        axis.set_yscale("log")
    limits = np.array([axis.get_ylim() for axis in axes])
    for i, axis in enumerate(axes):
        axis.set_ylim(limits[:, 0].min(), limits[:, 1].max())
        axis.tick_params(labelleft=i % columns == 0)
        axis.set_ylabel(label if i % columns == 0 else "")


def _plain_ticks(axis: Axes, values: Sequence[float]) -> None:
    """Ticks at the values that were measured, written out."""
    axis.set_xticks(values, [f"{x:,g}" for x in values])
    axis.minorticks_off()


def _legend(figure: Figure) -> None:
    """One legend above all panels."""
    handles = {}
    for axis in figure.axes:
        handles |= {line.get_label(): line for line in axis.get_lines()}
    columns = int(figure.get_figwidth() / 1.4)
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=columns)
