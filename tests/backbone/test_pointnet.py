"""PointNet in the U-Net's place: what its embedding depends on, and what it does not."""

from dataclasses import replace

import pytest
import torch
from references import lumpy, packed
from torch import Tensor

from riemlayer import BackboneConfig, ExpLogField, FieldConfig
from riemlayer.backbone import OctreeUNet, PointNet, make_backbone
from riemlayer.geometry import local_planes
from riemlayer.octree import build_octree

TINY = FieldConfig.tiny()
CONFIG = replace(TINY, backbone=replace(TINY.backbone, kind="pointnet"))


@pytest.fixture
def net() -> PointNet:
    return PointNet(CONFIG.backbone).double()


def embed(net: PointNet, points: Tensor, batch: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Embedding (n, C) and the leaf (N,) of each point."""
    if batch is None:
        batch = torch.zeros(len(points), dtype=torch.long)
    octree = build_octree(points, batch, net.config.depth + 1, 2)
    z = net(points, octree, local_planes(points, octree))
    return z, octree.node(net.config.depth)


def test_kind_says_which_backbone():
    assert type(make_backbone(CONFIG.backbone)) is PointNet
    assert type(make_backbone(TINY.backbone)) is OctreeUNet
    with pytest.raises(ValueError, match=r"kind must be one of .*'pointnet'.*got 'cube'"):
        BackboneConfig(kind="cube")


def test_an_old_configuration_is_one_of_an_octree_and_a_triplane():
    values = TINY.to_dict()
    del values["backbone"]["kind"], values["head"]["decoder"]
    assert FieldConfig.from_dict(values) == TINY
    assert ExpLogField.from_pretrained("base").config.backbone.kind == "octree"


def test_one_embedding_a_leaf(net):
    z, leaf = embed(net, lumpy(90))
    assert z.shape == (int(leaf.max()) + 1, CONFIG.backbone.embedding)
    assert z.isfinite().all() and z.std(0).min() > 1e-3  # every channel tells leaves apart


def test_order_of_the_points_does_not_matter(net):
    points, order = lumpy(120), torch.randperm(120)
    torch.testing.assert_close(
        embed(net, points[order])[0], embed(net, points)[0], rtol=0, atol=1e-12
    )


def test_a_cloud_has_the_same_embedding_alone_and_in_a_batch(net):
    clouds = lumpy(60), lumpy(90), 0.5 * lumpy(40)
    together, _ = embed(net, *packed(*clouds))
    alone = [embed(net, x)[0] for x in clouds]
    torch.testing.assert_close(together, torch.cat(alone), rtol=0, atol=1e-12)


def test_every_leaf_knows_of_the_whole_cloud(net):
    """By the pool alone: without it a point that moves within its leaf changes no other leaf."""
    points = lumpy(120)
    moved = points.clone()
    moved[0] *= 0.98

    def changed() -> list[int]:
        (here, leaf), (there, same) = embed(net, points), embed(net, moved)
        assert torch.equal(leaf, same)
        return ((here - there).abs().amax(-1) > 0).nonzero().flatten().tolist()

    leaf = embed(net, points)[1]
    assert changed() == list(range(int(leaf.max()) + 1))
    torch.nn.init.zeros_(net.whole.weight)
    assert changed() == [int(leaf[0])]


def test_leaves_average_their_points(net):
    """Points twice over leave the mean of a leaf and the maximum over the cloud as they are."""
    points = lumpy(70)
    twice, _ = embed(net, points.repeat(2, 1))
    torch.testing.assert_close(twice, embed(net, points)[0], rtol=0, atol=1e-12)


def test_positions_count_within_the_cube_but_not_those_of_the_whole_cloud():
    """Shifted by a coarsest cell, the U-Net answers the same; PointNet does not."""
    points, field = 0.4 * lumpy(150), ExpLogField(CONFIG).double()
    cell, batch = 2.125 / 4, torch.zeros(150, dtype=torch.long)
    with torch.no_grad():
        here = field.encode_in_cube(points, batch).embedding.z
        there = field.encode_in_cube(points + torch.tensor([0, 0, cell]).double(), batch)
        assert here.shape == there.embedding.z.shape  # the same leaves
        assert (there.embedding.z - here).abs().max() > 1e-2
        whole, moved = (field.encode(x).embedding.z for x in (points, 3 * points + 7))
    torch.testing.assert_close(moved, whole, rtol=1e-9, atol=1e-9)


def test_gradients_reach_the_points_and_every_weight(net):
    points = lumpy(80).requires_grad_()
    embed(net, points)[0].square().sum().backward()
    assert points.grad is not None and (points.grad.abs().amax(-1) > 0).all()
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().max() > 0, name


def test_everything_behind_it_stays_as_it_is(tmp_path):
    """A field on it answers, is anchored, and comes back from its folder with the same answers."""
    field = ExpLogField(CONFIG)
    points = lumpy(200, torch.float32)
    p, v = points[:5, None], 0.2 * torch.randn(5, 7, 3)
    surface = field.encode(points)
    assert torch.equal(surface.exp(p, torch.zeros(5, 7, 3)), p.expand(5, 7, 3))
    field.save_pretrained(tmp_path)
    loaded = ExpLogField.from_pretrained(tmp_path)
    assert loaded.config == CONFIG
    assert torch.equal(loaded.encode(points).exp(p, v), surface.exp(p, v))
