"""Look-up at any point: dense trilinear on a full grid, convex and finite everywhere."""

import pytest
import torch
from references import dense_lookup, full_octree, random_octree

from riemlayer.octree import (
    HALF_WIDTH,
    build,
    corners,
    interpolate,
    interpolate_or_zero,
    nearest_node,
)


def queries(n: int = 400, reach: float = 1.0) -> torch.Tensor:
    return (2 * torch.rand(n, 3, dtype=torch.float64) - 1) * (reach * HALF_WIDTH)


def of_shape(n: int, shape: int = 0) -> torch.Tensor:
    return torch.full((n,), shape)


@pytest.mark.parametrize("depth", [1, 3])
@pytest.mark.parametrize("limit", [1 << 25, 0], ids=["dense grid", "sorted keys"])
def test_look_up_is_dense_trilinear(depth, limit, monkeypatch):
    monkeypatch.setattr(build, "DENSE_LIMIT", limit)
    level = full_octree(depth).level(depth)
    features = torch.randn(len(level), 5, dtype=torch.float64)
    x = queries(reach=1.3)  # past the walls too: both take the border
    value, supported = interpolate(features, level, x, of_shape(len(x)))
    torch.testing.assert_close(value, dense_lookup(features, level, x), rtol=0, atol=1e-12)
    assert supported.all()


def test_a_query_at_a_centre_takes_the_feature_there():
    level = random_octree(depth=3).level(3)
    features = torch.randn(len(level), 4, dtype=torch.float64)
    value, supported = interpolate(features, level, level.centres().double(), level.batch())
    torch.testing.assert_close(value, features)
    assert supported.all()


def test_a_feature_that_is_linear_in_space_is_met_exactly():
    level = full_octree(3).level(3)
    slope = torch.randn(3, 2, dtype=torch.float64)
    x = queries(reach=0.87)  # inside the outermost centres
    value, _ = interpolate(level.centres().double() @ slope, level, x, of_shape(len(x)))
    torch.testing.assert_close(value, x @ slope)


def test_weights_are_never_negative_and_answers_stay_between_the_features():
    level = random_octree(depth=3, n=80).level(3)
    x = torch.cat((queries(500), queries(500, reach=4.0), queries(50, reach=1e4)))
    shape = torch.arange(len(x)) % 2
    node, weight = corners(level, x, shape)
    assert (weight >= 0).all() and (weight.sum(-1) <= 1 + 1e-12).all()
    assert (weight[node == len(level)] == 0).all()
    features = torch.rand(len(level), 3, dtype=torch.float64)
    value, _ = interpolate(features, level, x, shape)
    assert (value >= -1e-12).all() and (value <= 1 + 1e-12).all()


def test_a_constant_stays_itself_on_any_support():
    level = random_octree(depth=4, n=40).level(4)
    x = queries()
    ones = torch.ones(len(level), 2, dtype=torch.float64)
    value, _ = interpolate(ones, level, x, of_shape(len(x), 1))
    torch.testing.assert_close(value, torch.ones_like(value))


def test_off_the_support_the_nearest_node_answers_and_says_so():
    points = torch.tensor([[-0.9, -0.9, -0.9], [-0.8, -0.9, -0.9], [0.1, 0, 0], [0.9, 0.9, 0.9]])
    tree = build.build_octree(points, torch.tensor([0, 0, 0, 1]), depth=4)
    level = tree.level(4)
    features = torch.randn(len(level), 3)
    x = torch.tensor([[0.95, 0.95, 0.95], [-0.85, -0.9, -0.9], [50.0, 0, 0], [0.0, 0.9, 0.9]])
    value, supported = interpolate(features, level, x, torch.zeros(4, dtype=torch.long))
    assert supported.tolist() == [False, True, False, False]
    assert value.isfinite().all()
    near = tree.leaf[2]  # of shape 0; the node of shape 1 lies nearer to the first query
    torch.testing.assert_close(value[[0, 2]], features[near].expand(2, 3))
    zero = interpolate_or_zero(features, level, x, torch.zeros(4, dtype=torch.long))
    assert torch.equal(zero[~supported], torch.zeros(3, 3))
    torch.testing.assert_close(zero[supported], value[supported])


def test_nearest_node_is_that_of_a_loop():
    level = random_octree(depth=4).level(4)
    x, shape = queries(60).float(), torch.arange(60) % 2
    found = nearest_node(level, x, shape, chunk=7)
    for point, b, i in zip(x, shape, found, strict=True):
        mine = (level.batch() == b).nonzero().squeeze(-1)
        distance = (level.centres()[mine] - point).norm(dim=-1)
        assert i == mine[distance.argmin()]


def test_gradcheck():
    level = random_octree(depth=2, n=20).level(2)
    features = torch.randn(len(level), 2, dtype=torch.float64, requires_grad=True)
    x, shape = queries(12).requires_grad_(), torch.arange(12) % 2

    def look_up(features, x):
        return interpolate(features, level, x, shape)[0]

    assert torch.autograd.gradcheck(look_up, (features, x), check_forward_ad=True)


def test_no_queries_give_no_answers():
    level = random_octree(depth=2).level(2)
    value, supported = interpolate(torch.rand(len(level), 3), level, torch.rand(0, 3), of_shape(0))
    assert value.shape == (0, 3) and supported.shape == (0,)
    assert nearest_node(level, torch.rand(0, 3), of_shape(0)).shape == (0,)
