"""Geodesic k-means of a raw cloud: a centroidal Voronoi tessellation, and the mean of each cell.

    python examples/frechet_voronoi.py [mesh or cloud] [--cells 40]

A picture is written to demo_output/voronoi.png.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import torch

from riemlayer import ExpLogField
from riemlayer.data.load import load_shape, sample_mesh
from riemlayer.data.procedural import random_shape
from riemlayer.ops import frechet_mean, kmeans
from riemlayer.viz import Drawing, viewpoint, write_png


def main() -> None:
    args = arguments()
    points = load(args.shape, 2_000 if args.fast else 12_000)
    cells, steps = (8, 2) if args.fast else (args.cells, 10)
    with torch.inference_mode():
        surface = ExpLogField.from_pretrained(args.weights).encode(points)
        start = time.perf_counter()
        clusters = kmeans(surface, points, cells, steps=steps)
        seconds = time.perf_counter() - start
        spread = float(clusters.distance.square().mean().sqrt())
        sizes = clusters.label.bincount(minlength=cells)
        print(
            f"{cells} cells of {int(sizes.min())} to {int(sizes.max())} points in {seconds:.1f} s"
        )
        print(f"root mean square distance to the centre {spread:.3f}")
        largest = points[clusters.label == int(sizes.argmax())]
        mean = frechet_mean(surface, largest)
        gap = float(surface.dist(mean, clusters.centres).min())
        print(f"the Fréchet mean of the largest cell lies {gap:.3f} from a centre")
        normal = surface.normal(points[0])
    args.output.mkdir(parents=True, exist_ok=True)
    drawing = Drawing(points, colours=palette(cells)[clusters.label], dots=clusters.centres)
    view = viewpoint(points, normal)
    size = 240 if args.fast else 800
    print("picture:", write_png(args.output / "voronoi.png", drawing, view=view, size=size))


def palette(n: int) -> torch.Tensor:
    """(n, 3) colours that differ in hue and lightness."""
    i = torch.arange(n)
    hue = (i * 0.618034) % 1
    light = 0.45 + 0.4 * ((i * 0.381966) % 1)
    wheel = (hue[:, None] * 6 + torch.tensor([0.0, 4.0, 2.0])) % 6
    pure = ((wheel - 3).abs() - 1).clamp(0, 1)
    return light[:, None] * (0.4 + 0.6 * pure)


def load(path: Path | None, count: int) -> torch.Tensor:
    if path is not None:
        return torch.from_numpy(load_shape(path, count).points)
    shape = random_shape(1_000_002, "quadruped")
    return torch.from_numpy(sample_mesh(shape.vertices, shape.faces, count).points)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("shape", nargs="?", type=Path, help="default: a procedural animal")
    parser.add_argument("--cells", type=int, default=40)
    parser.add_argument("--weights", default="base")
    parser.add_argument("--output", type=Path, default=Path("demo_output"))
    parser.add_argument("--fast", action="store_true", help="fewer points and cells")
    return parser.parse_args()


if __name__ == "__main__":
    main()
