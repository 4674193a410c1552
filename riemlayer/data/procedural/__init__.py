"""Seeded random closed shapes, man-made and organic, to learn geodesics on."""

from riemlayer.data.procedural.catalogue import KINDS, random_shape
from riemlayer.data.procedural.finish import Shape

__all__ = ["KINDS", "Shape", "random_shape"]
