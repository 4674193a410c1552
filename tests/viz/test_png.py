"""Pictures: what they show, pixel by pixel where the truth is known."""

import sys

import numpy as np
import pytest
from flat import flat_canvas, flat_drawing, from_above, places

from riemlayer.viz import Drawing, checkerboard, colour_map, polar_grid, write_png
from riemlayer.viz.palette import BLUE, CREAM, PLAIN
from riemlayer.viz.sheet import tick_labels

Image = pytest.importorskip("PIL.Image")
pytest.importorskip("pyvista")
SIZE = 160


def picture(tmp_path, *drawings: Drawing, **how) -> np.ndarray:
    """Pixels in [0, 1]."""
    path = write_png(tmp_path / "picture.png", *drawings, view=from_above(), size=SIZE, **how)
    return np.asarray(Image.open(path), float) / 255


def away_from_edges(colours: np.ndarray) -> np.ndarray:
    """Pixels whose neighbours within two pixels have the same colour."""
    same = np.ones(colours.shape[:2], bool)
    for dx in range(-2, 3):
        for dy in range(-2, 3):
            same &= (np.roll(colours, (dy, dx), (0, 1)) == colours).all(-1)
    return same


def light(seen: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Brightness by which each pixel's colour was multiplied; fails where the colour is another."""
    ratio = seen / colours.clip(0.05)
    ratio = ratio[(colours > 0.2).all(-1)]
    assert np.ptp(ratio, axis=-1).max() < 0.03
    return ratio


@pytest.mark.parametrize("mesh", [True, False])
@pytest.mark.parametrize("texture, tiles", [("checker", checkerboard), ("polar", polar_grid)])
def test_tiles_have_the_colours_of_the_closed_form(tmp_path, mesh, texture, tiles):
    """On a flat square the log map is the identity, so every pixel is known."""
    seen = picture(tmp_path, flat_drawing(mesh, texture=texture, p=None))
    x = places(SIZE)
    inner = np.abs(x).max(-1) < 0.47
    wanted = tiles(x, radius=0.3)
    sure = away_from_edges(wanted) & inner
    assert sure.sum() > 0.4 * inner.sum()
    brightness = light(seen[sure], wanted[sure])
    assert brightness.std() < 0.02 and 0.7 < brightness.mean() <= 1
    blue = (wanted == BLUE).all(-1) & sure
    assert np.abs(seen[blue] / brightness.mean() - BLUE).max() < 0.04
    for colour in (BLUE, CREAM, PLAIN):
        assert (wanted[sure] == colour).all(-1).sum() > 100


@pytest.mark.parametrize("mesh", [True, False])
def test_values_have_the_colours_of_the_map(tmp_path, mesh):
    canvas = flat_canvas(mesh)
    drawing = Drawing(canvas, values=canvas.points[:, 0])
    seen = picture(tmp_path, drawing)[:, :SIZE]
    x = places(SIZE)
    inner = np.abs(x).max(-1) < 0.44
    wanted = colour_map(x[..., 0] + 0.5)[inner]
    light_ = light(seen[inner], wanted).mean()
    assert np.abs(seen[inner] / light_ - wanted).max() < (0.03 if mesh else 0.08)


def test_invalid_points_are_plain_up_to_a_clean_edge(tmp_path):
    """No colour of the map's low end leaks in between, as blending with a zero would make it."""
    canvas = flat_canvas(mesh=True)
    values = np.where(canvas.points[:, 0] > 0.01, np.nan, 1.0)
    seen = picture(tmp_path, Drawing(canvas, values=values, limits=(0, 1)))[:, :SIZE]
    x = places(SIZE)
    inner = np.abs(x).max(-1) < 0.47
    high, low = colour_map([1.0, 0.0])
    assert np.abs(seen[inner & (x[..., 0] > 0.06)] - seen[SIZE // 2, -40]).max() < 0.02
    seen = seen[inner] / seen[SIZE // 2, 30].max() * high.max()
    assert np.linalg.norm(seen - low, axis=-1).min() > 0.4


def test_colours_and_charts_are_tinted(tmp_path):
    """A tint alone, and as the dark half of a checkerboard."""
    canvas = flat_canvas(mesh=True)
    tint = np.tile([0.8, 0.3, 0.1], (len(canvas.points), 1))
    plain = picture(tmp_path, Drawing(canvas, colours=tint))
    tiled = picture(tmp_path, Drawing(canvas, colours=tint, log=canvas.points[:, :2], radius=9))
    board = checkerboard(places(SIZE), radius=9)
    sure = away_from_edges(board) & (np.abs(places(SIZE)).max(-1) < 0.47)
    dark = (board == BLUE).all(-1)
    assert np.abs(plain[sure & dark] - tiled[sure & dark]).max() < 0.02
    assert (tiled[sure & ~dark] > plain[sure & ~dark] + 0.05).all()


def test_coarse_triangles_carry_crisp_tiles(tmp_path):
    """Two triangles show the same tiles as eight hundred."""
    coarse, fine = (flat_canvas(mesh=True, n=n) for n in (2, 21))
    pictures = [
        picture(tmp_path, Drawing(canvas, log=canvas.points[:, :2], radius=0.3))
        for canvas in (coarse, fine)
    ]
    assert np.abs(pictures[0] - pictures[1]).max() < 0.02


def test_torn_triangles_are_plain(tmp_path):
    """Where a map jumps (cut locus) the tiles between are squeezed together; none are drawn."""
    canvas = flat_canvas(mesh=True)
    log = canvas.points[:, :2].copy()
    log[canvas.points[:, 0] > 0.01] += [7, 0]
    seen = picture(tmp_path, Drawing(canvas, log=log, radius=99))
    x = places(SIZE)
    torn = (x[..., 0] > 0.008) & (x[..., 0] < 0.042) & (np.abs(x[..., 1]) < 0.45)
    grey = seen[torn].mean(0) / seen[torn].mean()
    assert np.abs(grey - np.array(PLAIN) / np.mean(PLAIN)).max() < 0.02
    assert np.ptp(seen[torn].mean(-1)) < 0.05


def test_lines_and_marks_are_seen(tmp_path):
    line = np.linspace([-0.4, 0.2, 0], [0.4, 0.2, 0], 9)
    canvas = flat_canvas(mesh=True)
    bare = picture(tmp_path, Drawing(canvas))
    for content, at in (
        ({"paths": [line]}, (0, 0.2)),
        ({"reference": [line]}, (0, 0.2)),
        ({"p": [0.3, -0.3, 0]}, (0.3, -0.3)),
        ({"dots": [[-0.3, -0.3, 0]]}, (-0.3, -0.3)),
    ):
        changed = np.abs(picture(tmp_path, Drawing(canvas, **content)) - bare).max(-1) > 0.1
        nearest = np.linalg.norm(places(SIZE) - at, axis=-1) < 0.015
        assert changed[nearest].any()
        assert changed[np.abs(places(SIZE) - at).min(-1) > 0.06].mean() < 0.01


def test_titles_and_bars_come_in_addition_to_the_parts(tmp_path):
    canvas = flat_canvas(mesh=True)
    bare = picture(tmp_path, Drawing(canvas))
    assert bare.shape == (SIZE, SIZE, 3)
    titled = picture(tmp_path, Drawing(canvas, title="a title"))
    assert titled.shape[0] > SIZE and np.array_equal(titled[-SIZE:], bare)
    assert titled[:-SIZE].min() < 0.5
    values = Drawing(canvas, values=canvas.points[:, 0])
    one = picture(tmp_path, values)
    assert one.shape[1] > SIZE
    shared = picture(tmp_path, values, values)
    assert shared.shape[1] == SIZE + one.shape[1], "two drawings on one scale share a bar"
    apart = picture(tmp_path, values, values.replace(limits=(0, 3)))
    assert apart.shape[1] == 2 * one.shape[1]


def test_colour_bar_runs_over_the_map_and_its_ends_are_those_of_the_data(tmp_path):
    canvas = flat_canvas(mesh=True)
    drawing = Drawing(canvas, values=3 + canvas.points[:, 0])
    assert [float(x) for x in tick_labels(drawing)] == [2.5, 2.75, 3, 3.25, 3.5]
    strip = picture(tmp_path, drawing)[:, SIZE:]
    column = strip[:, int(0.0375 * SIZE)]
    shades = column[np.ptp(column, axis=-1) > 0.15][1:-1]  # without the frame
    wanted = colour_map(np.linspace(1, 0, len(shades)))
    assert len(shades) > 0.5 * SIZE
    assert np.abs(shades - wanted).max() < 0.06


def test_an_end_of_the_bar_that_is_exceeded_says_so():
    canvas = flat_canvas(mesh=True)
    drawing = Drawing(canvas, values=canvas.points[:, 0], limits=(-0.25, 0.25))
    assert tick_labels(drawing)[::4] == ["≤ -0.25", "≥ 0.25"]


def test_drawings_are_laid_out_in_rows_under_one_camera(tmp_path):
    first, second = flat_drawing(True, texture="polar"), flat_drawing(True)
    parts = [picture(tmp_path, x) for x in (first, second)]
    row = picture(tmp_path, first, second)
    assert np.array_equal(row, np.concatenate(parts, axis=1))
    column = picture(tmp_path, first, second, columns=1)
    assert np.array_equal(column, np.concatenate(parts, axis=0))
    assert np.abs(parts[0] - parts[1]).mean() > 0.01


def test_a_picture_is_complete_or_not_there(tmp_path):
    write_png(tmp_path / "a.png", flat_drawing(True), view=from_above(), size=40)
    with pytest.raises(FileNotFoundError):
        write_png(tmp_path / "none" / "a.png", flat_drawing(True), view=from_above(), size=40)
    with pytest.raises(ValueError, match="`columns` must be at least 1, got -1"):
        picture(tmp_path, flat_drawing(True), columns=-1)
    with pytest.raises(ValueError, match="`drawings` must be one or more"):
        picture(tmp_path)
    assert [f.name for f in tmp_path.iterdir()] == ["a.png"]


def test_without_pyvista_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "riemlayer\[viz\]"'):
        write_png(tmp_path / "a.png", flat_drawing(True), view=from_above())
