"""Fig. 8 of the paper: where normals turn, projection on the tangent plane stretches, Log less so.

    python examples/projection_fails.py [mesh]

Prints the errors of both against traced geodesics, by the angle between the normals at their two
ends, and writes a picture of a source around which normals turn much to
demo_output/projection_fails.png.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from riemlayer.baselines import MeshHeat, Neural, Projection
from riemlayer.data.ground_truth import shape_ground_truth
from riemlayer.data.load import load_shape, sample_mesh
from riemlayer.data.manifold import vertex_normals
from riemlayer.data.procedural import random_shape
from riemlayer.viz import Canvas, Drawing, tangent_coordinates, viewpoint, write_png

KIND, SEED = "gadget", 1_000_001  # training takes its seeds from 0 on
RADIUS = 0.5  # of the tangent disc, for a shape scaled to [-1, 1]
TURNS = (0, 30, 60, 90, 180)
"""Bins of the angle between two normals, in degrees."""


def main() -> None:
    args = arguments()
    points, vertices, faces = load(args.shape, 2_000 if args.fast else 10_000)
    sources, queries = (4, 60) if args.fast else (24, 400)
    truth = shape_ground_truth(vertices, faces, 0, sources, queries)
    methods = {"projection": Projection(), "riemlayer": Neural.from_pretrained(args.weights)}
    for method in methods.values():
        method.prepare(points)

    normals = vertex_normals(vertices, faces)
    turned = angles(vertices, normals, truth)
    valid = truth["complete"] & truth["shortest"] & (truth["divergence"] < RADIUS)
    print_table(methods, truth, turned, valid)

    offset = vertices - truth["p"][:, None]
    behind = ((offset * truth["normal"][:, None]).sum(-1) <= 0).mean(1)  # so that it is in view
    chosen = int((behind * np.where(valid, turned, 0).mean(1)).argmax())
    p, normal = truth["p"][chosen], truth["normal"][chosen]
    heat = MeshHeat()
    heat.prepare_mesh(vertices, faces)
    titles = {"projection": "tangent projection", "riemlayer": "riemlayer, from the raw cloud"}
    canvas = Canvas(vertices, faces)
    drawings = [
        draw(canvas, method.log(p, vertices), p, normal, titles[name])
        for name, method in methods.items()
    ]
    exact = heat.log(p, vertices)
    drawings.append(draw(canvas, exact, p, normal, "truth, from the mesh"))
    args.output.mkdir(parents=True, exist_ok=True)
    path = write_png(
        args.output / "projection_fails.png",
        *drawings,
        view=viewpoint(vertices, normal),
        size=240 if args.fast else 640,
    )
    print("picture:", path)


def angles(vertices: np.ndarray, normals: np.ndarray, truth: dict) -> np.ndarray:
    """Degrees (S, K) between the normals at both ends of each geodesic."""
    from scipy.spatial import KDTree

    nearest = KDTree(vertices).query(truth["q"])[1]
    cosine = (normals[nearest] * truth["normal"][:, None]).sum(-1)
    return np.degrees(np.arccos(cosine.clip(-1, 1)))


def print_table(methods: dict, truth: dict, turned: np.ndarray, valid: np.ndarray) -> None:
    """Mean |Log_p(q) - v| of each method, by how far normals turn between p and q."""
    print(f"{'normals turn by':20}{'geodesics':>12}" + "".join(f"{name:>14}" for name in methods))
    errors = {}
    for name, method in methods.items():
        logs = [method.log(p, q) for p, q in zip(truth["p"], truth["q"], strict=True)]
        errors[name] = np.linalg.norm(np.stack(logs) - truth["v"], axis=-1)
    for low, high in pairwise(TURNS):
        rows = valid & (turned >= low) & (turned < high)
        if rows.any():
            means = "".join(f"{error[rows].mean():14.4f}" for error in errors.values())
            print(f"{f'{low} to {high} degrees':20}{rows.sum():12,}{means}")


def draw(canvas: Canvas, log: np.ndarray, p: np.ndarray, normal: np.ndarray, title: str) -> Drawing:
    """Tiles of a log map on the mesh, but where the chord alone is longer than the radius."""
    near = np.linalg.norm(canvas.points - p, axis=1) <= RADIUS
    flat = tangent_coordinates(log, normal)
    return Drawing(canvas, log=flat, valid=near, p=p, radius=RADIUS, title=title)


def load(path: Path | None, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A raw cloud, and the vertices and faces that it was sampled from."""
    if path is not None:
        shape = load_shape(path, count)
    else:
        made = random_shape(SEED, KIND)
        shape = sample_mesh(made.vertices, made.faces, count)
    if shape.vertices is None or shape.faces is None:
        raise SystemExit(f"{path}: must be a mesh: a cloud alone has no truth to compare with")
    return shape.points, shape.vertices, shape.faces


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Where normals turn, projection stretches.")
    parser.add_argument("shape", nargs="?", type=Path, help="default: a procedural one")
    parser.add_argument("--weights", default="base")
    parser.add_argument("--output", type=Path, default=Path("demo_output"))
    parser.add_argument("--fast", action="store_true", help="fewer points and sources")
    return parser.parse_args()


if __name__ == "__main__":
    torch.set_grad_enabled(False)
    main()
