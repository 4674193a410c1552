"""Pages in a headless Chromium: they draw, they turn, and nothing goes wrong."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from chromium import Chromium
from flat import flat_canvas, flat_drawing, from_above, places

from riemlayer.viz import (
    Canvas,
    Drawing,
    View,
    checkerboard,
    colour_map,
    polar_grid,
    viewpoint,
    write_html,
)
from riemlayer.viz.palette import PLAIN

pytestmark = pytest.mark.slow
SIZE, HEAD, FOOT = 500, 96, 36
"""Of the square that is drawn on, and of the lines above and below it, in pixels."""
MIDDLE = (SIZE / 2, HEAD + SIZE / 2)


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Iterator[Chromium]:
    with Chromium(tmp_path_factory.mktemp("chromium"), SIZE, HEAD + SIZE + FOOT) as page:
        yield page


def show(page: Chromium, folder: Path, *drawings: Drawing, view: View | None = None) -> np.ndarray:
    """What the page of these drawings looks like from disk, in [0, 1]."""
    path = write_html(folder / "page.html", *drawings, view=view or from_above())
    page.open(path.as_uri())
    return look(page)


def look(page: Chromium) -> np.ndarray:
    """What is drawn (SIZE, SIZE, 3), in [0, 1]."""
    return page.screenshot()[HEAD : HEAD + SIZE] / 255


def where() -> np.ndarray:
    """(SIZE, SIZE, 2) where on the square each pixel of a page looks."""
    return places(SIZE) * (1.55 / 1.25)  # a page leaves more room than a picture


def sure(colours: np.ndarray) -> np.ndarray:
    """Pixels of the square, clear of the words below, with one colour around them."""
    near = [np.roll(colours, s, axis) for s in (-3, 3) for axis in (0, 1)]
    same = np.all([(x == colours).all(-1) for x in near], axis=0)
    return same & (np.abs(where()).max(-1) < 0.4)


def test_page_draws_turns_and_has_no_error(page, tmp_path):
    x = np.random.default_rng(0).normal(size=(600, 3))
    ball = Canvas(x / np.linalg.norm(x, axis=1, keepdims=True))
    drawing = Drawing(ball, log=ball.points[:, :2], radius=9, period=0.3)
    before = show(page, tmp_path, drawing, view=viewpoint(ball.points, [0, 0, 1]))
    drawn = before.min(-1) < 0.9
    assert drawn.mean() > 0.15
    assert np.array_equal(look(page), before), "still while nobody touches it"
    page.drag(MIDDLE, (MIDDLE[0] + 60, MIDDLE[1] + 20))
    after = look(page)
    changed = (np.abs(after - before).max(-1) > 0.1)[drawn].mean()
    assert changed > 0.2
    assert (after.min(-1) < 0.9).mean() == pytest.approx(drawn.mean(), abs=0.03)
    page.drag((MIDDLE[0] + 60, MIDDLE[1] + 20), MIDDLE)
    page.run("canvas.ondblclick()")
    assert np.abs(look(page) - before).mean() < 1e-3, "home again"
    assert page.errors == []
    assert page.requests == [(tmp_path / "page.html").as_uri()], "nothing is loaded"


@pytest.mark.parametrize("mesh", [True, False])
@pytest.mark.parametrize("texture, tiles", [("checker", checkerboard), ("polar", polar_grid)])
def test_page_shows_the_tiles_of_the_closed_form(page, tmp_path, mesh, texture, tiles):
    """The same colours as in a picture, from the same shader."""
    seen = show(page, tmp_path, flat_drawing(mesh, texture=texture, p=None))
    wanted = tiles(where(), radius=0.3)
    kept = sure(wanted) & (wanted > 0.2).all(-1)
    ratio = seen[kept] / wanted[kept]
    assert kept.sum() > 5000
    assert np.ptp(ratio, axis=-1).max() < 0.03 and ratio.std() < 0.03
    assert not np.allclose(seen[sure(wanted) & ~(wanted > 0.2).all(-1)].mean(0)[0], ratio.mean())


def test_page_shows_values_with_their_bar(page, tmp_path):
    canvas = flat_canvas(mesh=True)
    drawing = Drawing(canvas, values=canvas.points[:, 0], limits=(-0.5, 0.4), label="height")
    seen = show(page, tmp_path, drawing)
    wanted = colour_map((where()[..., 0] + 0.5) / 0.9)
    kept = np.abs(where()).max(-1) < 0.3
    ratio = seen[kept] / wanted[kept]
    bright = (wanted[kept] > 0.2).all(-1)
    assert np.ptp(ratio[bright], axis=-1).max() < 0.05
    words = page.run("document.querySelector('.bar').innerText")
    assert "height" in words and "≥ 0.4" in words and "-0.5" in words


def test_buttons_choose_the_drawing_and_lay_them_side_by_side(page, tmp_path):
    first, second = (
        flat_drawing(True, title="one"),
        flat_drawing(True, title="two", texture="polar"),
    )
    seen = [show(page, tmp_path, first, second)]
    buttons = "document.querySelectorAll('header button')"
    assert page.run(f"[...{buttons}].map(b => b.innerText)") == ["one", "two", "side by side"]
    for i in (1, 2):
        page.run(f"{buttons}[{i}].click()")
        seen.append(look(page))
        assert page.run(f"{buttons}[{i}].ariaPressed") == "true"
    body = slice(150, 400)
    assert np.abs(seen[0] - seen[1])[body].mean() > 0.01
    left, right = np.split(seen[2][body], 2, axis=1)
    tiled = [np.abs(part - part[:, ::-1]).mean() for part in (left, right)]
    assert min(tiled) > 0.001, "both panels show something"
    assert np.abs(left - right).mean() > 0.005
    outline = [(part.min(-1) < 0.9).mean() for part in (left, right)]
    assert outline[0] == pytest.approx(outline[1], abs=0.005), "under one camera"
    assert page.errors == []


def test_lines_and_marks_are_drawn(page, tmp_path):
    line = np.linspace([-0.3, 0.2, 0], [0.3, 0.2, 0], 9)
    canvas = flat_canvas(mesh=True)
    bare = show(page, tmp_path, Drawing(canvas))
    for content, at in (
        ({"paths": [line]}, (0, 0.2)),
        ({"reference": [line]}, (0, 0.2)),
        ({"p": [0.3, -0.3, 0]}, (0.3, -0.3)),
        ({"dots": [[-0.3, -0.3, 0]]}, (-0.3, -0.3)),
    ):
        changed = np.abs(show(page, tmp_path, Drawing(canvas, **content)) - bare).max(-1) > 0.1
        assert changed[np.linalg.norm(where() - at, axis=-1) < 0.01].any()
        assert changed[np.abs(where() - at).min(-1) > 0.06].mean() < 0.001


def test_invalid_and_torn_parts_are_plain(page, tmp_path):
    canvas = flat_canvas(mesh=True)
    x = canvas.points
    log = np.where(x[:, :1] > 0.01, x[:, :2] + [7, 0], x[:, :2])
    seen = show(page, tmp_path, Drawing(canvas, log=log, radius=99, valid=x[:, 1] < 0.1))
    place = where()
    hidden = (place[..., 1] > 0.16) & (np.abs(place).max(-1) < 0.4)
    torn = (place[..., 0] > 0.012) & (place[..., 0] < 0.038) & (np.abs(place[..., 1]) < 0.1)
    for part in (hidden, torn):
        grey = seen[part].mean(0) / seen[part].mean()
        assert np.abs(grey - np.array(PLAIN) / np.mean(PLAIN)).max() < 0.02
        assert np.ptp(seen[part].mean(-1)) < 0.06
