"""Pictures by pyvista, off screen: no window, no X server."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from riemlayer.viz.cloud import discs
from riemlayer.viz.drawing import (
    BLACK,
    BLUE,
    CREAM,
    DOT,
    ORANGE,
    PLAIN,
    Array,
    Drawing,
    View,
)

VIEW_ANGLE = 30.0
LIGHT = {"ambient": 0.3, "diffuse": 0.8}
LIFT = 0.012
"""Lines come this much nearer to the eye, in extents: the discs of a cloud must not bury them."""


def write_png(path: str | Path, *drawings: Drawing, view: View, size: int = 640) -> Path:
    """One picture of all drawings side by side, seen by one camera.

    Args:
        path: the file to write; it appears only when it is complete.
        drawings: one or more.
        view: the camera, see `viewpoint`.
        size: height and width of each part, in pixels.

    Returns:
        The path.
    """
    import pyvista

    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.png")
    with pyvista.vtk_verbosity("off"):  # without a window VTK warns that there is none
        plotter = _plot(drawings, view, size)
        plotter.screenshot(temporary)
        plotter.close()
    os.replace(temporary, path)
    return path


def _plot(drawings: tuple[Drawing, ...], view: View, size: int):
    import pyvista

    plotter = pyvista.Plotter(
        off_screen=True,
        shape=(1, len(drawings)),
        window_size=[size * len(drawings), size],
        border=False,
        theme=pyvista.themes.DocumentTheme(),
    )
    plotter.enable_anti_aliasing("ssaa")
    for i, drawing in enumerate(drawings):
        plotter.subplot(0, i)
        _add_surface(plotter, drawing)
        _add_paths(plotter, drawing, LIFT * view.extent * view.direction)
        if drawing.title:
            plotter.add_text(drawing.title, position="upper_edge", font_size=11, color="black")
        _aim(plotter.camera, view)
    return plotter


def _add_surface(plotter, drawing: Drawing) -> None:
    """The part within the radius carries the tiles as a texture, cut exactly at the radius."""
    mesh, log = _patches(drawing)
    if drawing.colours is not None:
        each = mesh.n_points // len(drawing.points)
        mesh["colour"] = (255 * np.repeat(drawing.colours, each, axis=0)).round().astype(np.uint8)
        plotter.add_mesh(mesh, scalars="colour", rgb=True, smooth_shading=True, **LIGHT)
        return
    if log is None:
        plotter.add_mesh(mesh, color=PLAIN, smooth_shading=True, **LIGHT)
        return
    mesh.active_texture_coordinates = log / (2 * drawing.period)
    mesh["reach"] = np.linalg.norm(log, axis=1)
    inside = mesh.clip_scalar(scalars="reach", invert=True, value=drawing.radius)
    outside = mesh.clip_scalar(scalars="reach", invert=False, value=drawing.radius)
    if outside.n_points:
        plotter.add_mesh(outside, color=PLAIN, smooth_shading=True, **LIGHT)
    if inside.n_points:
        plotter.add_mesh(inside, texture=_tiles(), smooth_shading=True, **LIGHT)


def _patches(drawing: Drawing):
    """The triangles of a mesh or the discs of a cloud, with normals, and the log map on them."""
    import pyvista

    points, faces, normals, log = drawing.points, drawing.faces, drawing.normals, drawing.log
    if faces is None:
        offset, faces = discs(points, normals, drawing.spacing)
        points = (points[:, None] + offset).reshape(-1, 3)
        normals = np.repeat(normals, offset.shape[1], axis=0)
        if log is not None and drawing.slope is not None:
            log = (log[:, None] + offset @ drawing.slope.transpose(0, 2, 1)).reshape(-1, 2)
    mesh = pyvista.PolyData.from_regular_faces(points, faces)
    mesh.point_data.active_normals = normals
    return mesh, log


def _tiles():
    import pyvista

    odd = np.kron([[0, 1], [1, 0]], np.ones((64, 64)))[..., None] > 0
    texture = pyvista.Texture((np.where(odd, CREAM, BLUE) * 255).round().astype(np.uint8))
    texture.repeat, texture.mipmap = True, True
    return texture


def _add_paths(plotter, drawing: Drawing, lift: Array) -> None:
    import pyvista

    thick = 0.0035 * np.ptp(drawing.points, axis=0).max()
    for paths, colour, width in (
        (drawing.reference, BLACK, 0.6 * thick),
        (drawing.paths, ORANGE, thick),
    ):
        if len(paths):
            lines = pyvista.merge([pyvista.MultipleLines(path + lift) for path in paths])
            plotter.add_mesh(lines.tube(radius=width), color=colour, smooth_shading=True)
            _add_balls(plotter, np.stack([path[-1] for path in paths]) + lift, 2 * width, colour)
    if drawing.dots is not None:
        dots = pyvista.PolyData(drawing.dots + lift)
        plotter.add_mesh(dots, color=DOT, style="points", point_size=3.0, lighting=False)
    if drawing.p is not None:
        _add_balls(plotter, drawing.p[None] + lift, 3 * thick, BLACK)


def _add_balls(plotter, centres: Array, radius: float, colour: tuple[float, ...]) -> None:
    import pyvista

    ball = pyvista.Sphere(radius=radius, theta_resolution=16, phi_resolution=16)
    balls = pyvista.PolyData(centres).glyph(orient=False, scale=False, geom=ball)
    plotter.add_mesh(balls, color=colour, smooth_shading=True)


def _aim(camera, view: View) -> None:
    distance = max(1.25 * view.fit / np.tan(np.radians(VIEW_ANGLE / 2)), 1.2 * view.extent)
    camera.focal_point = view.centre
    camera.position = view.centre + distance * view.direction
    camera.up = view.up
    camera.view_angle = VIEW_ANGLE
    camera.clipping_range = (distance - 1.1 * view.extent, distance + 1.1 * view.extent)
