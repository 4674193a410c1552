"""`riemlayer stitch`, `decal` and `mean`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from riemlayer.cli.command import Answer, command
from riemlayer.cli.errors import UserError, blame
from riemlayer.cli.formats import Geometry
from riemlayer.cli.inputs import read_array, read_image
from riemlayer.cli.loaded import Array, Encoding, Loaded, Where, coordinates
from riemlayer.cli.maps import PANEL, about, chart_result, reached_text, tile_colours
from riemlayer.cli.output import Output, Result
from riemlayer.cli.progress import stage

UNCOVERED = -1.0
"""Texture coordinates of points that no chart covers."""


def register(app: typer.Typer) -> None:
    """Adds the subcommands of this file."""
    command(app, "riemlayer stitch bunny.ply --source 0 --depth 6 -o atlas.obj", PANEL)(stitch)
    command(app, "riemlayer decal bunny.ply --source 0 --image cat.png -o cat.ply", PANEL)(decal)
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

    def draw():
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


def decal(
    encoding: Encoding,
    where: Where,
    output: Output,
    size: Annotated[
        float | None,
        typer.Option(help="Side of the picture, file's units; the trained radius by default."),
    ] = None,
    up: Annotated[
        str | None,
        typer.Option(metavar="X,Y,Z", help="Direction of its upper edge; the y axis, or z."),
    ] = None,
    image: Annotated[
        Path | None, typer.Option(help="Picture for the colours of .ply and .png; else tiles.")
    ] = None,
    flip: Annotated[
        bool, typer.Option(help="Mirror it: a cloud does not know its outside.")
    ] = False,
) -> Answer:
    """Texture coordinates of a square picture stuck on at the source (Sec. 3.4).

    An .npz holds points, uv (n, 2), (0, 0) the lower left corner and (1, 1) the upper right one,
    inside, frame, source and size. On a mesh the picture is seen from the side that its faces turn
    outward.
    """
    output.check(encoding.shape, image)
    if size is not None and not 0 < size < np.inf:
        raise UserError(f"--size must be positive, got {size:g}")
    paint = None if image is None else read_image(image)
    direction = None if up is None else coordinates(up, "--up")
    loaded = encoding.load()
    place = loaded.place(where)
    frame = loaded.frame(place.point)
    side = loaded.radius if size is None else size
    uv, inside = decal_uv(loaded, place.point, upward(direction, frame), side)
    mirrored = flip != seen_from_inside(loaded, place.point, frame[:, 2])
    if mirrored:
        uv[:, 0] = 1 - uv[:, 0]
    colours = decal_colours(uv, inside, paint)
    arrays = {
        "points": loaded.points,
        "uv": uv,
        "inside": inside,
        "frame": frame,
        "source": place.point,
        "size": np.array(side),
    }
    geometry = Geometry(loaded.points, loaded.faces, uv=uv, colours=colours)

    def draw():
        from riemlayer.cli.pictures import scene

        return scene(loaded, place.point, f"A decal at {place}.", colours=colours)

    output.write(Result(arrays, geometry, draw))
    facts = about(loaded, encoding, output, place) | {
        "points": len(uv),
        "inside": int(inside.sum()),
        "size": side,
        "mirrored": bool(mirrored),
    }
    text = (
        f"{output.out}: a picture of side {side:.4g} at {place} lies over {facts['inside']:,} of "
        f"{facts['points']:,} points"
    )
    return Answer(facts, text)


def decal_uv(loaded: Loaded, p: Array, up: Array, size: float) -> tuple[Array, np.ndarray]:
    """UV (n, 2) and inside (n,) of `riemlayer.ops.decal`, asked in the file's units."""
    from riemlayer.ops import decal

    stage("laying the picture")
    with blame("--up"):
        answer = decal(
            loaded.surface,
            loaded.inward(p),
            loaded.tensor(up),
            size / loaded.scale,
            loaded.asked(),
        )
    n = len(loaded.points)
    return numbers(answer.uv[:n]), answer.inside[:n].cpu().numpy()


def upward(up: Array | None, frame: Array) -> Array:
    """The direction given, or the y axis, or z where the surface faces y."""
    if up is not None:
        return up / max(np.abs(up).max(), 1e-300)
    return np.eye(3)[1 if abs(frame[1, 2]) < 0.9 else 2]


def seen_from_inside(loaded: Loaded, p: Array, normal: Array) -> bool:
    """Does the frame's normal point into the mesh, by the winding of the nearest faces?"""
    if loaded.faces is None:
        return False
    a, b, c = (loaded.points[loaded.faces[:, i]] / loaded.scale for i in range(3))
    distance = np.linalg.norm((a + b + c) / 3 - p / loaded.scale, axis=1)
    near = distance.argsort()[:8]
    outward = np.cross((b - a)[near], (c - a)[near]).sum(0)
    return bool(outward @ normal < 0)


def decal_colours(uv: Array, inside: np.ndarray, paint: Array | None) -> Array:
    """(n, 3) colours of the picture, or of eight tiles a side, on plain ground."""
    if paint is None:
        colours = tile_colours(uv - 0.5, 1.0, 1 / 8)
    else:
        rows, columns = paint.shape[:2]
        i = ((1 - uv[:, 1]) * rows).astype(int).clip(0, rows - 1)
        colours = paint[i, (uv[:, 0] * columns).astype(int).clip(0, columns - 1)]
    plain = tile_colours(np.full((1, 2), np.nan), 1.0, 1.0)
    return np.where(inside[:, None], colours, plain)


def mean(
    encoding: Encoding,
    output: Output,
    point: Annotated[
        list[int] | None,
        typer.Option("--point", "-p", help="Index of a point to average; may be repeated."),
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
    places += [loaded.at_point(x) for x in wanted]
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
        return [loaded.at_point(x) for x in listed.astype(float)]
    raise UserError(
        f"{name}: must hold (K,) whole numbers or (K, 3) coordinates, got {listed.shape}"
    )


def numbers(x) -> Array:
    """A tensor as an array in double precision."""
    return x.detach().double().cpu().numpy()
