"""The octree's tables against a dictionary of its cells, with the dense grid and without."""

from dataclasses import FrozenInstanceError

import pytest
import torch
from references import dictionary_children, dictionary_neighbours, nodes, random_octree

from riemlayer.octree import HALF_WIDTH, build, build_octree, decode_key, encode_key
from riemlayer.octree.build import NEIGHBOURS, cell_of


@pytest.fixture(params=["dense grid", "sorted keys"])
def octree(request, monkeypatch):
    if request.param == "sorted keys":
        monkeypatch.setattr(build, "DENSE_LIMIT", 0)
    tree = random_octree(depth=4)
    assert all((level.grid is None) == (request.param == "sorted keys") for level in tree.levels)
    return tree


def test_neighbours_are_those_of_a_dictionary(octree):
    for level in octree.levels:
        assert torch.equal(level.neighbours, dictionary_neighbours(level))


def test_children_are_those_of_a_dictionary(octree):
    for coarse, fine in zip(octree.levels, octree.levels[1:], strict=False):
        assert torch.equal(coarse.children, dictionary_children(coarse, fine))


def test_parents_are_those_of_a_dictionary(octree):
    for coarse, fine in zip(octree.levels, octree.levels[1:], strict=False):
        known = nodes(coarse)
        expected = [known[b, x // 2, y // 2, z // 2] for b, x, y, z in nodes(fine)]
        assert fine.parent.tolist() == expected


def test_nodes_around_any_cell_are_those_of_a_dictionary(octree):
    level = octree.level(3)
    cell = torch.randint(8, (200, 3))
    cell[:16] = torch.cartesian_prod(*[torch.tensor([0, 7])] * 3).repeat(2, 1)  # the corners
    batch = torch.randint(2, (200,))
    known = nodes(level)
    for row, c, b in zip(level.around(cell, batch, NEIGHBOURS), cell, batch, strict=True):
        keys = [(int(b), *(c + step).tolist()) for step in NEIGHBOURS]
        assert row.tolist() == [known.get(key, len(level)) for key in keys]


def test_mirrored_neighbours_see_each_other(octree):
    level = octree.level(4)
    here, k = (level.neighbours < len(level)).nonzero().unbind(-1)
    there = level.neighbours[here, k]
    assert torch.equal(level.neighbours[there, 26 - k], here)


def test_every_point_lies_in_its_node_at_every_depth():
    points = (2 * torch.rand(300, 3) - 1) * HALF_WIDTH * 0.999
    batch = torch.arange(3).repeat_interleave(100)
    tree = build_octree(points, batch, depth=6, coarsest=2)
    for depth in range(2, 7):
        node, level = tree.node(depth), tree.level(depth)
        assert torch.equal(level.key[node], encode_key(cell_of(points, depth), batch, depth))
        assert (points - level.centres()[node]).abs().max() <= level.cell_size * 0.5001
        assert torch.equal(level.batch()[node], batch)


def test_only_occupied_nodes_exist_and_once():
    tree = random_octree(depth=5)
    for level in tree.levels:
        assert (level.key.diff() > 0).all()
    assert torch.equal(tree.leaf.unique(), torch.arange(len(tree.level(5))))


def test_levels_and_ends():
    tree = random_octree(depth=4, coarsest=2)
    assert [level.depth for level in tree.levels] == [2, 3, 4] and tree.depth == 4
    assert tree.levels[0].parent is None and tree.levels[-1].children is None


def test_a_shape_has_the_same_nodes_alone_and_in_a_batch():
    points = (2 * torch.rand(120, 3) - 1) * 0.9
    batch = torch.arange(3).repeat_interleave(40)
    together = build_octree(points, batch, depth=4).level(4)
    for i in range(3):
        alone = build_octree(points[batch == i], batch[batch == 0], depth=4).level(4)
        mine = together.batch() == i
        cell, _ = decode_key(together.key[mine], 4)
        assert torch.equal(cell, decode_key(alone.key, 4)[0])


def test_an_octree_is_frozen():
    tree = random_octree(depth=3)
    with pytest.raises(FrozenInstanceError):
        tree.levels = ()  # pyright: ignore
    with pytest.raises(FrozenInstanceError):
        tree.level(3).depth = 2  # pyright: ignore


def test_points_are_not_written_to():
    points = torch.rand(50, 3)
    before = points.clone()
    build_octree(points, torch.zeros(50, dtype=torch.long), depth=4)
    assert torch.equal(points, before)


def test_points_outside_the_cube_raise():
    points = torch.tensor([[0.0, 0, 0], [0, 1.2, 0]])
    with pytest.raises(ValueError, match="cell must lie in"):
        build_octree(points, torch.zeros(2, dtype=torch.long), depth=3)


def test_a_copy_on_a_device_answers_the_same():
    tree = random_octree(depth=3)
    copy = tree.to("cpu")
    assert torch.equal(copy.leaf, tree.leaf)
    for a, b in zip(copy.levels, tree.levels, strict=True):
        assert torch.equal(a.neighbours, b.neighbours) and a.depth == b.depth
