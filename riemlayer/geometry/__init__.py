"""Local planes of a cloud, geodesic walking, frames."""

from riemlayer.geometry.planes import LocalPlanes, local_planes
from riemlayer.geometry.walk import Walked, turn, walk

__all__ = ["LocalPlanes", "Walked", "local_planes", "turn", "walk"]
