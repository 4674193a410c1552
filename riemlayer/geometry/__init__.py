"""Local planes of a cloud, geodesic walking, frames."""

from riemlayer.geometry.planes import LocalPlanes, local_planes, planes_at_scales
from riemlayer.geometry.walk import Walked, lay_flat, turn, walk

__all__ = ["LocalPlanes", "Walked", "lay_flat", "local_planes", "planes_at_scales", "turn", "walk"]
