"""The viewer: real requests to a real server, and a click in a headless Chromium."""

import base64
import json
from collections.abc import Iterator
from http.client import HTTPConnection
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np
import pytest
import torch
from chromium import Chromium
from torch import Tensor

from riemlayer import EncodedSurface, ExpLogField
from riemlayer.viz import Viewer, serve, subdivide

SIZE, HEAD, FOOT = 500, 96, 36
"""Of the square that is drawn on, and of the lines above and below it, in pixels."""


def icosphere(rounds: int) -> tuple[np.ndarray, np.ndarray]:
    octahedron = np.concatenate([np.eye(3), -np.eye(3)])
    signs = [(x, y, z) for x in (0, 3) for y in (1, 4) for z in (2, 5)]
    faces = [f if sum(i > 2 for i in f) % 2 == 0 else f[::-1] for f in signs]
    points, faces = subdivide(octahedron, faces, 1.5 / 2**rounds)
    return points / np.linalg.norm(points, axis=1, keepdims=True), faces


@pytest.fixture(scope="module")
def surface() -> EncodedSurface:
    torch.manual_seed(0)
    x = torch.nn.functional.normalize(torch.randn(3000, 3), dim=-1)
    with torch.inference_mode():
        return ExpLogField.from_pretrained("base").encode(x)


@pytest.fixture
def viewer(surface) -> Iterator[Viewer]:
    with Viewer(surface) as viewer:
        yield viewer


def ask(viewer: Viewer, query: str) -> dict:
    with urlopen(f"{viewer.url}drawings?{query}", timeout=60) as response:
        assert response.headers["Content-Type"] == "application/json"
        return json.load(response)


def refused(viewer: Viewer, path: str) -> tuple[int, str]:
    with pytest.raises(HTTPError) as caught:
        urlopen(viewer.url + path, timeout=60)
    with caught.value as error:
        return error.code, json.load(error)["error"]


def arrays(viewer: Viewer, answer: dict, drawing: int, name: str, width: int) -> np.ndarray:
    index = answer["drawings"][drawing][name] - viewer.fixed
    return np.frombuffer(base64.b64decode(answer["arrays"][index]), "f4").reshape(-1, width)


def test_the_answer_is_the_log_map_of_the_point(viewer, surface):
    answer = ask(viewer, "point=7")
    p = surface.points[7]
    assert answer["p"] == p.tolist()
    log = arrays(viewer, answer, 0, "log", 2)
    near = (surface.points - p).norm(dim=-1) < 0.3
    with torch.inference_mode():
        wanted = surface.log(p, surface.points).norm(dim=-1)
    assert near.sum() > 10
    assert np.allclose(np.linalg.norm(log, axis=1)[near], wanted[near], rtol=0.02, atol=0.01)
    fan = arrays(viewer, answer, 2, "paths", 6)
    assert np.abs(np.linalg.norm(fan[:, 3:], axis=1) - 1).max() < 0.2, "geodesics stay on the ball"
    assert np.abs(fan[0, :3] - p.numpy()).max() < 1e-6


def test_other_points_have_other_maps_and_the_same_one_the_same(viewer):
    first, second, again = (ask(viewer, q) for q in ("point=7", "point=8", "point=7"))
    assert first == again
    assert first["arrays"] != second["arrays"]


def test_coordinates_do_as_well_as_an_index(viewer, surface):
    x, y, z = surface.points[7].tolist()
    assert ask(viewer, f"at={x},{y},{z}") == ask(viewer, "point=7")


@pytest.mark.parametrize(
    "path, status, words",
    [
        ("drawings?point=3000", 400, "`point` must be an index below 3000, got '3000'"),
        ("drawings?point=-1", 400, "`point` must be an index"),
        ("drawings?at=1,2", 400, "`at` must be three finite numbers x,y,z, got '1,2'"),
        ("drawings?at=1,2,nan", 400, "`at` must be three finite numbers"),
        ("drawings?at=a,b,c", 400, "`at` must be three finite numbers"),
        ("drawings", 400, "point=index or at=x,y,z"),
        ("drawings?point=1&at=0,0,0", 400, "point=index or at=x,y,z"),
        ("etc/passwd", 404, "no page /etc/passwd"),
    ],
)
def test_bad_requests_are_named(viewer, path, status, words):
    code, error = refused(viewer, path)
    assert code == status and words in error
    assert ask(viewer, "point=0")["p"], "and the viewer goes on"


def test_only_this_machine_is_answered(viewer):
    """The socket is bound to the loopback, and other names (DNS rebinding) are turned away."""
    address = urlsplit(viewer.url)
    assert address.hostname == "127.0.0.1"
    connection = HTTPConnection("127.0.0.1", address.port or 0, timeout=60)
    connection.request("GET", "/", headers={"Host": "example.org"})
    assert connection.getresponse().status == 403
    connection.close()


def test_an_idle_connection_does_not_block_the_others(viewer):
    idle = HTTPConnection(urlsplit(viewer.url).netloc, timeout=60)
    idle.connect()
    assert ask(viewer, "point=3")
    idle.close()


def test_a_closed_viewer_is_gone_and_its_port_free(surface):
    with Viewer(surface) as viewer:
        port = urlsplit(viewer.url).port or 0
    with pytest.raises(OSError):
        urlopen(viewer.url, timeout=5)
    with Viewer(surface, port=port) as again:
        assert urlsplit(again.url).port == port
        with pytest.raises(OSError):
            Viewer(surface, port=port)


def test_serve_says_where_and_ends_with_the_keyboard(surface, monkeypatch):
    opened, ready = [], []
    monkeypatch.setattr("webbrowser.open", opened.append)

    def interrupt(self: Viewer) -> None:
        assert urlopen(self.url, timeout=60).read().startswith(b"<!doctype html>")
        raise KeyboardInterrupt

    monkeypatch.setattr(Viewer, "wait", interrupt)
    serve(surface, open_browser=True, on_ready=ready.append)
    serve(surface, open_browser=False, on_ready=ready.append)
    assert opened == ready[:1] and len(ready) == 2


def test_a_batch_is_refused(surface):
    points = torch.cat([surface.points, surface.points])
    batch = torch.arange(2).repeat_interleave(len(surface.points))
    both = ExpLogField.from_preset("tiny").encode(points, batch)
    with pytest.raises(ValueError, match=r"one shape, got 2; take surface\[i\]"):
        Viewer(both)
    with Viewer(both[1]) as viewer:
        assert ask(viewer, "point=3")["p"] == points[3].tolist()


@pytest.mark.slow
@pytest.mark.parametrize("mesh", [True, False])
def test_a_click_moves_the_picture_to_the_place_clicked(surface, tmp_path, mesh):
    shape: tuple[np.ndarray, np.ndarray] | tuple[Tensor, None] = (
        icosphere(3) if mesh else (surface.points, None)
    )
    with (
        Viewer(surface, *shape, p=[0.0, -1.0, 0.0]) as viewer,
        Chromium(tmp_path, SIZE, HEAD + SIZE + FOOT) as page,
    ):
        page.open(viewer.url)
        before = page.screenshot()
        page.drag((260, HEAD + 270), (260, HEAD + 270))
        page.wait("document.body.dataset.source")
        after = page.screenshot()
        source = np.array([float(x) for x in page.run("document.body.dataset.source").split(",")])
        # the ray through the pixel meets the ball at the nearest point to the eye
        view, height = viewer.view, 1.55 * viewer.view.fit
        eye = view.centre + max(height / np.tan(np.pi / 12), 1.2 * view.extent) * view.direction
        right, up = 2 * 260 / SIZE - 1, 1 - 2 * 270 / SIZE
        along = np.tan(np.pi / 12) * (right * view.axes[0] + up * view.axes[1]) - view.direction
        along /= np.linalg.norm(along)
        closest = eye - (eye @ along) * along
        hit = closest - np.sqrt(1 - closest @ closest) * along
        assert np.linalg.norm(source - hit) < (0.02 if mesh else 0.1)
        middle = (slice(HEAD + 220, HEAD + 320), slice(210, 310))
        assert np.abs(after - before)[middle].max(-1).mean() > 30, "tiles came to the place clicked"
        page.drag((5, HEAD + 495), (5, HEAD + 495))  # beside the shape: nothing to ask
        page.drag((250, HEAD + 250), (300, HEAD + 250))  # a drag turns and asks nothing
        asked = [url for url in page.requests if "drawings?" in url]
        assert len(asked) == 1 and page.errors == []
        assert np.abs(page.screenshot() - after).mean() > 1
