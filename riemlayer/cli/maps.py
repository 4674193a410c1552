"""`riemlayer log`, `exp` and `geodesic`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from riemlayer.cli.command import Answer, command
from riemlayer.cli.errors import UserError
from riemlayer.cli.formats import Geometry
from riemlayer.cli.inputs import read_vectors
from riemlayer.cli.loaded import Array, Encoding, Loaded, Map, Place, Where, coordinates
from riemlayer.cli.output import Output, Result

if TYPE_CHECKING:
    from riemlayer.cli.pictures import Scene

PANEL = "Maps of a shape"
RAYS, RINGS = 24, 8
"""Directions and lengths of the fan that `exp` shoots where no vectors are given."""
LONGEST = 100.0
"""Longer vectors, in trained radii, are refused."""
MOST_PATHS = 200
"""Geodesics drawn."""
SAMPLES = 25
"""Points of a drawn geodesic."""


def chart(loaded: Loaded, p: Array) -> tuple[Map, Array, Array]:
    """Log_p of all points of a shape, its tangent coordinates (n, 2) and distances (n,)."""
    log = loaded.log(p, loaded.points)
    uv = log.value @ loaded.frame(p)[:, :2]
    return log, uv, loaded.distance(p, loaded.points, log)


def chart_result(loaded: Loaded, p: Array, note: str, **more: np.ndarray) -> tuple[Result, dict]:
    """A log map in every form, and facts about it; `more` are further arrays of the .npz."""
    log, uv, distance = chart(loaded, p)
    reached = log.valid & (distance <= loaded.radius)
    arrays = {
        "points": loaded.points,
        "log": log.value,
        "uv": uv,
        "distance": distance,
        "validity": log.validity,
        "valid": log.valid,
        "frame": loaded.frame(p),
        "source": p,
        "radius": np.array(loaded.radius),
    }
    texture = 0.5 + uv / (2 * loaded.radius)
    tiles = np.where(reached[:, None], uv, np.nan)
    geometry = Geometry(
        loaded.points,
        loaded.faces,
        uv=texture,
        colours=tile_colours(tiles, loaded.radius),
        scalars={"distance": distance, "validity": log.validity},
    )

    def draw() -> Scene:
        from riemlayer.cli.pictures import log_scene

        return log_scene(loaded, p, note)

    facts = {"points": len(uv), "within_reach": int(reached.sum())}
    return Result(arrays | more, geometry, draw), facts


def tile_colours(uv: Array, radius: float, period: float | None = None) -> Array:
    """(n, 3) colours of a checkerboard, ten tiles a diameter; plain beyond and where uv is NaN."""
    from riemlayer.viz import checkerboard

    period = radius / 5 if period is None else period
    return checkerboard(np.nan_to_num(uv, nan=10 * radius), period, radius)


def about(loaded: Loaded, encoding: Encoding, output: Output, place: Place | None = None) -> dict:
    """Facts that all answers about a shape begin with."""
    facts = {"shape": str(loaded.path), "out": str(output.out), "weights": encoding.weights}
    facts |= {"radius": loaded.radius}
    return facts if place is None else facts | {"source": place.facts()}


def reached_text(facts: dict, loaded: Loaded) -> str:
    """How far a log map reaches, for people."""
    kind = "points" if loaded.faces is None else "vertices"
    return (
        f"{facts['within_reach']:,} of {facts['points']:,} {kind} within reach "
        f"(trained radius {loaded.radius:.4g} in the file's unit)"
    )


def register(app: typer.Typer) -> None:
    """Adds the subcommands of this file."""
    command(app, "riemlayer log bunny.ply --source 0 -o log.npz", PANEL)(log)
    command(app, "riemlayer exp bunny.ply --source 0 --vectors v.npy -o out.ply", PANEL)(exp)
    command(app, "riemlayer geodesic bunny.ply --source 0 --target 90 -o path.ply", PANEL)(geodesic)


def log(encoding: Encoding, where: Where, output: Output) -> Answer:
    """Log map of all points from one source: tangent vectors that lead to them.

    An .npz holds points, log (n, 3), uv (n, 2) in the source's frame, distance, validity (the
    probability that a point lies before the cut locus), valid (whether to believe the answer),
    frame, source and radius, in the order and units of the file. In .ply and .obj the trained disc
    fills the texture's square.
    """
    output.check(encoding.shape)
    loaded = encoding.load()
    place = loaded.place(where)
    result, found = chart_result(loaded, place.point, f"Log map of {place}.")
    output.write(result)
    facts = about(loaded, encoding, output, place) | found
    return Answer(facts, f"{output.out}: log map of {place}; {reached_text(found, loaded)}")


Vectors = Annotated[
    Path | None,
    typer.Option(
        help="Tangent vectors, .npy of (K, 3), or (K, 2) in the frame that log writes; "
        "file's units. A fan where none are given.",
        show_default=False,
    ),
]


def exp(
    encoding: Encoding,
    where: Where,
    output: Output,
    vectors: Vectors = None,
) -> Answer:
    """Exponential map: where geodesics from one source end.

    An .npz holds vectors (K, 3), uv (K, 2), points (K, 3) where they end, validity, frame, source
    and radius; .ply and .obj hold the K end points; .png and .html show the geodesics.
    """
    output.check(encoding.shape, vectors)
    x = None if vectors is None else read_vectors(vectors)
    loaded = encoding.load()
    place = loaded.place(where)
    frame = loaded.frame(place.point)
    axes = frame[:, :2]
    if x is None:
        x = fan(loaded.radius)
    v = x @ axes.T if x.shape[1] == 2 else x
    check_length(v, loaded.radius, vectors)
    end, uv = loaded.exp(place.point, v), v @ axes
    beyond = int((np.linalg.norm(v, axis=1) > loaded.radius * (1 + 1e-6)).sum())
    arrays = {
        "vectors": v,
        "uv": uv,
        "points": end.value,
        "validity": end.validity,
        "frame": frame,
        "source": place.point,
        "radius": np.array(loaded.radius),
    }
    geometry = Geometry(
        end.value,
        uv=0.5 + uv / (2 * loaded.radius),
        colours=tile_colours(uv, loaded.radius),
        scalars={"validity": end.validity},
    )

    def draw() -> Scene:
        from riemlayer.cli.pictures import scene

        shown = v[-RAYS:] if vectors is None else v[:MOST_PATHS]
        return scene(
            loaded, place.point, f"Exp of {place}.", paths=exp_paths(loaded, place.point, shown)
        )

    output.write(Result(arrays, geometry, draw))
    facts = about(loaded, encoding, output, place) | {"vectors": len(v), "beyond_radius": beyond}
    text = f"{output.out}: {len(v):,} end points of geodesics from {place}"
    if beyond:
        text += f"; {beyond:,} longer than the trained radius {loaded.radius:.4g}: less reliable"
    return Answer(facts, text)


def check_length(v: Array, radius: float, path: Path | None) -> None:
    """Refuses vectors (K, 3) that are likely in another unit than the shape."""
    longest = np.abs(v).max()
    if longest > LONGEST * radius:
        raise UserError(
            f"{path}: must hold vectors up to {LONGEST:g} trained radii ({radius:.4g}), got one of "
            f"{longest:.4g}; are they in the file's unit?"
        )


def exp_paths(loaded: Loaded, p: Array, v: Array) -> Array:
    """Geodesics (K, SAMPLES, 3) from p (3,) along v (K, 3)."""
    steps = np.linspace(0, 1, SAMPLES)[:, None] * v[:, None]  # (K, SAMPLES, 3)
    return loaded.exp(p, steps.reshape(-1, 3)).value.reshape(steps.shape)


def fan_paths(loaded: Loaded, p: Array) -> Array:
    """Geodesics (RAYS, SAMPLES, 3) of the trained radius, all around p (3,)."""
    return exp_paths(loaded, p, fan(loaded.radius)[-RAYS:] @ loaded.frame(p)[:, :2].T)


def fan(radius: float) -> Array:
    """(RINGS * RAYS, 2) tangent coordinates of a polar grid, the outermost ring last."""
    angle = np.linspace(0, 2 * np.pi, RAYS, endpoint=False)
    length = np.linspace(0, radius, RINGS + 1)[1:, None, None]
    return (length * np.stack((np.cos(angle), np.sin(angle)), -1)).reshape(-1, 2)


def geodesic(
    encoding: Encoding,
    where: Where,
    output: Output,
    target: Annotated[
        list[int] | None, typer.Option(help="Index of an end; may be repeated.", show_default=False)
    ] = None,
    to: Annotated[
        list[str] | None,
        typer.Option(metavar="X,Y,Z", help="Coordinates of an end; may be repeated."),
    ] = None,
    samples: Annotated[int, typer.Option(help="Points of each geodesic.", min=2)] = 50,
) -> Answer:
    """Geodesics from one source to one or several ends.

    An .npz holds paths (K, samples, 3), length (K,), validity (K,), valid (K,), source, targets
    (K, 3) and radius; .ply and .obj hold the polylines.
    """
    output.check(encoding.shape)
    if not (target or to):
        raise UserError("target: give --target INDEX or --to X,Y,Z, once or more often")
    ends = [coordinates(text, "--to") for text in to or ()]
    loaded = encoding.load()
    place = loaded.place(where)
    places = [loaded.at_index(i, "--target") for i in target or ()]
    places += [loaded.at_point(x, "--to") for x in ends]
    q = np.stack([x.point for x in places])
    paths, length, log = geodesics(loaded, place.point, q, samples)
    k = len(q)
    arrays = {
        "paths": paths,
        "length": length,
        "validity": log.validity,
        "valid": log.valid,
        "source": place.point,
        "targets": q,
        "radius": np.array(loaded.radius),
    }
    along = np.tile(np.linspace(0, 1, samples), k)
    geometry = Geometry(
        paths.reshape(-1, 3),
        lines=list(np.arange(k * samples).reshape(k, samples)),
        uv=np.stack((along, np.repeat((np.arange(k) + 0.5) / k, samples)), 1),
    )

    def draw() -> Scene:
        from riemlayer.cli.pictures import scene

        note = f"{k} geodesics from {place}."
        return scene(loaded, place.point, note, paths=paths[:MOST_PATHS])

    output.write(Result(arrays, geometry, draw))
    beyond = int((length > loaded.radius * (1 + 1e-6)).sum())
    facts = about(loaded, encoding, output, place) | {
        "targets": [x.facts() for x in places],
        "length": length.tolist(),
        "valid": log.valid.tolist(),
        "beyond_radius": beyond,
    }
    lengths = ", ".join(f"{x:.6g}" for x in length[:8]) + " ..." * (k > 8)
    text = f"{output.out}: from {place}, {'geodesic' if k == 1 else 'geodesics'} {lengths} long"
    doubtful = int((~log.valid | (length > loaded.radius)).sum())
    if doubtful:
        text += (
            f"; {doubtful} not to be relied on: beyond the trained radius {loaded.radius:.4g}, "
            "past the cut locus or across a gap"
        )
    return Answer(facts, text)


def geodesics(loaded: Loaded, p: Array, q: Array, samples: int) -> tuple[Array, Array, Map]:
    """Paths (K, samples, 3) from p (3,) to q (K, 3), their lengths (K,) and Log_p(q)."""
    import torch

    t = torch.linspace(0, 1, samples)
    p_, q_ = loaded.inward(p), loaded.inward(q)
    paths = loaded.surface.geodesic(p_, q_[:, None], t.to(q_))
    log = loaded.log(p, q)
    return loaded.outward(paths), loaded.distance(p, q, log), log
