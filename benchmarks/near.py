"""Errors close to a source, and what part of them the tangent plane there has.

    python -m benchmarks.near DIR [--weights base] [--radius 0.1]

asks Exp along traced geodesics up to the radius, and Log at their ends, on the prepared shapes of
DIR (a folder a group, as `python -m riemlayer.tables` reads them), and writes near.md and near.json
to benchmarks/results. A source's tangent plane is off by the angle between the normal that the
field reads from the cloud, `surface.normal`, and the mesh's. Mean and median are over sources. A
second table compares Exp with heuristic walking on shortest geodesics, each of which counts alike.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean, median

import torch

from benchmarks.measure import write_results
from benchmarks.speed import RESULTS
from riemlayer import ExpLogField
from riemlayer.baselines import Walking
from riemlayer.tables.evaluate import Shape
from riemlayer.tables.render import markdown

WELL_TOLD = 2.0
"""Degrees by which a tangent plane may be off that the cloud tells well."""
COLUMNS = (
    "group",
    "sources",
    "plane off, degrees",
    "Exp",
    "Exp, median",
    "Log",
    "Log, median",
    "Log, % of the distance",
    "median",
    f"plane off by < {WELL_TOLD:g}°",
    "Exp there",
    "Log there",
    "% there",
)
COMPARED = ("group", "shortest geodesics", "Exp", "Tracing (heuristic walking)")


@dataclass(frozen=True)
class Source:
    """Mean errors at one source."""

    off: float
    """Degrees between the field's tangent plane and the mesh's."""
    exp: float
    log: float
    distance: float
    """Mean length of the geodesics."""
    shortest: int
    """How many of them are surely the shortest."""
    exp_shortest: float
    """Mean error of Exp along those; 0 without any."""
    tracing_shortest: float
    """That of heuristic walking."""

    @property
    def share(self) -> float:
        """Log's error in per cent of the distance."""
        return 100 * self.log / self.distance


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("shapes", type=Path, help="prepared shapes, a folder a group")
    parser.add_argument("--weights", default="base", help="name or folder of the field's weights")
    parser.add_argument("--radius", type=float, default=0.1, help="of the geodesics (default 0.1)")
    parser.add_argument("-o", "--out", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    field = ExpLogField.from_pretrained(options.weights).eval()
    groups: dict[str, list[Source]] = {}
    for path in sorted(options.shapes.glob("*/*.npz")):
        found = sources(field, Shape.load(path), options.radius)
        groups.setdefault(path.parent.name, []).extend(found)
    if not any(groups.values()):
        parser.error(f"{options.shapes} holds no GROUP/SHAPE.npz with a geodesic that short")
    facts = {"weights": options.weights, "radius": options.radius, "well_told": WELL_TOLD}
    rows = {group: [asdict(x) for x in found] for group, found in groups.items()}
    write_results(options.out, "near", facts | {"groups": rows}, table(groups))


@torch.inference_mode()
def sources(field: ExpLogField, shape: Shape, radius: float) -> list[Source]:
    """Those of a shape from which a known geodesic is shorter than `radius`."""
    parts = shape.points, shape.V[shape.src], shape.src_normal, shape.vec, shape.end
    points, p, true, v, q = (torch.from_numpy(x).float() for x in parts)
    surface = field.encode(points)
    normal = surface.normal(p)
    off = torch.atan2(torch.linalg.cross(normal, true).norm(dim=-1), (normal * true).sum(-1).abs())
    length, known = v.norm(dim=-1), torch.from_numpy(shape.ok)
    errors = surface.exp(p[:, None], v) - q, surface.log(p[:, None], q) - v
    exp, log = (error.norm(dim=-1) for error in errors)
    tracing = Walking()
    tracing.prepare(shape.points)
    found = []
    for s, near in enumerate(known & (length < radius)):
        if not near.any():
            continue
        means = (x[s, near].mean().item() for x in (exp, log, length))
        sure = near & torch.from_numpy(shape.ok_tight[s])
        there = tracing.exp(p[s].numpy(), v[s, sure].numpy()) - q[s, sure].numpy()
        shortest = exp[s, sure], torch.from_numpy(there).norm(dim=-1)
        on_shortest = (x.mean().item() if len(x) else 0.0 for x in shortest)
        found.append(Source(off[s].rad2deg().item(), *means, int(sure.sum()), *on_shortest))
    return found


def table(groups: dict[str, list[Source]]) -> str:
    """As Markdown, a row a group, and below it Exp beside heuristic walking."""
    first = markdown(COLUMNS, [(group, *row(found)) for group, found in groups.items()])
    lines = [(group, *compared(found)) for group, found in groups.items()]
    return f"{first}\n\n{markdown(COMPARED, lines)}"


def compared(found: Iterable[Source]) -> list[str]:
    """What `COMPARED` says of some sources: all their shortest geodesics count alike."""
    found = list(found)
    count = sum(x.shortest for x in found)
    sums = [
        sum(x.shortest * getattr(x, name) for x in found)
        for name in ("exp_shortest", "tracing_shortest")
    ]
    return [f"{count:,}", *(f"{x / count:.4f}" if count else "–" for x in sums)]


def row(found: Iterable[Source]) -> list[str]:
    """What `COLUMNS` say of some sources."""
    found = list(found)
    exp, log, share = ([getattr(x, name) for x in found] for name in ("exp", "log", "share"))
    told = [x for x in found if x.off < WELL_TOLD]
    near = [fmean(x) for x in zip(*((x.exp, x.log, x.share) for x in told), strict=True)]
    return [
        f"{len(found)}",
        f"{fmean(x.off for x in found):.1f}",
        *(f"{of(x):.4f}" for x in (exp, log) for of in (fmean, median)),
        *(f"{of(share):.1f}" for of in (fmean, median)),
        f"{len(told) / len(found):.0%}",
        *([f"{near[0]:.4f}", f"{near[1]:.4f}", f"{near[2]:.1f}"] if told else ["–"] * 3),
    ]


if __name__ == "__main__":
    main()
