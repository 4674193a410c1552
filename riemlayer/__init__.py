"""Exponential and logarithmic maps of any 3-D shape as one differentiable torch layer."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

_HOMES = {
    "BackboneConfig": "riemlayer.config",
    "EncodedSurface": "riemlayer.surface",
    "ExpLogField": "riemlayer.field",
    "FieldConfig": "riemlayer.config",
    "HeadConfig": "riemlayer.config",
    "MapInfo": "riemlayer.surface",
}
"""Imported when first asked for: `riemlayer --help` must not wait for torch."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
