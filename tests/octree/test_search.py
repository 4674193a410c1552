"""Nearest neighbours and radius search agree with comparing every query with every point."""

import pytest
import torch

from riemlayer.octree import build_octree, knn, radius_search
from riemlayer.octree.search import Cloud

GENERATOR = torch.Generator()


def uniform(n):
    return 2 * torch.rand(n, 3, generator=GENERATOR, dtype=torch.float64) - 1


def clustered(n):
    """Half of the points in two tiny clusters, one of them at a corner of many cells."""
    x = uniform(n)
    x[: n // 4] = 1e-3 * x[: n // 4]
    x[n // 4 : n // 2] = 0.7 + 1e-4 * x[n // 4 : n // 2]
    return x


def line(n):
    return torch.linspace(-1, 1, n, dtype=torch.float64)[:, None].repeat(1, 3)


def duplicated(n):
    return uniform(n // 5 + 1).repeat(5, 1)[:n]


def packed(clouds):
    batch = torch.arange(len(clouds)).repeat_interleave(torch.tensor([len(x) for x in clouds]))
    return torch.cat(clouds), batch


def all_distances(points, batch, queries, query_batch):
    distance = (queries[:, None] - points).square().sum(-1).sqrt()
    return distance.masked_fill(query_batch[:, None] != batch, torch.inf)


@pytest.fixture(autouse=True)
def same_points():
    GENERATOR.manual_seed(0)


@pytest.mark.parametrize("make", [uniform, clustered, line, duplicated])
@pytest.mark.parametrize("depth, coarsest", [(0, 0), (3, 0), (6, 2), (9, 6)])
@pytest.mark.parametrize("k", [1, 7, 40])
def test_knn_finds_the_smallest_distances(make, depth, coarsest, k):
    points, batch = packed([make(300)])
    queries = torch.cat((points[::3], 1.0625 * uniform(60)))
    query_batch = torch.zeros(len(queries), dtype=torch.long)
    index, distance = knn(build_octree(points, batch, depth, coarsest), points, queries, k)
    expected = all_distances(points, batch, queries, query_batch).topk(k, largest=False)[0]
    assert torch.equal(distance, expected)
    assert torch.equal((queries[:, None] - points[index]).square().sum(-1).sqrt(), distance)
    assert all(len(set(row)) == k for row in index.tolist())


@pytest.mark.parametrize("make", [uniform, clustered, line, duplicated])
@pytest.mark.parametrize("depth, coarsest", [(0, 0), (6, 2), (9, 6)])
@pytest.mark.parametrize("radius", [0.0, 0.01, 0.3, 5.0])
def test_radius_search_finds_every_pair(make, depth, coarsest, radius):
    points, batch = packed([make(200)])
    queries = torch.cat((points[::3], 1.0625 * uniform(40)))
    distances = all_distances(points, batch, queries, torch.zeros(len(queries), dtype=torch.long))
    octree = build_octree(points, batch, depth, coarsest)
    query, point, distance = radius_search(octree, points, queries, radius)
    found = torch.zeros_like(distances, dtype=torch.bool)
    found[query, point] = True
    assert torch.equal(found, distances <= radius) and len(query) == int(found.sum())
    assert torch.equal(distance, distances[query, point])


def test_edges_are_sorted_by_query_then_distance():
    points, batch = packed([uniform(200)])
    query, _, distance = radius_search(build_octree(points, batch, 4), points, points, 0.4)
    step, growth = query.diff(), distance.diff()
    assert (step >= 0).all() and (growth[step == 0] >= 0).all() and (step > 0).any()


def test_neighbours_are_sorted_by_distance():
    points, batch = packed([uniform(200)])
    _, distance = knn(build_octree(points, batch, 4), points, points, 20)
    assert (distance.diff() >= 0).all() and (distance[:, 0] == 0).all()


@pytest.mark.parametrize("away", [1.1, 3.0, 1e3])
def test_queries_far_off_the_cube(away):
    points, batch = packed([uniform(300)])
    octree = build_octree(points, batch, 5, 2)
    directions = torch.nn.functional.normalize(uniform(30), dim=-1)
    queries = away * torch.cat((directions, torch.eye(3, dtype=torch.float64)))
    distances = all_distances(points, batch, queries, torch.zeros(len(queries), dtype=torch.long))
    assert torch.equal(knn(octree, points, queries, 5)[1], distances.topk(5, largest=False)[0])
    radius = float(distances.median())
    query, point, _ = radius_search(octree, points, queries, radius)
    assert len(query) == int((distances <= radius).sum())
    assert (distances[query, point] <= radius).all()


def test_shapes_of_a_batch_do_not_see_each_other():
    clouds = [uniform(120), 0.3 * uniform(40), uniform(9)]
    points, batch = packed(clouds)
    queries, query_batch = uniform(90), torch.arange(90) % 3
    octree = build_octree(points, batch, 5, 1)
    index, distance = knn(octree, points, queries, 9, query_batch)
    assert torch.equal(batch[index], query_batch[:, None].expand(-1, 9))
    query, point, apart = radius_search(octree, points, queries, 0.5, query_batch)
    assert torch.equal(batch[point], query_batch[query])
    for i, cloud in enumerate(clouds):
        own = query_batch == i
        alone = build_octree(cloud, torch.zeros(len(cloud), dtype=torch.long), 5, 1)
        assert torch.equal(knn(alone, cloud, queries[own], 9)[1], distance[own])
        assert torch.equal(radius_search(alone, cloud, queries[own], 0.5)[2], apart[own[query]])


def test_order_of_the_points_does_not_matter():
    points, batch = packed([uniform(300)])
    shuffle = torch.randperm(300, generator=GENERATOR)
    queries = uniform(50)
    index, distance = knn(build_octree(points, batch, 5, 2), points, queries, 8)
    moved = points[shuffle]
    again, same = knn(build_octree(moved, batch, 5, 2), moved, queries, 8)
    assert torch.equal(shuffle[again], index) and torch.equal(same, distance)


def test_float32_misses_nothing_beside_cell_borders():
    """Points and queries on the corners of cells, where rounding decides between neighbours."""
    step = 2.125 / 64
    corners = (torch.randint(-25, 25, (400, 3), generator=GENERATOR) * step).float()
    points = corners + 1e-7 * uniform(400).float()
    octree = build_octree(points, torch.zeros(400, dtype=torch.long), 6, 2)
    distances = all_distances(points, torch.zeros(400), corners, torch.zeros(400))
    _, distance = knn(octree, points, corners, 6)
    torch.testing.assert_close(distance, distances.topk(6, largest=False)[0], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("depth", [3, 6])
def test_a_block_holds_every_point_within_its_reach(depth):
    points, batch = packed([uniform(500)])
    cloud = Cloud.of(build_octree(points, batch, depth), points)
    queries = 1.5 * uniform(100)
    block = cloud.block(cloud.octree.level(depth), queries, torch.zeros(100, dtype=torch.long))
    distances = (queries[:, None] - points).norm(dim=-1)
    for start, count, reach, distance in zip(*block, distances, strict=True):
        held = [range(a, a + n) for a, n in zip(start.tolist(), count.tolist(), strict=True)]
        places = torch.tensor([place for run in held for place in run], dtype=torch.long)
        assert set((distance <= reach).nonzero().flatten().tolist()) <= set(
            cloud.order[places].tolist()
        )


def test_many_pairs_go_in_parts(monkeypatch):
    points, batch = packed([clustered(300)])
    octree = build_octree(points, batch, 4, 1)
    whole = knn(octree, points, points, 5)[1], radius_search(octree, points, points, 0.3)[2]
    monkeypatch.setattr("riemlayer.octree.search.PAIRS", 64)
    assert torch.equal(knn(octree, points, points, 5)[1], whole[0])
    assert torch.equal(radius_search(octree, points, points, 0.3)[2], whole[1])


def test_no_queries():
    points, batch = packed([uniform(20)])
    octree = build_octree(points, batch, 3)
    assert knn(octree, points, points[:0], 4)[0].shape == (0, 4)
    assert [x.shape for x in radius_search(octree, points, points[:0], 0.1)] == [(0,)] * 3


def test_rejects_bad_input():
    points, batch = packed([uniform(20), uniform(5)])
    octree = build_octree(points, batch, 3)
    shapes = torch.tensor([0, 1])
    with pytest.raises(ValueError, match=r"`k` must not exceed .* got 6 where a shape has 5"):
        knn(octree, points, points[:2], 6, shapes)
    assert knn(octree, points, points[:2], 6, 0 * shapes)[0].shape == (2, 6)
    with pytest.raises(ValueError, match="`k` must be at least 1, got 0"):
        knn(octree, points, points[:2], 0, shapes)
    with pytest.raises(ValueError, match=r"`radius` must be a number of at least 0, got -1"):
        radius_search(octree, points, points[:2], -1.0, shapes)
    with pytest.raises(ValueError, match="`radius` must be a number of at least 0, got nan"):
        radius_search(octree, points, points[:2], float("nan"), shapes)
    with pytest.raises(ValueError, match=r"`query_batch` must lie in \[0, 2\)"):
        knn(octree, points, points[:2], 1, shapes + 1)
    with pytest.raises(ValueError, match=r"`query_batch` must have shape \(3,\)"):
        knn(octree, points, points[:3], 1, shapes[:1])
    with pytest.raises(ValueError, match=r"`queries` must have shape \(Q, 3\)"):
        knn(octree, points, points[0], 1)
    with pytest.raises(ValueError, match="`queries` must have dtype"):
        knn(octree, points, points[:2].float(), 1)
    with pytest.raises(ValueError, match=r"`points` must be the \(25, 3\) points"):
        knn(octree, points[:7], points[:2], 1)
