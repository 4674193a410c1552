"""`riemlayer stitch` and `mean`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from riemlayer.cli.command import Answer, command
from riemlayer.cli.errors import UserError, blame
from riemlayer.cli.formats import Geometry
from riemlayer.cli.inputs import read_array
from riemlayer.cli.loaded import Encoding, Loaded, Where, coordinates, numbers
from riemlayer.cli.maps import PANEL, about, chart_result, reached_text, tile_colours
from riemlayer.cli.output import Output, Result
from riemlayer.cli.progress import stage

if TYPE_CHECKING:
    from riemlayer.cli.pictures import Scene

UNCOVERED = -1.0
"""Texture coordinates of points that no chart covers."""


def register(app: typer.Typer) -> None:
    """Adds the subcommands of this file."""
    command(app, "riemlayer stitch bunny.ply --source 0 --depth 6 -o atlas.obj", PANEL)(stitch)
    command(app, "riemlayer mean bunny.ply -p 3 -p 14 -p 15 -o mean.npz", PANEL)(mean)


def stitch(
    encoding: Encoding,
    where: Where,
    output: Output,
    depth: Annotated[int, typer.Option(help="Rounds of charts after the first.", min=0)] = 4,
    reach: Annotated[
        float | None,
        typer.Option("--radius", help="Of a chart, file's units; the trained one by default."),
    ] = None,
) -> Answer:
    """Log map far beyond the trained radius, from overlapping charts (Sec. 3.4).

    An .npz holds points, uv (n, 2), covered, confidence, frame, source, radius and the charts'
    centres, rotations, offsets and misfits; .ply and .obj carry uv scaled into the texture's
    square.
    """
    from riemlayer.ops import stitch_log

    output.check(encoding.shape)
    if reach is not None and not 0 < reach < np.inf:
        raise UserError(f"--radius must be positive, got {reach:g}")
    loaded = encoding.load()
    place = loaded.place(where)
    stage("stitching")
    cube_reach = None if reach is None else reach / loaded.scale
    with blame("--radius"):
        p = loaded.inward(place.point)
        atlas = stitch_log(loaded.surface, p, loaded.asked(), depth, cube_reach)
    n, charts = len(loaded.points), atlas.charts
    covered = atlas.covered[:n].cpu().numpy()
    uv = numbers(atlas.coordinates[:n]) * loaded.scale
    confidence = numbers(atlas.confidence[:n])
    arrays = {
        "points": loaded.points,
        "uv": uv,
        "covered": covered,
        "confidence": confidence,
        "frame": loaded.frame(place.point),
        "source": place.point,
        "radius": np.array(loaded.radius if reach is None else reach),
        "centres": loaded.outward(charts.centre),
        "rotations": numbers(charts.rotation),
        "offsets": numbers(charts.offset) * loaded.scale,
        "misfits": numbers(charts.misfit) * loaded.scale,
    }
    far = float(np.linalg.norm(uv[covered], axis=1).max(initial=loaded.radius)) * (1 + 1e-6)
    tiles = np.where(covered[:, None], uv, np.nan)
    geometry = Geometry(
        loaded.points,
        loaded.faces,
        uv=np.where(covered[:, None], 0.5 + uv / (2 * far), UNCOVERED),
        colours=tile_colours(tiles, far, loaded.radius / 5),
        scalars={"confidence": confidence},
    )

    def draw() -> Scene:
        from riemlayer.cli.pictures import scene

        note = f"{len(charts.centre)} charts around {place}."
        dots = loaded.outward(charts.centre)
        return scene(loaded, place.point, note, log=tiles, reach=far, dots=dots)

    output.write(Result(arrays, geometry, draw))
    facts = about(loaded, encoding, output, place) | {
        "points": len(uv),
        "covered": int(covered.sum()),
        "charts": len(charts.centre),
        "worst_misfit": float(arrays["misfits"].max()),
    }
    text = (
        f"{output.out}: {facts['charts']} charts around {place} cover {facts['covered']:,} of "
        f"{facts['points']:,} points, worst misfit {facts['worst_misfit']:.3g}"
    )
    return Answer(facts, text)


def mean(
    encoding: Encoding,
    output: Output,
    point: Annotated[
        list[int] | None,
        typer.Option(
            "--point", "-p", "--source", "-s", help="Index of a point to average; may be repeated."
        ),
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(metavar="X,Y,Z", help="Coordinates of one; may be repeated."),
    ] = None,
    among: Annotated[
        Path | None, typer.Option(help=".npy of (K,) indices or (K, 3) coordinates.")
    ] = None,
    masses: Annotated[Path | None, typer.Option(help=".npy of (K,) weights, not negative.")] = None,
) -> Answer:
    """Fréchet mean of points, and the log map from it.

    An .npz holds what `log` writes with the mean as its source, averaged (K, 3), variances (2,) and
    directions (3, 2) of the tangent principal axes. The mean is unique for points near each other.
    """
    from riemlayer.ops import tangent_pca

    output.check(encoding.shape, among, masses)
    wanted = [coordinates(text, "--at") for text in at or ()]
    listed = None if among is None else read_array(among)
    weights = None if masses is None else read_array(masses).astype(float).reshape(-1)
    loaded = encoding.load()
    places = [loaded.at_index(i, "--point") for i in point or ()]
    places += [loaded.at_point(x, "--at") for x in wanted]
    places += [] if listed is None else listed_places(loaded, listed, str(among))
    if not places:
        raise UserError("point: give --point INDEX, --at X,Y,Z or --among FILE.npy, at least once")
    q = np.stack([x.point for x in places])
    if weights is not None and (len(weights) != len(q) or (weights < 0).any() or not weights.sum()):
        raise UserError(f"{masses}: must hold {len(q)} weights, not negative and not all 0")
    stage("averaging")
    mass = None if weights is None else loaded.tensor(weights)
    answer = tangent_pca(loaded.surface, loaded.inward(q), mass)
    p = loaded.outward(answer.mean)
    more = {
        "averaged": q,
        "variances": numbers(answer.variances) * loaded.scale**2,
        "directions": numbers(answer.directions),
    }
    result, found = chart_result(loaded, p, f"Log map of the mean of {len(q)} points.", **more)
    output.write(result)
    facts = about(loaded, encoding, output) | found
    facts |= {"averaged": len(q), "mean": p.tolist(), "variances": more["variances"].tolist()}
    x = ", ".join(f"{value:.6g}" for value in p)
    text = f"{output.out}: mean of {len(q)} points at ({x}); {reached_text(found, loaded)}"
    return Answer(facts, text)


def listed_places(loaded: Loaded, listed: np.ndarray, name: str) -> list:
    """Places named by indices (K,), or by coordinates (K, 3)."""
    if listed.ndim == 1 and listed.dtype.kind in "iu":
        return [loaded.at_index(int(i), name) for i in listed]
    if listed.ndim == 2 and listed.shape[1] == 3:
        return [loaded.at_point(x, name) for x in listed.astype(float)]
    raise UserError(
        f"{name}: must hold (K,) whole numbers or (K, 3) coordinates, got {listed.shape}"
    )
