"""Operations on whole surfaces: means, clusters, stitched charts, decals, local geometry."""

from riemlayer.ops.decal import Decal, decal
from riemlayer.ops.local_geometry import LocalGeometry, local_geometry, orient
from riemlayer.ops.means import (
    Clusters,
    Principal,
    farthest_points,
    frechet_mean,
    kmeans,
    tangent_pca,
)
from riemlayer.ops.stitching import Charts, Stitched, stitch_log
from riemlayer.ops.tiling import TiledSurface, encode_tiled
from riemlayer.ops.views import ViewedSurface, encode_views

__all__ = [
    "Charts",
    "Clusters",
    "Decal",
    "LocalGeometry",
    "Principal",
    "Stitched",
    "TiledSurface",
    "ViewedSurface",
    "decal",
    "encode_tiled",
    "encode_views",
    "farthest_points",
    "frechet_mean",
    "kmeans",
    "local_geometry",
    "orient",
    "stitch_log",
    "tangent_pca",
]
