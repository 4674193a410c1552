"""Errors on surfaces whose geodesics are known exactly, at several densities, beside the rivals.

    python -m benchmarks.exact [--weights base]

samples a sphere, a cylinder and a torus at random, asks Exp along vectors up to the trained radius
and Log where they lead, and writes exact.md and exact.json to benchmarks/results. No mesh and no
data are needed, and the truth has no error of its own.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.measure import write_results
from benchmarks.speed import RESULTS
from riemlayer.baselines import Heat, Neural, Projection, SupportsExp, SupportsLog, Walking
from riemlayer.data.closed_form import Cylinder, Sphere, Surface, Torus
from riemlayer.tables.render import markdown

RADIUS = 0.5
SURFACES: dict[str, tuple[Surface, float]] = {
    "sphere of radius 1": (Sphere(), 1.0),
    "cylinder of radius 0.3": (Cylinder(0.3), 1.0 - RADIUS),
    "torus of radii 0.7 and 0.3": (Torus(), 1.0),
}
"""As large as the cube, and the largest |z| of sources: their geodesics stay within the cloud, and
those of length `RADIUS` are shortest ones."""


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--weights", default="base", help="name or folder of the field's weights")
    parser.add_argument("--points", type=int, nargs="+", default=[1000, 4000, 10_000], metavar="N")
    parser.add_argument("--sources", type=int, default=20, help="a cloud (default 20)")
    parser.add_argument("--vectors", type=int, default=100, help="a source (default 100)")
    parser.add_argument("-o", "--out", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    methods = {
        "riemlayer": Neural.from_pretrained(options.weights),
        "Heat": Heat(),
        "Projection": Projection(),
        "Tracing": Walking(),
    }
    rows = []
    for name, (surface, high) in SURFACES.items():
        for n in options.points:
            generator = torch.Generator().manual_seed(n)
            points = surface.sample(n, generator)
            p = points[points[:, 2].abs() < high][: options.sources]
            v = vectors(surface, p, options.vectors, generator)
            found = errors(methods, surface, points, p, v)
            rows.append({"surface": name, "points": n, "length": float(v.norm(dim=-1).mean())})
            rows[-1] |= found
    facts = {"weights": options.weights, "sources": options.sources, "vectors": options.vectors}
    write_results(options.out, "exact", facts | {"rows": rows}, table(rows, list(methods)))


def vectors(surface: Surface, p: Tensor, each: int, generator: torch.Generator) -> Tensor:
    """Tangent vectors (S, each, 3) at sources (S, 3), uniform in the disc of `RADIUS`."""
    direction = torch.randn(len(p), each, 3, generator=generator, dtype=p.dtype)
    direction = surface.project_to_tangent(p[:, None], direction)
    direction = direction / direction.norm(dim=-1, keepdim=True)
    share = torch.rand(len(p), each, 1, generator=generator, dtype=p.dtype)
    return RADIUS * share.sqrt() * direction


def errors(
    methods: Mapping[str, object], surface: Surface, points: Tensor, p: Tensor, v: Tensor
) -> dict[str, dict[str, float]]:
    """Mean errors of every method: `exp` of its end points, `log` of its vectors at true ones."""
    q = surface.exp(p[:, None], v)
    found: dict[str, dict[str, float]] = {"exp": {}, "log": {}}
    for name, method in methods.items():
        method.prepare(points.float().numpy())  # pyright: ignore[reportAttributeAccessIssue]
        if isinstance(method, SupportsExp):
            found["exp"][name] = _error(method.exp, p, v, q)
        if isinstance(method, SupportsLog):
            found["log"][name] = _error(method.log, p, q, v)
    return found


def table(rows: list[dict], methods: list[str]) -> str:
    """As Markdown, the best of each map in bold."""
    columns = [(kind, name) for kind in ("exp", "log") for name in methods]
    columns = [(kind, name) for kind, name in columns if name in rows[0][kind]]
    lines = []
    for row in rows:
        best = {kind: min(row[kind].values()) for kind in ("exp", "log")}
        cells = [
            f"**{x:.4f}**" if (x := row[kind][name]) == best[kind] else f"{x:.4f}"
            for kind, name in columns
        ]
        lines.append((row["surface"], f"{row['points']:,}", *cells))
    return markdown(("surface", "points", *(f"{k.capitalize()}: {n}" for k, n in columns)), lines)


def _error(ask, p: Tensor, asked: Tensor, truth: Tensor) -> float:
    each = zip(p.float().numpy(), asked.float().numpy(), truth.numpy(), strict=True)
    return float(np.mean([np.linalg.norm(ask(a, b) - c, axis=-1).mean() for a, b, c in each]))


if __name__ == "__main__":
    main()
