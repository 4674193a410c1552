"""`view`: a page on disk, polyscope's window; the server is in test_program.py."""

import sys

import numpy as np
import pytest


@pytest.fixture
def opened(monkeypatch):
    """Addresses that a browser was asked to open."""
    addresses = []
    monkeypatch.setattr("webbrowser.open", addresses.append)
    return addresses


def test_a_page_is_written_and_opened(well, opened, shapes, tiny, tmp_path):
    out = tmp_path / "page.html"
    words = ["view", shapes / "ball.ply", "-o", out, "--points", 300, "--weights", tiny]
    facts = well(*words, "--json").facts
    assert opened == [out.as_uri()] and facts["out"] == str(out)
    assert "ball.ply" in out.read_text("utf-8")
    assert [x.name for x in tmp_path.iterdir()] == ["page.html"]


def test_no_browser_opens_where_none_is_wanted(well, opened, shapes, tiny, tmp_path):
    words = ["view", shapes / "cloud.npz", "-s", 5, "--no-browser", "--weights", tiny]
    well(*words, "-o", tmp_path / "page.html")
    assert not opened


def test_a_page_replaces_nothing_and_is_html(run, opened, shapes, tiny, tmp_path):
    (tmp_path / "page.html").write_text("mine")
    for out, word in (("page.html", "--force"), ("page.png", ".html")):
        done = run("view", shapes / "cloud.npz", "-o", tmp_path / out, "--weights", tiny)
        assert done.code == 2 and word in done.stderr
    assert (tmp_path / "page.html").read_text() == "mine" and not opened


def test_polyscope_is_named_where_it_is_missing(run, monkeypatch, shapes, tiny):
    monkeypatch.setitem(sys.modules, "polyscope", None)
    done = run("view", shapes / "cloud.npz", "--polyscope", "--weights", tiny)
    assert done.code == 2 and "pip install polyscope" in done.stderr


@pytest.mark.parametrize("name", ["cloud.npz", "ball.ply"])
def test_polyscope_gets_the_shape_and_the_fan(well, monkeypatch, shapes, tiny, name):
    polyscope = pytest.importorskip("polyscope")
    start = polyscope.init
    monkeypatch.setattr(polyscope, "init", lambda: start("openGL_mock"))
    shown = []
    monkeypatch.setattr(polyscope, "show", lambda: shown.append(True))
    well("view", shapes / name, "--polyscope", "--points", 300, "--weights", tiny)
    has = polyscope.has_surface_mesh if name == "ball.ply" else polyscope.has_point_cloud
    assert has("shape") and polyscope.get_curve_network("Exp").n_nodes() == 24 * 25
    assert shown == [True]
    polyscope.remove_all_structures()


def test_the_fan_is_of_the_trained_radius(shapes, tiny):
    from riemlayer.cli.loaded import Encoding
    from riemlayer.cli.maps import fan_paths

    loaded = Encoding(shapes / "cloud.npz", str(tiny)).load()
    p = loaded.points[4]
    paths = fan_paths(loaded, p)
    assert paths.shape == (24, 25, 3)
    np.testing.assert_allclose(paths[:, 0], np.tile(p, (24, 1)), atol=1e-6)
