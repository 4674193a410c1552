"""`riemlayer decal`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from riemlayer.cli.command import Answer, command
from riemlayer.cli.errors import UserError, blame
from riemlayer.cli.formats import Geometry
from riemlayer.cli.inputs import read_image
from riemlayer.cli.loaded import Array, Encoding, Loaded, Where, coordinates, numbers
from riemlayer.cli.maps import PANEL, about, tile_colours
from riemlayer.cli.output import Output, Result
from riemlayer.cli.progress import stage

if TYPE_CHECKING:
    from torch import Tensor

    from riemlayer.cli.pictures import Scene

FINE = 0.03
"""Edges of a drawn mesh are halved down to this, in the cube: its vertices carry the colours."""


def register(app: typer.Typer) -> None:
    """Adds the subcommand of this file."""
    command(app, "riemlayer decal bunny.ply --source 0 --image cat.png -o cat.ply", PANEL)(decal)


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
    mirrored = flip != seen_from_inside(loaded, place.point, frame[:, 2])

    def stick(points: Tensor) -> tuple[Array, np.ndarray]:
        uv, inside = decal_uv(loaded, place.point, upward(direction, frame), side, points)
        return (uv * [-1, 1] + [1, 0] if mirrored else uv), inside

    n = len(loaded.points)
    uv, inside = (x[:n] for x in stick(loaded.asked()))
    arrays = {
        "points": loaded.points,
        "uv": uv,
        "inside": inside,
        "frame": frame,
        "source": place.point,
        "size": np.array(side),
    }
    colours = decal_colours(uv, inside, paint)
    geometry = Geometry(loaded.points, loaded.faces, uv=uv, colours=colours)

    def draw() -> Scene:
        from riemlayer.cli.pictures import canvas_of, scene

        canvas = canvas_of(loaded, FINE)
        painted = decal_colours(*stick(loaded.tensor(canvas.points)), paint)
        return scene(loaded, place.point, f"A decal at {place}.", canvas, colours=painted)

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


def decal_uv(
    loaded: Loaded, p: Array, up: Array, size: float, points: Tensor
) -> tuple[Array, np.ndarray]:
    """UV (N, 2) and inside (N,) of points (N, 3) of the cube; the rest in the file's units."""
    from riemlayer.ops import decal

    stage("laying the picture")
    with blame("--up"):
        answer = decal(
            loaded.surface, loaded.inward(p), loaded.tensor(up), size / loaded.scale, points
        )
    return numbers(answer.uv), answer.inside.cpu().numpy()


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
