"""Layers for networks on surfaces, fed by the record `LocalGeometry`."""

from riemlayer.nn.adaptive import AdaptiveGeodesicConv
from riemlayer.nn.cells import Cells, geodesic_cells
from riemlayer.nn.edges import LogMapEdges
from riemlayer.nn.geodesic import GeodesicConv
from riemlayer.nn.harmonic import (
    HarmonicConv,
    HarmonicGate,
    HarmonicLinear,
    magnitudes,
    to_streams,
)
from riemlayer.nn.pool import GeodesicPool, GeodesicUnpool
from riemlayer.nn.tangent import TangentConv
from riemlayer.nn.vectors import ParallelTransport, VectorPool

__all__ = [
    "AdaptiveGeodesicConv",
    "Cells",
    "GeodesicConv",
    "GeodesicPool",
    "GeodesicUnpool",
    "HarmonicConv",
    "HarmonicGate",
    "HarmonicLinear",
    "LogMapEdges",
    "ParallelTransport",
    "TangentConv",
    "VectorPool",
    "geodesic_cells",
    "magnitudes",
    "to_streams",
]
