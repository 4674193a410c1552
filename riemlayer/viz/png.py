"""Pictures by pyvista, off screen: no window, no X server."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from riemlayer.viz.drawing import Drawing
from riemlayer.viz.palette import BLACK, DOT, ORANGE, WHITE
from riemlayer.viz.shaded import surface_actor
from riemlayer.viz.sheet import compose
from riemlayer.viz.view import View, unit

Array = np.ndarray

VIEW_ANGLE = 30.0
LIGHT = {"ambient": 0.35, "diffuse": 0.7}
LIFT = 0.012
"""Lines come this much nearer to the eye, in extents: the discs of a cloud must not bury them."""
SAMPLES = 2
"""Rows and columns of samples of a pixel."""


def write_png(
    path: str | Path, *drawings: Drawing, view: View, size: int = 640, columns: int | None = None
) -> Path:
    """One picture of all drawings, seen by one camera, with titles and colour bars.

    Args:
        path: the file to write; it appears only when it is complete.
        drawings: one or more.
        view: the camera, see `viewpoint`.
        size: height and width of each part, in pixels; titles and colour bars come in addition.
        columns: parts in a row; all of them by default.

    Returns:
        The path.

    Raises:
        ModuleNotFoundError: pyvista or matplotlib is not installed.

    Example:
        >>> import tempfile
        >>> from riemlayer.viz import Drawing, viewpoint
        >>> points = np.random.default_rng(0).random((50, 2)) @ np.eye(2, 3)
        >>> drawing = Drawing(points, values=points[:, 0], label="x")
        >>> folder, view = Path(tempfile.mkdtemp()), viewpoint(points, [0, 0, 1])
        >>> write_png(folder / "x.png", drawing, view=view, size=120).name
        'x.png'
    """
    if not drawings:
        raise ValueError("`drawings` must be one or more, got none")
    path = Path(path)
    sheet = compose([render(x, view, size) for x in drawings], drawings, columns)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.png")
    try:
        sheet.save(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def render(drawing: Drawing, view: View, size: int) -> Array:
    """The picture (size, size, 3) in uint8, without title and colour bar."""
    try:
        import pyvista
    except ModuleNotFoundError as error:
        mend = 'pictures need the extra viz: pip install "riemlayer[viz]"'
        raise ModuleNotFoundError(f"{error}; {mend}", name=error.name) from error

    with pyvista.vtk_verbosity("off"):  # without a window VTK warns that there is none
        plotter = pyvista.Plotter(off_screen=True, window_size=[SAMPLES * size] * 2, border=False)
        plotter.set_background("white")  # pyright: ignore[reportArgumentType]
        plotter.enable_anti_aliasing("msaa", multi_samples=4)
        distance = max(1.25 * view.fit / np.tan(np.radians(VIEW_ANGLE / 2)), 1.2 * view.extent)
        eye = view.centre + distance * view.direction
        plotter.add_actor(surface_actor(drawing, view, eye), reset_camera=False)
        _add_paths(plotter, drawing, LIFT * view.extent * view.direction)
        _aim(plotter.camera, view, eye)
        samples = plotter.screenshot(return_img=True)
        plotter.close()
    samples = np.asarray(samples, float).reshape(size, SAMPLES, size, SAMPLES, 3)
    return samples.mean((1, 3)).round().astype(np.uint8)


def _add_paths(plotter: Any, drawing: Drawing, lift: Array) -> None:
    import pyvista

    thick = 0.0035 * drawing.canvas.size
    for paths, colour, width in (
        (drawing.reference, BLACK, 0.6 * thick),
        (drawing.paths, ORANGE, thick),
    ):
        if len(paths):
            lines = pyvista.merge([pyvista.MultipleLines(path + lift) for path in paths])
            plotter.add_mesh(lines.tube(radius=width), color=colour, smooth_shading=True, **LIGHT)
            _add_balls(plotter, np.stack([path[-1] for path in paths]) + lift, 2 * width, colour)
    if drawing.dots is not None:
        dots = pyvista.PolyData(drawing.dots + lift)
        size = 1.8 * SAMPLES
        plotter.add_mesh(dots, color=DOT, style="points", point_size=size, lighting=False)
    if drawing.p is not None:
        near = unit(lift) * thick  # the rim of the source stands a little behind it
        _add_balls(plotter, drawing.p[None] + lift, 3.8 * thick, WHITE)
        _add_balls(plotter, drawing.p[None] + lift + 2 * near, 3 * thick, BLACK)


def _add_balls(plotter: Any, centres: Array, radius: float, colour: tuple[float, ...]) -> None:
    import pyvista

    ball = pyvista.Sphere(radius=radius, theta_resolution=16, phi_resolution=16)
    balls = pyvista.PolyData(centres).glyph(orient=False, scale=False, geom=ball)
    light = {"lighting": False} if colour == WHITE else LIGHT
    plotter.add_mesh(balls, color=colour, smooth_shading=True, **light)


def _aim(camera: Any, view: View, eye: Array) -> None:
    distance = float(np.linalg.norm(eye - view.centre))
    camera.focal_point = view.centre
    camera.position = eye
    camera.up = view.up
    camera.view_angle = VIEW_ANGLE
    camera.clipping_range = (distance - 1.1 * view.extent, distance + 1.1 * view.extent)
