"""The U-Net: shapes, and that nodes depend on their own cloud alone."""

import pytest
import torch
from references import lumpy, packed, shaken
from torch import Tensor

from riemlayer.backbone.stem import leaf_summary
from riemlayer.config import FieldConfig
from riemlayer.geometry import local_planes
from riemlayer.octree import build_octree


def embed(preset: str, points: Tensor, batch: Tensor, field) -> tuple[Tensor, Tensor]:
    """Embedding (n, C) and keys (n,) of its nodes."""
    config = FieldConfig.preset(preset).backbone
    coarsest = config.depth - len(config.encoder) + 1
    octree = build_octree(points, batch, config.depth + 1, coarsest)
    with torch.no_grad():
        z = field.backbone(points, octree, local_planes(points, octree))
    return z, octree.level(config.depth).key


@pytest.mark.parametrize("preset", ["tiny", "base", "paper"])
def test_one_embedding_a_leaf(preset):
    points, batch = packed(lumpy(60), lumpy(40))
    field = shaken(preset)
    z, key = embed(preset, points, batch, field)
    assert z.shape == (len(key), field.config.backbone.embedding)
    assert z.isfinite().all() and z.std(0).min() > 1e-3  # every channel tells nodes apart


@pytest.mark.parametrize("preset", ["tiny", "paper"])
def test_a_cloud_has_the_same_embedding_alone_and_in_a_batch(preset):
    clouds = lumpy(60), lumpy(90), 0.5 * lumpy(40)
    points, batch = packed(*clouds)
    field = shaken(preset)
    together, _ = embed(preset, points, batch, field)
    alone = [embed(preset, x, batch[: len(x)] * 0, field)[0] for x in clouds]
    torch.testing.assert_close(together, torch.cat(alone), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("preset", ["tiny", "paper"])
def test_a_shift_by_a_coarsest_cell_changes_nothing(preset):
    points = 0.4 * lumpy(150)
    config = FieldConfig.preset(preset).backbone
    cell = 2.125 / 2 ** (config.depth - len(config.encoder) + 1)
    batch, field = torch.zeros(150, dtype=torch.long), shaken(preset)
    here, _ = embed(preset, points, batch, field)
    for shift in ([cell, 0, 0], [-cell, cell, 0]):
        there, _ = embed(preset, points + torch.tensor(shift).double(), batch, field)
        # a shift reorders the nodes where it carries into a higher bit of the key
        torch.testing.assert_close(_sorted(there), _sorted(here), rtol=1e-5, atol=1e-7)


def _sorted(z: Tensor) -> Tensor:
    return z[z[:, 0].argsort()]


def test_receptive_field_is_more_than_a_node():
    points = lumpy(200)
    batch, field = torch.zeros(200, dtype=torch.long), shaken("tiny")
    here, _ = embed("tiny", points, batch, field)
    points[0] += 1e-4
    there, _ = embed("tiny", points, batch, field)
    assert ((here - there).abs().amax(-1) > 0).sum() > 10


def test_leaf_summary_is_that_of_a_loop():
    points, batch = packed(lumpy(30), lumpy(40))
    octree = build_octree(points, batch, depth=2)
    level, leaf = octree.level(2), octree.leaf
    offset, summary = leaf_summary(points, leaf, level)
    assert offset.abs().max() <= 1
    for i in range(len(level)):
        mine = points[leaf == i]
        local = (mine - level.centres()[i]) / (level.cell_size / 2)
        torch.testing.assert_close(offset[leaf == i], local)
        torch.testing.assert_close(summary[i, :3], local.mean(0))
        torch.testing.assert_close(summary[i, 3], torch.tensor(len(mine)).double().log())


def test_gradients_reach_every_weight():
    points, batch = packed(lumpy(80))
    field = shaken("tiny")
    octree = build_octree(points, batch, 5, 2)
    field.backbone(points, octree, local_planes(points, octree)).square().sum().backward()
    for name, parameter in field.backbone.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().max() > 0, name
