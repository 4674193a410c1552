"""Morton keys: unique, reversible, ordered by shape, and their limits raise."""

import pytest
import torch

from riemlayer.octree import decode_key, encode_key
from riemlayer.octree.keys import MAX_BATCH, MAX_DEPTH


def random_cells(depth: int, n: int = 500) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.randint(1 << depth, (n, 3)), torch.randint(MAX_BATCH, (n,))


@pytest.mark.parametrize("depth", [0, 1, 5, 10, MAX_DEPTH])
def test_round_trip(depth):
    cell, batch = random_cells(depth)
    key = encode_key(cell, batch, depth)
    decoded, shape = decode_key(key, depth)
    assert torch.equal(decoded, cell) and torch.equal(shape, batch)
    assert (key >= 0).all()


def test_values():
    cell = torch.tensor([[0, 0, 1], [0, 1, 0], [1, 0, 0], [2, 0, 0], [3, 3, 3]])
    key = encode_key(cell, torch.zeros(5, dtype=torch.long), 2)
    assert key.tolist() == [1, 2, 4, 32, 63]


def test_parent_key_is_the_key_of_half_the_cell():
    cell, batch = random_cells(9)
    assert torch.equal(encode_key(cell, batch, 9) >> 3, encode_key(cell >> 1, batch, 8))


def test_sorted_keys_are_sorted_by_shape():
    cell, batch = random_cells(MAX_DEPTH)
    order = encode_key(cell, batch, MAX_DEPTH).argsort()
    assert (batch[order].diff() >= 0).all()


@pytest.mark.parametrize(
    "cell, batch, depth, words",
    [
        ([[0, 0, 0]], [0], MAX_DEPTH + 1, "depth must lie in"),
        ([[0, 0, 0]], [0], -1, "depth must lie in"),
        ([[0, 0, 0]], [MAX_BATCH], 4, f"fewer than {MAX_BATCH} shapes, got {MAX_BATCH + 1}"),
        ([[0, 16, 0]], [0], 4, r"cell must lie in \[0, 16\) at depth 4, got \[0, 16\]"),
        ([[0, 0, -1]], [0], 4, r"got \[-1, 0\]"),
    ],
)
def test_limits_raise(cell, batch, depth, words):
    with pytest.raises(ValueError, match=words):
        encode_key(torch.tensor(cell), torch.tensor(batch), depth)
