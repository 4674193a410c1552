"""Local planes of a cloud, geodesic walking, frames."""

from riemlayer.geometry.chord import bend, lay_flat
from riemlayer.geometry.fan import WALKED, Fan, FanLog, fan_of, log_on_fan
from riemlayer.geometry.frames import angle_of, frame_of, nearest_isometry
from riemlayer.geometry.planes import LocalPlanes, local_planes, planes_at_scales
from riemlayer.geometry.points import Points
from riemlayer.geometry.shell import Shell, on_shell
from riemlayer.geometry.walk import MET, Walked, fade_in, turn, walk

__all__ = [
    "MET",
    "WALKED",
    "Fan",
    "FanLog",
    "LocalPlanes",
    "Points",
    "Shell",
    "Walked",
    "angle_of",
    "bend",
    "fade_in",
    "fan_of",
    "frame_of",
    "lay_flat",
    "local_planes",
    "log_on_fan",
    "nearest_isometry",
    "on_shell",
    "planes_at_scales",
    "turn",
    "walk",
]
