"""A picture stuck onto a raw point cloud: UV coordinates from a log map, no mesh, no unwrapping.

    python examples/decal.py [mesh or cloud] [--size 0.7]

The picture is a drawn face; the result is written to demo_output/decal.png.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from torch import Tensor

from riemlayer import ExpLogField
from riemlayer.data.load import load_shape, sample_mesh
from riemlayer.data.procedural import random_shape
from riemlayer.ops import decal
from riemlayer.viz import Drawing, viewpoint, write_png

GREY = 0.8


def main() -> None:
    args = arguments()
    count = 3_000 if args.fast else 15_000
    points, canvas = load(args.shape, count, 4 * count)
    surface = ExpLogField.from_pretrained(args.weights).encode(points)
    p = points[points[:, 2].argmax()]
    answer = decal(surface, p, torch.tensor([0.0, 1.0, 0.1]), args.size, canvas)
    colours = torch.full_like(canvas, GREY)
    colours[answer.inside] = smiley(answer.uv[answer.inside])
    print(f"{int(answer.inside.sum()):,} of {len(canvas):,} points are under the picture")
    normal = surface.frame(p)[:, 2]
    normal = normal if float(((points - p) @ normal).mean()) < 0 else -normal
    args.output.mkdir(parents=True, exist_ok=True)
    path = write_png(
        args.output / "decal.png",
        Drawing(canvas, colours=colours, title="decal"),
        view=viewpoint(canvas, normal, tilt=0.3),
        size=240 if args.fast else 800,
    )
    print("picture:", path)


def smiley(uv: Tensor) -> Tensor:
    """Colours (N, 3) of a drawn face at texture coordinates (N, 2)."""
    x, y = (2 * uv - 1).unbind(-1)
    r = (x * x + y * y).sqrt()
    eye = ((x.abs() - 0.33) ** 2 + 0.5 * (y - 0.3) ** 2).sqrt() < 0.12
    mouth = ((r - 0.58).abs() < 0.06) & (y < -0.15)
    paint = torch.tensor([[0.8, 0.8, 0.8], [1.0, 0.8, 0.1], [0.1, 0.1, 0.1]])
    dark = eye | mouth | ((r > 0.88) & (r < 0.95))
    return paint[torch.where(dark, 2, (r < 0.95).long())]


def load(path: Path | None, count: int, dense: int) -> tuple[Tensor, Tensor]:
    """The raw cloud that is encoded, and a denser one of the same surface to paint."""
    if path is not None:
        points = torch.from_numpy(load_shape(path, dense).points)
    else:
        shape = random_shape(1_000_003, "vessel")
        points = torch.from_numpy(sample_mesh(shape.vertices, shape.faces, dense).points)
    order = torch.randperm(len(points), generator=torch.Generator().manual_seed(0))
    return points[order[:count]], points


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("shape", nargs="?", type=Path, help="default: a procedural vessel")
    parser.add_argument("--size", type=float, default=0.7, help="side of the picture")
    parser.add_argument("--weights", default="base")
    parser.add_argument("--output", type=Path, default=Path("demo_output"))
    parser.add_argument("--fast", action="store_true", help="fewer points")
    return parser.parse_args()


if __name__ == "__main__":
    main()
