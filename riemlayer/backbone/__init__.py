"""Octree U-Net, and the PointNet of the ablation."""

from riemlayer.backbone.conv import OctreeConv, OctreeDown, OctreeUp
from riemlayer.backbone.pointnet import PointNet
from riemlayer.backbone.unet import OctreeUNet
from riemlayer.config import BackboneConfig


def make_backbone(config: BackboneConfig) -> OctreeUNet | PointNet:
    """The backbone of `config.kind`: from points and their octree to one embedding a leaf."""
    return {"octree": OctreeUNet, "pointnet": PointNet}[config.kind](config)


__all__ = ["OctreeConv", "OctreeDown", "OctreeUNet", "OctreeUp", "PointNet", "make_backbone"]
