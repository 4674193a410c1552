"""Shapes to encode and to learn from: files, clouds and functions in; traced truth for training."""

from riemlayer.data.readers import RawShape, read_shape
from riemlayer.data.sampling import sample_poisson

__all__ = ["RawShape", "read_shape", "sample_poisson"]
