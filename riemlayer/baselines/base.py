"""The interface of everything that has a row in the tables.

A method sees a cloud once (`prepare`) and is then asked for the maps of one source `p` at a time.
It offers `log`, `exp` or both; the tables ask what a method has and leave the other column empty.
Own methods need no base class, only these names:

    class Straight:
        def prepare(self, points): ...
        def exp(self, p, v): return p + v
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

Array = np.ndarray


@runtime_checkable
class SupportsPoints(Protocol):
    """Prepares itself from a point cloud alone."""

    def prepare(self, points: Array) -> None:
        """Take in the cloud (N, 3) float32; may be called again with another cloud."""
        ...


@runtime_checkable
class SupportsMesh(Protocol):
    """Prepares itself from a manifold triangle mesh: a rival with more to see than a cloud."""

    def prepare_mesh(self, vertices: Array, faces: Array) -> None:
        """Take in vertices (n, 3) float32 and faces (m, 3) int32."""
        ...


@runtime_checkable
class SupportsLog(Protocol):
    """Has a logarithmic map."""

    def log(self, p: Array, q: Array) -> Array:
        """Log_p(q): ambient tangent vectors (K, 3) at the source p (3,) to the points q (K, 3)."""
        ...


@runtime_checkable
class SupportsExp(Protocol):
    """Has an exponential map."""

    def exp(self, p: Array, v: Array) -> Array:
        """Exp_p(v): end points (K, 3) of the ambient tangent vectors v (K, 3) at p (3,)."""
        ...
