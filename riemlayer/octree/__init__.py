"""Octree in pure torch: keys, build, look-up, search."""

from riemlayer.octree.build import HALF_WIDTH, Level, Octree, build_octree
from riemlayer.octree.interpolate import (
    Corners,
    corners,
    interpolate,
    interpolate_or_zero,
    nearest_node,
)
from riemlayer.octree.keys import decode_key, encode_key
from riemlayer.octree.search import knn, radius_search

__all__ = [
    "HALF_WIDTH",
    "Corners",
    "Level",
    "Octree",
    "build_octree",
    "corners",
    "decode_key",
    "encode_key",
    "interpolate",
    "interpolate_or_zero",
    "knn",
    "nearest_node",
    "radius_search",
]
