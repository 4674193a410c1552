"""Shapes to encode and to learn from: files, clouds and functions in; traced truth for training."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from riemlayer.data.depth import DepthCloud, from_depth
    from riemlayer.data.implicit import Crossings, LevelSamples, sample_occupancy, sample_sdf
    from riemlayer.data.readers import RawShape, read_shape
    from riemlayer.data.sampling import sample_poisson

__all__ = [
    "Crossings",
    "DepthCloud",
    "LevelSamples",
    "RawShape",
    "from_depth",
    "read_shape",
    "sample_occupancy",
    "sample_poisson",
    "sample_sdf",
]

_HOMES = {
    **dict.fromkeys(("DepthCloud", "from_depth"), "depth"),
    **dict.fromkeys(("Crossings", "LevelSamples", "sample_occupancy", "sample_sdf"), "implicit"),
    **dict.fromkeys(("RawShape", "read_shape"), "readers"),
    "sample_poisson": "sampling",
}
"""Imported when first asked for: files are read without torch."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
