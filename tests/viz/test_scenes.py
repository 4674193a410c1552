"""The pictures of papers: what each shows of a surface, on a ball where the truth is known."""

import numpy as np
import pytest
import torch

from riemlayer import EncodedSurface, ExpLogField
from riemlayer.ops import stitch_log
from riemlayer.viz import (
    Canvas,
    draw_errors,
    draw_exp,
    draw_geodesics,
    draw_log,
    draw_stitched,
    draw_validity,
)


@pytest.fixture(scope="module")
def surface() -> EncodedSurface:
    generator = torch.Generator().manual_seed(0)
    x = torch.nn.functional.normalize(torch.randn(3000, 3, generator=generator), dim=-1)
    with torch.inference_mode():
        return ExpLogField.from_pretrained("base").encode(x)


@pytest.fixture(scope="module")
def canvas(surface) -> Canvas:
    return Canvas(surface.points)


def arcs(points: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Distances along the unit sphere."""
    return np.arccos((points @ p).clip(-1, 1))


@pytest.mark.parametrize("texture", ["checker", "polar"])
def test_log_has_the_lengths_of_the_arcs_and_is_trusted_within_the_radius(surface, canvas, texture):
    p = canvas.points[5]
    drawing = draw_log(surface, p, canvas, texture=texture)
    assert drawing.texture == texture and drawing.canvas is canvas
    assert drawing.log is not None and drawing.valid is not None
    arc, length = arcs(canvas.points, p), np.linalg.norm(drawing.log, axis=1)
    trusted = drawing.valid > 0.5
    assert trusted[arc < 0.8 * drawing.radius].mean() > 0.98
    assert np.abs(length - arc)[trusted & (arc < drawing.radius)].mean() < 0.03
    shown = trusted & (length <= drawing.radius)
    assert shown.any() and arc[shown].max() < 1.15 * drawing.radius


def test_a_log_map_is_drawn_less_where_it_is_trusted_less(surface, canvas):
    p = canvas.points[5]
    log = draw_log(surface, p, canvas, radius=2.5)
    validity = draw_validity(surface, p, canvas)
    assert (log.valid <= validity.values + 1e-6).all()
    with torch.inference_mode():
        _, info = surface.log(torch.tensor(p).float(), surface.points, return_info=True)
    assert np.allclose(validity.values, info.validity, atol=1e-5)
    astray = info.cycle_error.numpy() > 0.2 * 2.5
    assert (log.valid[astray] <= 0.5 + 1e-6).all()


def test_the_tiles_of_two_sources_differ_and_turn_with_the_frame_alone(surface, canvas):
    one, two = (draw_log(surface, canvas.points[i], canvas) for i in (5, 6))
    assert not np.allclose(one.log, two.log)
    board, grid = (
        draw_log(surface, canvas.points[5], canvas, texture=t) for t in ("checker", "polar")
    )
    assert np.array_equal(board.log, grid.log)


def test_exp_is_a_fan_of_great_circles(surface, canvas):
    p = canvas.points[5]
    drawing = draw_exp(surface, p, canvas, rays=12, radius=0.4)
    paths = np.stack(drawing.paths)
    assert paths.shape[0] == 12 and np.allclose(paths[:, 0], p, atol=1e-5)
    assert np.abs(np.linalg.norm(paths, axis=-1) - 1).max() < 0.05
    assert np.abs(arcs(paths[:, -1], p) - 0.4).mean() < 0.04
    start = paths[:, 1] - p
    start /= np.linalg.norm(start, axis=1, keepdims=True)
    turn = (start * np.roll(start, 1, axis=0)).sum(1)
    assert np.allclose(turn, np.cos(2 * np.pi / 12), atol=0.05), "evenly around p"


def test_geodesics_begin_and_end_where_they_should(surface, canvas):
    p, arc = canvas.points[5], arcs(canvas.points, canvas.points[5])
    q = canvas.points[(arc > 0.1) & (arc < 0.4)][:20]
    paths = np.stack(draw_geodesics(surface, p, q, canvas).paths)
    assert np.allclose(paths[:, 0], p, atol=1e-5) and np.allclose(paths[:, -1], q, atol=1e-5)
    length = np.linalg.norm(np.diff(paths, axis=1), axis=-1).sum(1)
    assert np.abs(length / arcs(q, p) - 1).mean() < 0.05


def test_an_atlas_has_a_colour_for_each_chart(surface, canvas):
    p = surface.points[5]
    stitched = stitch_log(surface, p, surface.points, depth=2)
    drawing = draw_stitched(stitched, canvas, p, float(surface.radius))
    centres = stitched.charts.centre.numpy()
    assert drawing.colours is not None and drawing.dots is not None
    assert len(centres) > 3 and drawing.title == f"{len(centres)} charts"
    assert np.array_equal(drawing.valid > 0.5, stitched.covered.numpy())
    nearest = np.linalg.norm(canvas.points[:, None] - centres, axis=-1).argmin(1)
    for i in range(len(centres)):
        assert len(np.unique(drawing.colours[nearest == i], axis=0)) <= 1
    beside = np.linalg.norm(centres[:, None] - centres, axis=-1) + 9 * np.eye(len(centres))
    own = [drawing.colours[nearest == i][0] for i in range(len(centres))]
    assert any((own[0] != own[j]).any() for j in beside.argsort(1)[0, :3])


def test_errors_share_a_scale_in_radii(canvas):
    rng = np.random.default_rng(0)
    errors = {name: rng.uniform(0.1, 0.7, len(canvas.points)) for name in "abc"}
    drawings = draw_errors(canvas, errors, radius=0.5)
    every = np.stack(list(errors.values())) / 0.5
    assert [x.title for x in drawings] == ["a", "b", "c"]
    for drawing, values in zip(drawings, every, strict=True):
        assert np.allclose(drawing.values, values)
        assert drawing.limits == pytest.approx((every.min(), every.max()))
        assert "radius" in drawing.label
    hidden = every[0] < 1
    shown = draw_errors(canvas, {"a": errors["a"]}, 0.5, valid=~hidden)[0]
    assert shown.limits == pytest.approx((every[0][~hidden].min(), every[0].max()))
    assert draw_errors(canvas, errors, 0.5, limits=(0, 1))[1].limits == (0, 1)


def test_bad_arguments_are_named(surface, canvas):
    p = canvas.points[0]
    with pytest.raises(ValueError, match=r"`p` must be one point \(3,\), got \(2, 3\)"):
        draw_log(surface, canvas.points[:2], canvas)
    with pytest.raises(ValueError, match=r"`q` must have shape \(K, 3\), got \(3,\)"):
        draw_geodesics(surface, p, p, canvas)
    for draw in (draw_log, draw_exp):
        with pytest.raises(ValueError, match="`radius` must be positive, got -1"):
            draw(surface, p, canvas, radius=-1)
    with pytest.raises(ValueError, match="`radius` must be positive, got 0"):
        draw_errors(canvas, {}, 0)
    with pytest.raises(ValueError, match="`errors` must hold at least one method"):
        draw_errors(canvas, {}, 1)
