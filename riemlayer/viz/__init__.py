"""Log maps as checkerboards and Exp as fans of geodesics, as a picture and as a page to turn.

Needs the extra `viz` (pyvista) for pictures; the page needs nothing.
"""

from riemlayer.viz.drawing import (
    Drawing,
    View,
    checkerboard,
    tangent_coordinates,
    tangent_frame,
    viewpoint,
)
from riemlayer.viz.html import write_html
from riemlayer.viz.png import write_png

__all__ = [
    "Drawing",
    "View",
    "checkerboard",
    "tangent_coordinates",
    "tangent_frame",
    "viewpoint",
    "write_html",
    "write_png",
]
