"""`riemlayer view`."""

from __future__ import annotations

import webbrowser
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Annotated

import numpy as np
import typer

from riemlayer.cli.command import Answer, announce, command
from riemlayer.cli.errors import UserError
from riemlayer.cli.loaded import Array, Encoding, Loaded, Where
from riemlayer.cli.maps import PANEL, chart, fan_paths
from riemlayer.cli.options import Force
from riemlayer.cli.output import check_target, whole_file
from riemlayer.cli.progress import end_bar


def register(app: typer.Typer) -> None:
    """Adds the subcommands of this file."""
    command(app, "riemlayer view bunny.ply", PANEL)(view)


def view(
    encoding: Encoding,
    where: Where,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Write one page, .html, instead.", metavar="OUT"),
    ] = None,
    force: Force = False,
    browser: Annotated[bool, typer.Option(help="Open a browser.")] = True,
    port: Annotated[int, typer.Option(help="To serve at; 0: any.", min=0, max=65535)] = 0,
    polyscope: Annotated[
        bool, typer.Option("--polyscope", help="In polyscope's window instead.")
    ] = False,
) -> Answer | None:
    """Log map and geodesics to turn, in a browser; a click chooses the source.

    The page is served to this machine alone until Ctrl-C. With -o one source is written to a page
    that needs neither server nor network.
    """
    if out is not None:
        if out.suffix.lower() != ".html":
            raise UserError(f"--out must end in .html, got {out}; riemlayer log writes other forms")
        check_target(out, force, encoding.shape)
    show = polyscope_module() if polyscope else None
    loaded = encoding.load()
    chosen = where.source is not None or where.at is not None
    p = loaded.place(where).point if chosen else None
    if show is not None:
        end_bar()
        show_polyscope(show, loaded, loaded.points[0] if p is None else p)
        return None
    if out is None:
        serve_page(loaded, p, port, browser)
        return None
    write_page(out, loaded, loaded.points[0] if p is None else p)
    if browser:
        webbrowser.open(out.absolute().as_uri())
    facts = {"shape": str(encoding.shape), "out": str(out), "weights": encoding.weights}
    return Answer(facts | {"radius": loaded.radius}, f"{out}: a page to open in a browser")


def serve_page(loaded: Loaded, p: Array | None, port: int, browser: bool) -> None:
    """The viewer, until Ctrl-C."""
    from riemlayer.cli.pictures import drawn, in_cube
    from riemlayer.viz import serve

    def ready(url: str) -> None:
        end_bar()
        announce(Answer({"url": url}, f"{url}  (Ctrl-C ends)"))

    points = in_cube(loaded, loaded.points)[drawn(loaded)]
    first = None if p is None else in_cube(loaded, p)
    try:
        serve(
            loaded.surface,
            points,
            loaded.faces,
            p=first,
            port=port,
            open_browser=browser,
            title=loaded.path.name,
            on_ready=ready,
        )
    except OSError as error:
        raise UserError(f"--port {port} cannot be served at: {error.strerror}") from error


def write_page(out: Path, loaded: Loaded, p: Array) -> None:
    """The maps of one source, on one page."""
    from riemlayer.cli.pictures import log_scene, write_scene

    with whole_file(out) as path:
        write_scene(path, log_scene(loaded, p, "Log map and geodesics of the black point."))


def polyscope_module() -> ModuleType:
    """polyscope, which no extra brings."""
    try:
        return import_module("polyscope")
    except ModuleNotFoundError as error:
        raise UserError("--polyscope needs polyscope: pip install polyscope") from error


def show_polyscope(polyscope: ModuleType, loaded: Loaded, p: Array) -> None:
    """The log map as a parameterisation and the fan as curves, in polyscope's window."""
    from riemlayer.cli.pictures import in_cube

    log, uv, distance = chart(loaded, p)
    points = in_cube(loaded, loaded.points)
    polyscope.init()
    if loaded.faces is None:
        shape = polyscope.register_point_cloud("shape", points)
    else:
        shape = polyscope.register_surface_mesh("shape", points, loaded.faces)
    shape.add_parameterization_quantity("log", uv / loaded.radius, enabled=True)
    shape.add_scalar_quantity("distance", distance)
    shape.add_scalar_quantity("validity", log.validity)
    paths = in_cube(loaded, fan_paths(loaded, p))  # (rays, samples, 3)
    index = np.arange(paths.shape[0] * paths.shape[1]).reshape(paths.shape[:2])
    edges = np.stack((index[:, :-1], index[:, 1:]), -1).reshape(-1, 2)
    polyscope.register_curve_network("Exp", paths.reshape(-1, 3), edges)
    polyscope.show()
