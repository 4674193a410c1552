"""Planes of several scales and shapes: one look-up for all of them."""

import pytest
import torch
from references import fibonacci_sphere, lumpy

from riemlayer.geometry import LocalPlanes, planes_at_scales
from riemlayer.octree import build_octree


@pytest.fixture
def several() -> LocalPlanes:
    """Of two clouds at three scales, of which walks look for rims at the first and the last."""
    clouds = lumpy(900), 0.7 * fibonacci_sphere(500)
    shape = torch.arange(2).repeat_interleave(torch.tensor([900, 500]))
    octree = build_octree(torch.cat(clouds), shape, 6)
    return planes_at_scales(torch.cat(clouds), octree, (1, 0, 2), rims=2)


@pytest.mark.parametrize("dense", [True, False])
def test_queries_of_all_scales_and_shapes_are_answered_at_once_as_alone(several, dense):
    """Also without the table of all cells, which large batches do not have."""
    if not dense:
        several = several._replace(grids=several.grids._replace(cells=None))
    x = 1.02 * lumpy(900)[::3]
    place = torch.randint(0, 6, (len(x),))
    towards = torch.nn.functional.normalize(torch.randn_like(x), dim=-1)
    together = (*several.look(x, place, towards), *several.plane(x, place))
    together = *together, several.cell(place), several.has_rims(place), several.may_end(x, place)
    for i, scale in enumerate(several.scales):
        alone = LocalPlanes.of([scale])
        rows = (place // 2 == i).nonzero().squeeze(-1)
        y, shape, up = x[rows], place[rows] % 2, towards[rows]
        expected = (*alone.look(y, shape, up), *alone.plane(y, shape))
        expected = *expected, alone.cell(shape), alone.has_rims(shape), alone.may_end(y, shape)
        for got, want in zip(together, expected, strict=True):
            torch.testing.assert_close(got[rows], want)
        assert set(shape.tolist()) == {0, 1} and bool(alone.rims) == (i != 1)


def test_scales_share_their_levels(several):
    """The coarse planes of one scale are the fine ones of the next."""
    main, fine, wide = several.scales
    assert fine.coarse is main.fine and main.coarse is wide.fine
    assert len(several.grids.levels) == 7 and several.cells.tolist() == [
        scale.fine.level.cell_size for scale in several.scales
    ]
    moved = several.map(lambda y: y.clone())
    assert moved.scales[1].coarse is moved.scales[0].fine and len(moved.grids.levels) == 7
