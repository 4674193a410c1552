"""Triplane hypernetworks, the SIREN of the ablation, and the two maps."""

from riemlayer.heads.branch import Embedding, MapOutput
from riemlayer.heads.maps import ExpHead, LogHead
from riemlayer.heads.siren import SirenDecoder
from riemlayer.heads.tangent import tangent_normals
from riemlayer.heads.triplane import TriplaneDecoder, TriplaneHypernetwork, sample_triplane

__all__ = [
    "Embedding",
    "ExpHead",
    "LogHead",
    "MapOutput",
    "SirenDecoder",
    "TriplaneDecoder",
    "TriplaneHypernetwork",
    "sample_triplane",
    "tangent_normals",
]
