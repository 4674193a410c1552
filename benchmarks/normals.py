"""What oriented normals of the points are worth on thin shapes.

    python -m benchmarks.normals [--weights base] [-n 24]
    python -m benchmarks.normals --told DIR --untold DIR

evaluates the field on procedural thin shapes (hands, sheets, spectacles, ...), once as it is and
once with the mesh's vertex normals handed to `encode`, and writes normals.md and normals.json to
benchmarks/results. The second form adds two fields that were trained alike, one of the preset
`base-normals`, whose network is told the normals too, and one of `base`.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch

from benchmarks.measure import write_results
from benchmarks.speed import RESULTS
from riemlayer import ExpLogField
from riemlayer.baselines import Neural
from riemlayer.data.manifold import vertex_normals
from riemlayer.tables.__main__ import THIN
from riemlayer.tables.evaluate import Shape, evaluate, pool, summarise
from riemlayer.tables.shapes import procedural_shapes

MASKS = ("r0.5", "r0.5_tight", "r0.25", "r0.1")
COLUMNS = {"mdd_clip": "E_MDD, clipped", "angle": "E_angle", "log_end": "Log end", "exp": "E_Exp"}


class WithNormals(Neural):
    """The field on a mesh's vertices, told their normals."""

    def prepare_mesh(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        """Encode the vertices with their normals."""
        normals = vertex_normals(vertices.astype(float), faces)
        normals[np.linalg.norm(normals, axis=1) < 0.5] = (0, 0, 1)  # faces folded flat give none
        points, normals = (torch.from_numpy(x.astype(np.float32)) for x in (vertices, normals))
        with torch.inference_mode():
            self._surface = self._field.eval().encode(points, normals=normals)


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--weights", default="base", help="name or folder of the field's weights")
    parser.add_argument("--told", help="weights of the preset base-normals")
    parser.add_argument("--untold", help="weights of base, trained alike")
    parser.add_argument("-n", type=int, default=24, help="shapes (default 24)")
    parser.add_argument("--sources", type=int, default=5, help="sources a shape (default 5)")
    parser.add_argument("-o", "--out", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    field = ExpLogField.from_pretrained(options.weights)
    systems: dict[str, Callable[[], Neural]] = {
        "points alone": partial(Neural, field),
        "points and normals": partial(WithNormals, field),
    }
    if options.untold:
        trained = ExpLogField.from_pretrained(options.untold)
        systems["`base` trained alike, points alone"] = partial(Neural, trained)
        systems["`base` trained alike, points and normals"] = partial(WithNormals, trained)
    if options.told:
        told = ExpLogField.from_pretrained(options.told)
        systems["`base-normals`"] = partial(WithNormals, told)
    with tempfile.TemporaryDirectory() as folder:
        made = procedural_shapes(
            options.n, folder, kinds=THIN, group="thin", sources=options.sources
        )
        shapes = [Shape.load(path) for path in sorted(Path(folder).glob("thin/*.npz"))]
    rows = {
        name: summarise(pool([evaluate(system(), shape) for shape in shapes]))
        for name, system in systems.items()
    }
    lines = ["| mask | input | " + " | ".join(COLUMNS.values()) + " |", "|---" * 6 + "|"]
    for mask in MASKS:
        for name, row in rows.items():
            numbers = " | ".join(
                f"{row[mask][key]:.{2 if key == 'angle' else 4}f}" for key in COLUMNS
            )
            lines.append(f"| {mask} | {name} | {numbers} |")
    facts = {"shapes": len(shapes), "failed": made.failures, "weights": options.weights}
    write_results(options.out, "normals", facts | {"rows": rows}, "\n".join(lines))


if __name__ == "__main__":
    main()
