"""Fig. 4 of the paper: one log map reaches half a unit, stitched ones go around a whole vessel.

    python examples/stitch.py [mesh or cloud] [--depth 6]

A picture is written to demo_output/stitch.png.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from riemlayer import ExpLogField
from riemlayer.data.load import load_shape, sample_mesh
from riemlayer.data.procedural import random_shape
from riemlayer.ops import Stitched, stitch_log
from riemlayer.viz import Drawing, viewpoint, write_png

UNREACHED = 1e3


def main() -> None:
    args = arguments()
    points = load(args.shape, 2_000 if args.fast else 12_000)
    surface = ExpLogField.from_pretrained(args.weights).encode(points)
    p = points[points[:, 2].argmax()]
    drawings = []
    for depth in (0, 1 if args.fast else args.depth):
        stitched = stitch_log(surface, p, points, depth)
        share, charts = float(stitched.covered.float().mean()), len(stitched.charts.centre)
        misfit = float(stitched.charts.misfit.max())
        print(f"{depth} rounds: {charts} charts, {share:.0%} of the points, misfit {misfit:.3f}")
        drawings.append(draw(points, p, stitched, f"{charts} chart{'s' * (charts > 1)}"))
    args.output.mkdir(parents=True, exist_ok=True)
    view = viewpoint(points, surface.frame(p)[:, 2] * outward(surface.frame(p)[:, 2], p, points))
    size = 240 if args.fast else 640
    print("picture:", write_png(args.output / "stitch.png", *drawings, view=view, size=size))


def draw(points: torch.Tensor, p: torch.Tensor, stitched: Stitched, title: str) -> Drawing:
    """The chart as tiles, and the centres of the charts it was made of."""
    log = torch.where(stitched.covered[:, None], stitched.coordinates, UNREACHED)
    centres = stitched.charts.centre
    return Drawing(points, log=log, p=p, dots=centres, radius=UNREACHED / 2, title=title)


def outward(normal: torch.Tensor, p: torch.Tensor, points: torch.Tensor) -> float:
    """The sign with which most of the shape lies behind the tangent plane."""
    return 1.0 if float(((points - p) @ normal).mean()) < 0 else -1.0


def load(path: Path | None, count: int) -> torch.Tensor:
    if path is not None:
        return torch.from_numpy(load_shape(path, count).points)
    shape = random_shape(1_000_003, "vessel")
    return torch.from_numpy(sample_mesh(shape.vertices, shape.faces, count).points)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("shape", nargs="?", type=Path, help="default: a procedural vessel")
    parser.add_argument("--depth", type=int, default=6, help="rounds of charts")
    parser.add_argument("--weights", default="base")
    parser.add_argument("--output", type=Path, default=Path("demo_output"))
    parser.add_argument("--fast", action="store_true", help="fewer points and one round")
    return parser.parse_args()


if __name__ == "__main__":
    main()
