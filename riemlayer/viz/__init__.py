"""Log maps as checkerboards and polar grids, Exp as fans of geodesics, atlases, errors, validity.

One `Drawing` becomes a picture (`write_png`), a page to turn (`write_html`) or a part of the viewer
in which a click chooses the source (`serve`). Pictures need the extra `viz` (pyvista, matplotlib);
pages and the viewer need a browser alone.
"""

from riemlayer.viz.canvas import Canvas
from riemlayer.viz.drawing import Drawing
from riemlayer.viz.html import write_html
from riemlayer.viz.mesh import subdivide
from riemlayer.viz.palette import colour_map, label_colours
from riemlayer.viz.png import write_png
from riemlayer.viz.scenes import (
    draw_errors,
    draw_exp,
    draw_geodesics,
    draw_log,
    draw_stitched,
    draw_validity,
)
from riemlayer.viz.server import Viewer, serve
from riemlayer.viz.tiles import checkerboard, polar_grid
from riemlayer.viz.view import View, outward, tangent_coordinates, tangent_frame, viewpoint

__all__ = [
    "Canvas",
    "Drawing",
    "View",
    "Viewer",
    "checkerboard",
    "colour_map",
    "draw_errors",
    "draw_exp",
    "draw_geodesics",
    "draw_log",
    "draw_stitched",
    "draw_validity",
    "label_colours",
    "outward",
    "polar_grid",
    "serve",
    "subdivide",
    "tangent_coordinates",
    "tangent_frame",
    "viewpoint",
    "write_html",
    "write_png",
]
