"""From a raw point cloud to Exp and Log: encode once, ask from any source, compare with the truth.

    python examples/quickstart.py              a procedural shape
    python examples/quickstart.py mine.obj     a mesh (.obj .off .ply .stl .glb .npz) of your own
    python examples/quickstart.py mine.xyz     a cloud (.xyz .ply .npz), which has no truth

A picture and a page to turn are written to demo_output/.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch

from riemlayer import EncodedSurface, ExpLogField
from riemlayer.baselines import Heat, MeshHeat, MeshTracer, Neural, Projection, Walking
from riemlayer.data.ground_truth import shape_ground_truth
from riemlayer.data.load import LoadedShape, load_shape, sample_mesh
from riemlayer.data.procedural import random_shape
from riemlayer.viz import (
    Drawing,
    tangent_coordinates,
    tangent_frame,
    viewpoint,
    write_html,
    write_png,
)

KIND, SEED = "toy", 1_000_002  # training takes its seeds from 0 on
RADIUS = 0.5  # of the tangent disc, for a shape scaled to [-1, 1]


def main() -> None:
    args = arguments()
    name = args.shape.stem if args.shape else KIND
    shape = load(args.shape, count=2_000 if args.fast else 10_000)
    sources, queries = (2, 100) if args.fast else (8, 400)

    points = torch.from_numpy(shape.points)
    field = ExpLogField.from_pretrained(args.weights)
    with torch.inference_mode():
        surface = field.encode(points)
        if shape.faces is None:
            print(f"{name}: {len(points):,} points, no faces, so no ground truth to compare with")
            p, normal = cloud_sources(shape, sources)
        else:
            truth = shape_ground_truth(shape.vertices, shape.faces, 0, sources, queries)
            p, normal = truth["p"], truth["normal"]
            print_table(name, shape, truth, field)
        best = most_in_view(shape.points, p, normal)
        drawings = draw(surface, shape, p[best], normal[best])

    view = viewpoint(shape.points, normal[best])
    args.output.mkdir(parents=True, exist_ok=True)
    size = 240 if args.fast else 640
    png = write_png(args.output / f"{name}.png", *drawings, view=view, size=size)
    note = "Blue and cream tiles: the log map of the black point. Orange: geodesics by Exp."
    html = write_html(args.output / f"{name}.html", *drawings, view=view, title=name, note=note)
    print(f"\npicture: {png}\npage to turn: {html}  (open it in a browser; it needs no network)")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "shape", nargs="?", type=Path, help="mesh or cloud; default: a procedural one"
    )
    parser.add_argument("--weights", default="base", help="packaged name, directory or hub id")
    parser.add_argument("--output", type=Path, default=Path("demo_output"))
    parser.add_argument("--fast", action="store_true", help="fewer points and sources")
    return parser.parse_args()


def load(path: Path | None, count: int) -> LoadedShape:
    if path is None:
        shape = random_shape(SEED, KIND)
        return sample_mesh(shape.vertices, shape.faces, count)
    try:
        return load_shape(path, count)
    except (ValueError, OSError) as error:
        sys.exit(f"quickstart: {error}")


def print_table(name: str, shape: LoadedShape, truth: dict, field: ExpLogField) -> None:
    """Times and mean errors of every method on the same cloud, sources and geodesics."""
    valid = truth["complete"] & truth["shortest"] & (truth["divergence"] < RADIUS)
    sources, queries = valid.shape
    count = len(shape.points)
    print(
        f"{name}: {count:,} raw points in [-1, 1]^3; {sources} sources, {valid.sum():,} geodesics"
    )
    print(f"up to {RADIUS} long that are shortest; error = mean distance to the traced truth\n")
    log, exp = f"Log of {count:,}", f"Exp of {queries}"
    print(f"{'':26}{'set-up':>11}{log:>15}{'error':>9}{exp:>15}{'error':>9}")
    for label, method in {
        "riemlayer": Neural(field),
        "tangent projection": Projection(),
        "heat method on the cloud": Heat(),
        "tracing on the cloud": Walking(),
    }.items():
        row = f"{label:26}{milliseconds(partial(method.prepare, shape.points)):>11}"
        for ask, given, wanted, every in (
            (getattr(method, "log", None), truth["q"], truth["v"], shape.points),
            (getattr(method, "exp", None), truth["v"], truth["q"], truth["v"][0]),
        ):
            if ask is None:
                row += f"{'-':>15}{'-':>9}"
                continue
            answers = np.stack([ask(p, x) for p, x in zip(truth["p"], given, strict=True)])
            error = np.linalg.norm(answers - wanted, axis=-1)[valid].mean()
            row += f"{milliseconds(partial(ask, truth['p'][0], every)):>15}{error:9.4f}"
        print(row)


def milliseconds(run: Callable[[], object]) -> str:
    """The faster of two runs: the first one pays for what is set up once a process."""
    times = []
    for _ in range(2):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return f"{1e3 * min(times):.1f} ms"


def cloud_sources(shape: LoadedShape, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Random points and their normals, with most of the shape behind them."""
    index = np.random.default_rng(0).choice(len(shape.points), count, replace=False)
    p, normal = shape.points[index], Drawing(shape.points).normals[index]
    above = (((shape.points - p[:, None]) * normal[:, None]).sum(-1) > 0).mean(1)
    return p, np.where(above[:, None] > 0.5, -normal, normal)


def most_in_view(points: np.ndarray, p: np.ndarray, normal: np.ndarray) -> int:
    """The source with much surface within reach, and most of the shape behind it."""
    offset = points - p[:, None]
    behind = ((offset * normal[:, None]).sum(-1) <= 0).mean(1)
    within = (np.linalg.norm(offset, axis=-1) < RADIUS).mean(1)
    return int((within * behind).argmax())


def draw(surface: EncodedSurface, shape: LoadedShape, p: np.ndarray, normal: np.ndarray) -> list:
    """Exp as a fan of geodesics, Log as a checkerboard, and the true Log where it is known."""
    canvas = shape.points if shape.faces is None else shape.vertices
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rays = RADIUS * np.stack([np.cos(angle), np.sin(angle)], 1) @ tangent_frame(normal)
    v = np.linspace(0, 1, 25)[:, None] * rays[:, None]  # (24, 25, 3)
    source = torch.from_numpy(p)
    paths = surface.exp(source, torch.from_numpy(v).float())
    log, info = surface.log(source, torch.from_numpy(canvas).float(), return_info=True)
    log = torch.where(info.validity[:, None] > 0.5, log, 10 * RADIUS)

    def checkered(values, title: str) -> Drawing:
        away = np.linalg.norm(canvas - p, axis=1) > 1.1 * RADIUS  # and the geodesic is longer still
        flat = np.where(away[:, None], 10 * RADIUS, tangent_coordinates(values, normal))
        return Drawing(canvas, shape.faces, log=flat, p=p, radius=RADIUS, title=title)

    if shape.faces is None:
        return [Drawing(canvas, p=p, paths=paths, title="Exp"), checkered(log, "Log")]
    tracer, heat = MeshTracer(), MeshHeat()
    tracer.prepare_mesh(shape.vertices, shape.faces)
    heat.prepare_mesh(shape.vertices, shape.faces)
    true_paths = tracer.exp(p, v.reshape(-1, 3)).reshape(v.shape)
    fan = Drawing(
        canvas, shape.faces, p=p, dots=shape.points, paths=paths, reference=true_paths,
        title="Exp from the raw cloud (dots); black: truth",
    )  # fmt: skip
    return [
        fan,
        checkered(log, "Log from the raw cloud"),
        checkered(heat.log(p, canvas), "Log, truth from the mesh"),
    ]


if __name__ == "__main__":
    main()
