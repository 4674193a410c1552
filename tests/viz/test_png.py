"""Pictures: what they show, pixel by pixel where the truth is known."""


import numpy as np
import pytest
from flat import flat_drawing, from_above, places

from riemlayer.viz import Drawing, checkerboard, polar_grid, write_png
from riemlayer.viz.palette import BLUE, CREAM, PLAIN

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
