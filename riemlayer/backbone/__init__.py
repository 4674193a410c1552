"""Octree U-Net."""

from riemlayer.backbone.conv import OctreeConv, OctreeDown, OctreeUp
from riemlayer.backbone.unet import OctreeUNet

__all__ = ["OctreeConv", "OctreeDown", "OctreeUNet", "OctreeUp"]
