"""Farthest points, cells and pooling, against a dense matrix of shortest paths."""

import math

import pytest
import torch
from nn.geometry import Case, angles, packed, permuted, sphere, without_edges
from torch import nn
from torch.autograd import gradcheck

from riemlayer.nn import Cells, GeodesicPool, GeodesicUnpool, geodesic_cells


def shortest_paths(geometry) -> torch.Tensor:
    """(N, N) lengths over valid edges, both ways, by Floyd and Warshall."""
    n = geometry.points
    d = torch.full((n, n), torch.inf, dtype=torch.float64).fill_diagonal_(0)
    for (i, j), r, valid in zip(geometry.edge_index.T, geometry.r, geometry.valid, strict=True):
        if valid:
            d[i, j] = d[j, i] = min(d[i, j], r)
    for k in range(n):
        d = torch.minimum(d, d[:, k, None] + d[None, k])
    return d


def test_each_kept_point_is_the_farthest_from_those_before_it():
    g = sphere(60).geometry
    d = shortest_paths(g)
    order = [int(g.radius.argmax())]
    for count in range(1, 12):
        cells = geodesic_cells(g, [count])
        assert cells.index.tolist() == sorted(order)
        order.append(int(d[order].amin(0).argmax()))


def test_each_point_belongs_to_the_nearest_kept_one():
    g = sphere(60).geometry
    cells = geodesic_cells(g, [9])
    distance, owner = shortest_paths(g)[cells.index].min(0)
    torch.testing.assert_close(cells.distance, distance)
    assert torch.equal(cells.assignment, owner)
    assert torch.equal(cells.assignment[cells.index], torch.arange(9))


def test_clouds_do_not_mix():
    together, alone = packed(20, 33, 12)
    cells = geodesic_cells(together.geometry, [5, 7, 3])
    single = [geodesic_cells(c.geometry, [k]) for c, k in zip(alone, (5, 7, 3), strict=True)]
    shifts, starts = (0, 20, 53), (0, 5, 12)
    index = [c.index + s for c, s in zip(single, shifts, strict=True)]
    assignment = [c.assignment + s for c, s in zip(single, starts, strict=True)]
    assert torch.equal(cells.index, torch.cat(index))
    assert torch.equal(cells.assignment, torch.cat(assignment))
    assert torch.equal(cells.batch[cells.assignment], together.geometry.batch)


def test_the_order_of_the_points_does_not_matter():
    case, order = sphere(60), torch.randperm(60)
    a, b = (geodesic_cells(c.geometry, [9]) for c in (case, permuted(case, order)))
    assert set(order[b.index].tolist()) == set(a.index.tolist())
    assert torch.equal(order[b.index][b.assignment], a.index[a.assignment][order])


def test_points_beyond_the_last_edge_are_kept_first_or_join_the_first():
    case = sphere(10)
    g = without_edges(case)
    assert geodesic_cells(g, [10]).index.tolist() == list(range(10))
    cells = geodesic_cells(g, [3])
    assert cells.assignment.bincount().max() == 8 and len(cells.index.unique()) == 3
    assert int(cells.distance.isinf().sum()) == 7


def test_coincident_points_are_kept_once_each():
    g = sphere(20).geometry
    g = g._replace(r=torch.zeros_like(g.r))
    cells = geodesic_cells(g, [20])
    assert cells.index.tolist() == list(range(20))
    assert torch.equal(cells.assignment, torch.arange(20))


def test_invalid_edges_are_not_walked():
    g = sphere(60).geometry
    g = g._replace(valid=torch.rand(len(g.valid)) > 0.3)
    cells = geodesic_cells(g, [9])
    torch.testing.assert_close(cells.distance, shortest_paths(g)[cells.index].amin(0))


CELLS = Cells(
    index=torch.tensor([1, 3]),
    assignment=torch.tensor([0, 0, 1, 1, 0]),
    distance=torch.zeros(5),
    batch=torch.zeros(2).long(),
)


def test_reductions_by_hand():
    x = torch.tensor([[1.0], [3.0], [10.0], [20.0], [5.0]])
    g = sphere(5, 3).geometry
    mean, maximum = GeodesicPool(count=2), GeodesicPool(count=2, reduce="max")
    attention = GeodesicPool(count=2, reduce="attention", channels=1)
    assert mean(x, g, CELLS)[0].flatten().tolist() == [3, 15]
    assert maximum(x, g, CELLS)[0].flatten().tolist() == [5, 20]
    for parameter in attention.parameters():
        nn.init.constant_(parameter, math.log(2))  # softmax in powers of 2
    expected = [(1 * 2 + 3 * 8 + 5 * 32) / 42, (10 + 20 * 1024) / 1025]
    assert attention(x, g, CELLS)[0].flatten().tolist() == pytest.approx(expected)


@pytest.mark.parametrize("reduce", ["mean", "max", "attention"])
def test_pooling_undoes_unpooling_and_keeps_constants(reduce):
    channels = 3 if reduce == "attention" else None
    pool, g = (
        GeodesicPool(ratio=0.2, reduce=reduce, channels=channels).double(),
        sphere(60).geometry,
    )
    cells = pool.cells(g)
    x = torch.randn(len(cells.index), 3, dtype=torch.float64)
    spread = GeodesicUnpool()(x, cells)
    again, same = pool(spread, g)
    torch.testing.assert_close(again, x)
    assert torch.equal(same.index, cells.index) and len(cells.index) == 12
    constant = torch.full((60, 3), 2.5, dtype=torch.float64)
    torch.testing.assert_close(pool(constant, g, cells)[0], constant[:12])


@pytest.mark.parametrize("reduce", ["mean", "max", "attention"])
def test_gradients_agree_with_differences(reduce):
    channels = 2 if reduce == "attention" else None
    pool = GeodesicPool(count=2, reduce=reduce, channels=channels).double()
    g = sphere(5, 3).geometry
    x = torch.randn(5, 2, dtype=torch.float64, requires_grad=True)
    assert gradcheck(lambda x: pool(x, g, CELLS)[0], (x,))


def test_gradients_of_unpooling_agree_with_differences():
    x = torch.randn(2, 3, dtype=torch.float64, requires_grad=True)
    assert gradcheck(lambda x: GeodesicUnpool()(x, CELLS), (x,))


@pytest.mark.parametrize("reduce", ["mean", "max", "attention"])
def test_turning_the_frames_changes_neither_answers_nor_gradients(reduce):
    channels = 3 if reduce == "attention" else None
    pool = GeodesicPool(ratio=0.2, reduce=reduce, channels=channels).double()
    g, x = sphere(60).geometry, torch.randn(60, 3, dtype=torch.float64, requires_grad=True)
    (y, cells), (z, same) = pool(x, g), pool(x, g.turned(angles(60)))
    torch.testing.assert_close(z, y)
    assert all(torch.equal(a, b) for a, b in zip(cells, same, strict=True))
    inputs = [x, *pool.parameters()]
    for a, b in zip(*(torch.autograd.grad(o.square().sum(), inputs) for o in (y, z)), strict=True):
        torch.testing.assert_close(a, b)


def test_counts_and_ratios_of_each_cloud():
    together, _ = packed(20, 33, 12)
    for pool, expected in (
        (GeodesicPool(ratio=0.25), [5, 9, 3]),
        (GeodesicPool(count=15), [15, 15, 12]),
        (GeodesicPool(ratio=1.0), [20, 33, 12]),
    ):
        assert pool.cells(together.geometry).batch.bincount().tolist() == expected


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "either ratio or count"),
        ({"ratio": 0.5, "count": 3}, "either ratio or count"),
        ({"ratio": 0.0}, r"ratio must lie in \(0, 1\], got 0.0"),
        ({"ratio": 1.5}, r"ratio must lie in \(0, 1\], got 1.5"),
        ({"count": 0}, "count must be at least 1, got 0"),
        ({"count": 3, "reduce": "sum"}, "reduce must be one of .* got 'sum'"),
        (
            {"count": 3, "reduce": "attention"},
            "channels must be given for attention only, got None",
        ),
        ({"count": 3, "channels": 4}, "channels must be given for attention only, got 4"),
    ],
)
def test_what_cannot_be_pooled_is_said(options, words):
    with pytest.raises(ValueError, match=words):
        GeodesicPool(**options)


@pytest.mark.parametrize("counts", [[0], [61], [3, 3], []])
def test_counts_that_no_cloud_has_are_refused(counts):
    with pytest.raises(ValueError, match="counts must have an entry in"):
        geodesic_cells(sphere(60).geometry, counts)


def test_features_of_another_size_are_refused():
    case: Case = sphere()
    with pytest.raises(ValueError, match="`x` must have shape"):
        GeodesicPool(count=3)(torch.zeros(39, 3), case.geometry)
    with pytest.raises(ValueError, match="`x` must have shape"):
        GeodesicUnpool()(torch.zeros(5, 3), CELLS)
