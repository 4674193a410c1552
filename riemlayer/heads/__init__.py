"""Triplane hypernetworks and the two maps."""

from riemlayer.heads.maps import Embedding, ExpHead, LogHead, MapOutput
from riemlayer.heads.triplane import TriplaneHypernetwork, sample_triplane

__all__ = [
    "Embedding",
    "ExpHead",
    "LogHead",
    "MapOutput",
    "TriplaneHypernetwork",
    "sample_triplane",
]
