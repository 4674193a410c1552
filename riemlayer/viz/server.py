"""The viewer: a page served to this machine alone, in which a click chooses the source."""

from __future__ import annotations

import json
import threading
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Self
from urllib.parse import parse_qs, urlsplit

import torch

from riemlayer.surface import EncodedSurface
from riemlayer.viz.canvas import Canvas
from riemlayer.viz.drawing import Drawing
from riemlayer.viz.html import ArrayStore, encode_canvas, encode_content, render_page
from riemlayer.viz.scenes import RAYS, TILES, exp_fan, log_map, normal_at
from riemlayer.viz.view import viewpoint

HOST = "127.0.0.1"
NOTE = "Click on the shape to choose the source; drag with the shift key to move it."
FINENESS = 12
"""Edges of a mesh are halved until that many fit into the radius."""
IDLE = 30
"""Seconds after which a connection that asks nothing is closed."""


def serve(
    surface: EncodedSurface,
    points: Any = None,
    faces: Any = None,
    *,
    p: Any = None,
    port: int = 0,
    open_browser: bool = True,
    title: str = "riemlayer",
    on_ready: Callable[[str], object] = print,
) -> None:
    """Serve the interactive viewer of a surface until Ctrl-C; see `Viewer`.

    Args:
        surface, points, faces, p, port, title: as for `Viewer`.
        open_browser: open the page in the default browser.
        on_ready: called with the page's address once it answers.

    Raises:
        ValueError: naming the argument, what was expected and what came.
        OSError: the port is taken.
    """
    with Viewer(surface, points, faces, p=p, port=port, title=title) as viewer:
        on_ready(viewer.url)
        if open_browser:
            webbrowser.open(viewer.url)
        try:
            viewer.wait()
        except KeyboardInterrupt:
            return


class Viewer:
    """A server on 127.0.0.1 whose page shows log maps and fans of the source that is clicked.

    It starts at once, answers in threads of its own (one question at a time), and ends with
    `close` or the `with` block. Nothing outside this machine can reach it.

    Args:
        surface: of one shape.
        points: (N, 3) what is painted, such as the vertices of the mesh that the surface was made
            from, in the same frame; the surface's own points by default.
        faces: (M, 3) triangles of `points`, or None for a cloud.
        p: (3,) first source; the foremost point by default.
        port: to listen at; 0 takes a free one.
        title: of the page.

    Raises:
        ValueError: naming the argument, what was expected and what came.
        OSError: the port is taken.

    Example:
        >>> from urllib.request import urlopen
        >>> from riemlayer import ExpLogField
        >>> cloud = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
        >>> surface = ExpLogField.from_preset("tiny").encode(cloud)
        >>> with Viewer(surface) as viewer:
        ...     answer = json.load(urlopen(viewer.url + "drawings?point=7"))
        >>> bool((torch.tensor(answer["p"]) == cloud[7]).all())
        True
    """

    def __init__(
        self,
        surface: EncodedSurface,
        points: Any = None,
        faces: Any = None,
        *,
        p: Any = None,
        port: int = 0,
        title: str = "riemlayer",
    ) -> None:
        if len(surface) != 1:
            raise ValueError(f"`surface` must be one shape, got {len(surface)}; take surface[i]")
        self.surface = surface.detach()
        longest = float(surface.radius) / FINENESS
        self.canvas = Canvas(surface.points if points is None else points, faces, longest=longest)
        self.title = title
        self.view = viewpoint(self.canvas.points, [0.0, 0.0, 1.0])
        if p is None:
            p = self.canvas.points[self._foremost()]
        self._first = torch.as_tensor(p).to(surface.centre)
        self._lock = threading.Lock()
        self._page = self._render()
        self._server = ThreadingHTTPServer((HOST, port), self._handler())
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self._server.server_port}/"

    def wait(self) -> None:
        """Until `close` or Ctrl-C."""
        while self._thread.is_alive():
            self._thread.join(0.5)

    def close(self) -> None:
        """Stop answering."""
        self._server.shutdown()
        self._server.server_close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def draw(self, p: torch.Tensor) -> list[Drawing]:
        """What the page shows of the source p (3,)."""
        reach = float(self.surface.radius)
        normal = normal_at(self.surface, p, self.canvas)
        flat, trust = log_map(self.surface, p, normal, self.canvas, reach)
        size = reach / TILES
        fan = [*exp_fan(self.surface, p, normal, reach, RAYS)]

        def draw(title: str, **content: Any) -> Drawing:
            return Drawing(self.canvas, p=p, radius=reach, period=size, title=title, **content)

        return [
            draw("checkerboard", log=flat, valid=trust),
            draw("polar grid", log=flat, valid=trust, texture="polar"),
            draw("Exp", paths=fan),
            draw("trust", values=trust, limits=(0, 1), label="trust"),
        ]

    def answer(self, query: str) -> dict[str, Any]:
        """What a source, `point=index` or `at=x,y,z`, changes on the page: JSON.

        Raises:
            ValueError: the query names no point.
        """
        p = self._asked(parse_qs(query))
        with self._lock:
            drawings = self.draw(p)
        store = ArrayStore(first=self.fixed)
        content = [encode_content(drawing, store) for drawing in drawings]
        return {"p": p.tolist(), "drawings": content, "arrays": store.encoded}

    def _asked(self, query: dict[str, list[str]]) -> torch.Tensor:
        points = self.canvas.points
        if list(query) == ["point"]:
            text = query["point"][0]
            if not text.isdecimal() or int(text) >= len(points):
                raise ValueError(f"`point` must be an index below {len(points)}, got {text!r}")
            return torch.as_tensor(points[int(text)]).to(self._first)
        if list(query) != ["at"]:
            raise ValueError("the query must be point=index or at=x,y,z")
        try:
            p = self._first.new_tensor([float(x) for x in query["at"][0].split(",")])
        except ValueError:
            p = self._first.new_zeros(0)
        if p.shape != (3,) or not p.isfinite().all():
            raise ValueError(f"`at` must be three finite numbers x,y,z, got {query['at'][0]!r}")
        return p

    def _foremost(self) -> int:
        """The point that is nearest to the eye, of those in the middle of the picture."""
        seen = (self.canvas.points - self.view.centre) @ self.view.axes.T
        aside = (seen[:, :2] ** 2).sum(1) ** 0.5
        return int((seen[:, 2] - 2 * aside).argmax())

    def _render(self) -> bytes:
        store = ArrayStore()
        shape = encode_canvas(self.canvas, store)
        self.fixed = len(store.encoded)
        """How many arrays of the page stay when the source changes."""
        drawings = [shape | encode_content(x, store) for x in self.draw(self._first)]
        page = render_page(
            drawings, store.encoded, self.view, self.title, NOTE, ("viewer.js",), self.fixed
        )
        return page.encode()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        viewer = self

        class Handler(BaseHTTPRequestHandler):
            timeout = IDLE

            def do_GET(self) -> None:
                port = viewer._server.server_port
                if self.headers.get("Host") not in (f"{HOST}:{port}", f"localhost:{port}"):
                    return self._send(HTTPStatus.FORBIDDEN, {"error": "only for this machine"})
                url = urlsplit(self.path)
                if url.path == "/":
                    return self._send(HTTPStatus.OK, viewer._page)
                if url.path != "/drawings":
                    return self._send(HTTPStatus.NOT_FOUND, {"error": f"no page {url.path}"})
                try:
                    return self._send(HTTPStatus.OK, viewer.answer(url.query))
                except ValueError as error:
                    return self._send(HTTPStatus.BAD_REQUEST, {"error": str(error)})

            def _send(self, status: HTTPStatus, content: bytes | dict) -> None:
                html = isinstance(content, bytes)
                body = content if isinstance(content, bytes) else json.dumps(content).encode()
                self.send_response(status)
                self.send_header("Content-Type", "text/html" if html else "application/json")
                self.send_header("Content-Length", str(len(body)))
                self.send_header("Cache-Control", "no-store")
                with suppress(ConnectionError):  # the page was closed meanwhile
                    self.end_headers()
                    self.wfile.write(body)

            def log_message(self, format: str, *args: object) -> None:
                """Requests are not worth a line."""

        return Handler
