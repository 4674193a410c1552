"""The cube that a cloud is put into: centred, as large as it, smaller for sparse clouds."""

import math

import pytest
import torch
from references import fibonacci_sphere, lumpy, packed, shaken

from riemlayer.field import APART, SMALLEST, bounding_cubes, size_in_cube


def test_bounding_cubes():
    points, batch = packed(torch.tensor([[0.0, 0, 0], [4, 1, 2]]), torch.tensor([[5.0, 5, 5]] * 2))
    centre, scale = bounding_cubes(points, batch)
    assert centre.tolist() == [[2, 0.5, 1], [5, 5, 5]] and scale.tolist() == [2, 0]


def test_encode_centres_and_scales_dense_clouds_to_the_cube_and_no_more():
    points, field = 5 * lumpy(2000) + 3, shaken("tiny")
    low, high = points.amin(0), points.amax(0)
    x = (points - (low + high) / 2) / ((high - low).max() / 2)
    in_cube = field.encode_in_cube(x, torch.zeros(2000, dtype=torch.long))
    for a, b in zip(field.encode(points).embedding[:2], in_cube.embedding[:2], strict=True):
        torch.testing.assert_close(a, b)


@pytest.mark.parametrize("apart", [0.03, 0.05])
def test_clouds_are_smaller_in_the_cube_the_further_their_points_are_apart(apart):
    counts = 10_000, 4_000, 2_000, 20
    points, batch = packed(*(fibonacci_sphere(n) for n in counts))
    size = size_in_cube(points, batch, apart)
    spacing = [math.sqrt(4 * math.pi / n) for n in counts]
    for own, d in zip(size.tolist(), spacing, strict=True):
        assert own == pytest.approx(min(1, max(SMALLEST, apart / d)), rel=0.2)
    assert size[-1] == SMALLEST and (size.diff() <= 0).all()
    for i in range(len(counts)):  # a batch is its clouds
        alone = points[batch == i]
        assert size_in_cube(alone, torch.zeros(len(alone), dtype=torch.long), apart) == size[i]


def test_a_sparse_cloud_is_encoded_at_the_size_it_is_given():
    points, field = lumpy(60), shaken("tiny")
    leaf = 2 / 2**field.config.backbone.depth
    _, scale = bounding_cubes(points, batch := torch.zeros(60, dtype=torch.long))
    surface = field.encode(points)
    size = float(scale / surface.scale)
    assert SMALLEST <= size < 1
    torch.testing.assert_close(surface.radius, field.config.radius * scale[0])
    x = (points - surface.centre) / scale
    assert size == float(size_in_cube(x, batch, APART * leaf))
    in_cube = field.encode_in_cube(size * x, batch)
    p, v = points[:5], 0.1 * torch.randn(5, 7, 3, dtype=points.dtype)
    end = in_cube.exp(size * x[:5, None], v / surface.scale)
    torch.testing.assert_close(surface.exp(p[:, None], v), surface.centre + surface.scale * end)


def test_radius_is_in_the_users_units():
    field = shaken("tiny")
    surface = field.encode(*packed(lumpy(50), 10 * lumpy(50)))
    torch.testing.assert_close(surface[1].radius, 10 * surface[0].radius)
    assert float(field.encode(fibonacci_sphere(500)).radius) == pytest.approx(0.5, rel=0.01)
