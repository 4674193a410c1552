"""How much the answers change where the cloud is turned, or shifted against the octree's grid.

    python -m benchmarks.motions [--weights base] [-n 24]

asks Exp and Log of procedural shapes that training never saw, moves the clouds, asks again, moves
the answers back, and writes motions.md and motions.json to benchmarks/results. Beside each change
stands the error of the answers, for scale: a field that knew everything would have neither.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import fmean

import torch
from torch import Tensor

from benchmarks.measure import write_results
from benchmarks.speed import RESULTS
from riemlayer import ExpLogField
from riemlayer.data.augment import rotation
from riemlayer.tables.evaluate import Shape
from riemlayer.tables.render import markdown
from riemlayer.tables.shapes import procedural_shapes

SMALLER = 0.9
"""Size in the cube that leaves room for shifts."""
RADII = (0.5, 0.1)
COLUMNS = ("Exp changes by", "error of Exp", "Log changes by", "error of Log")


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--weights", default="base", help="name or folder of the field's weights")
    parser.add_argument("-n", type=int, default=24, help="shapes (default 24)")
    parser.add_argument("--sources", type=int, default=5, help="sources a shape (default 5)")
    parser.add_argument("--moves", type=int, default=3, help="of each kind a shape (default 3)")
    parser.add_argument("-o", "--out", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    field = ExpLogField.from_pretrained(options.weights).eval()
    with tempfile.TemporaryDirectory() as folder:
        made = procedural_shapes(options.n, folder, sources=options.sources)
        shapes = [Shape.load(path) for path in sorted(Path(folder).glob("*/*.npz"))]
    rows = {
        name: averaged([row for shape in shapes for row in move(field, shape, options.moves)])
        for name, move in MOVES.items()
    }
    facts = {"shapes": len(shapes), "failed": made.failures, "weights": options.weights}
    facts |= {"sources": options.sources, "moves": options.moves}
    write_results(options.out, "motions", facts | {"rows": rows}, table(rows))


@torch.inference_mode()
def turned(field: ExpLogField, shape: Shape, times: int) -> Iterator[dict[str, list[float]]]:
    """Changes and errors under rotations drawn at random, each encoded as a user would."""
    points, p, v, q = queries(shape)
    surface = field.encode(points)
    own = surface.exp(p, v), surface.log(p, q)
    generator = torch.Generator().manual_seed(len(points))
    for _ in range(times):
        turn = rotation(1.0, generator)
        there = field.encode(points @ turn.T)
        found = there.exp(p @ turn.T, v @ turn.T), there.log(p @ turn.T, q @ turn.T)
        yield compared(shape, own, (found[0] @ turn, found[1] @ turn), (q, v))


@torch.inference_mode()
def shifted(field: ExpLogField, shape: Shape, times: int) -> Iterator[dict[str, list[float]]]:
    """Changes and errors under shifts of up to a leaf along each axis, in the cube."""
    points, p, v, q = (SMALLER * x for x in queries(shape))
    shape_of = torch.zeros(len(points), dtype=torch.long)
    surface = field.encode_in_cube(points, shape_of)
    own = surface.exp(p, v) / SMALLER, surface.log(p, q) / SMALLER
    generator = torch.Generator().manual_seed(len(points))
    leaf = 2 / 2**field.config.backbone.depth
    for _ in range(times):
        shift = leaf * (2 * torch.rand(3, generator=generator) - 1)
        there = field.encode_in_cube(points + shift, shape_of)
        found = there.exp(p + shift, v) - shift, there.log(p + shift, q + shift)
        again = found[0] / SMALLER, found[1] / SMALLER
        yield compared(shape, own, again, (q / SMALLER, v / SMALLER))


MOVES: dict[str, Callable[[ExpLogField, Shape, int], Iterator[dict[str, list[float]]]]] = {
    "turned at random": turned,
    "shifted by up to a leaf": shifted,
}


def queries(shape: Shape) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Points (N, 3), sources (S, 1, 3), tangent vectors and where they lead (S, K, 3)."""
    p = shape.V[shape.src][:, None]
    points, p, v, q = (torch.from_numpy(x).float() for x in (shape.points, p, shape.vec, shape.end))
    return points, p, v, q


def compared(
    shape: Shape,
    own: tuple[Tensor, Tensor],
    moved: tuple[Tensor, Tensor],
    truth: tuple[Tensor, Tensor],
) -> dict[str, list[float]]:
    """Per radius the means of `COLUMNS`, in the unit of a shape scaled to [-1, 1]."""
    length, known = torch.from_numpy(shape.vec).norm(dim=-1), torch.from_numpy(shape.ok)
    pairs = [pair for i in (0, 1) for pair in ((own[i], moved[i]), (moved[i], truth[i]))]
    apart = torch.stack([(x - y).norm(dim=-1) for x, y in pairs])
    return {str(r): apart[:, known & (length < r)].mean(-1).tolist() for r in RADII}


def averaged(rows: list[dict[str, list[float]]]) -> dict[str, list[float]]:
    """Their means."""
    return {k: [fmean(x) for x in zip(*(row[k] for row in rows), strict=True)] for k in rows[0]}


def table(rows: dict[str, dict[str, list[float]]]) -> str:
    """As Markdown."""
    return markdown(
        ("the cloud is", "within", *COLUMNS),
        [
            (name, radius, *(f"{x:.4f}" for x in numbers))
            for name, row in rows.items()
            for radius, numbers in row.items()
        ],
    )


if __name__ == "__main__":
    main()
