"""Exponential and logarithmic maps of any 3-D shape as one differentiable torch layer."""

from riemlayer.config import BackboneConfig, FieldConfig, HeadConfig
from riemlayer.field import ExpLogField
from riemlayer.surface import EncodedSurface, MapInfo

__all__ = [
    "BackboneConfig",
    "EncodedSurface",
    "ExpLogField",
    "FieldConfig",
    "HeadConfig",
    "MapInfo",
]
__version__ = "0.1.0"
