"""A headless Chromium on a pipe: DevTools protocol with the standard library alone."""

from __future__ import annotations

import base64
import io
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--remote-debugging-pipe",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--force-prefers-reduced-motion", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-extensions", "--hide-scrollbars",
)  # fmt: skip
PATIENCE = 180.0
"""Seconds: software WebGL on a busy machine is slow."""


def find_chromium() -> str:
    """Path of an installed Chromium; skips the test where there is none."""
    for name in NAMES:
        if path := shutil.which(name):
            return path
    pytest.skip(f"needs a Chromium on the PATH ({', '.join(NAMES)}): apt-get install chromium")


class Chromium:
    """One page of one browser; `errors` and `requests` collect what the page did.

    with Chromium(tmp_path) as page: page.open("file:///...")
    """

    def __init__(self, folder: Path, width: int = 800, height: int = 600) -> None:
        program = find_chromium()
        ours, theirs = os.pipe(), os.pipe()  # commands to it, answers from it
        # it reads commands at descriptor 3 and writes answers at 4
        script = f'exec "$@" 3<&{ours[0]} 4>&{theirs[1]}'
        options = (*FLAGS, f"--user-data-dir={folder}/profile", f"--window-size={width},{height}")
        self._process = subprocess.Popen(
            ["bash", "-c", script, "-", program, *options, "about:blank"],
            pass_fds=(ours[0], theirs[1]), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(ours[0])
        os.close(theirs[1])
        self._write, self._read = os.fdopen(ours[1], "wb", 0), theirs[0]
        self._buffer, self._count, self._session = b"", 0, None
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.size = (width, height)

    def __enter__(self) -> Self:
        targets = self("Target.getTargets")["targetInfos"]
        target = next(x["targetId"] for x in targets if x["type"] == "page")
        session = self("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self._session = session
        for domain in ("Runtime", "Log", "Network", "Page"):
            self(f"{domain}.enable")
        width, height = self.size
        self("Emulation.setDeviceMetricsOverride", width=width, height=height,
             deviceScaleFactor=1, mobile=False)  # fmt: skip
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._write.close()  # it ends when its pipe does
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._read)

    def open(self, url: str) -> None:
        """Load a page and wait until it has drawn."""
        self.errors.clear()
        self.requests.clear()
        self("Page.navigate", url=url)
        self.wait("document.readyState === 'complete' && document.body.dataset.frames > 0")

    def run(self, expression: str) -> Any:
        """Value of a JavaScript expression."""
        answer = self("Runtime.evaluate", expression=expression, returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"])
        return answer["result"].get("value")

    def wait(self, condition: str) -> None:
        """Until a JavaScript expression is true."""
        end = time.monotonic() + PATIENCE
        while not self.run(f"Boolean({condition})"):
            if time.monotonic() > end:
                raise TimeoutError(f"{condition}; the page said: {self.errors}")
            time.sleep(0.05)

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 5) -> None:
        """Press the left button at `start`, move to `end`, release; equal ends make a click."""
        for kind, t in (
            ("mouseMoved", 0.0), ("mousePressed", 0.0),
            *(("mouseMoved", i / steps) for i in range(1, steps + 1) if start != end),
            ("mouseReleased", 1.0),
        ):  # fmt: skip
            x, y = (a + t * (b - a) for a, b in zip(start, end, strict=True))
            button = {} if kind == "mouseMoved" and t == 0 else {"button": "left", "buttons": 1}
            self("Input.dispatchMouseEvent", type=kind, x=x, y=y, clickCount=1, **button)

    def screenshot(self) -> np.ndarray:
        """The page (height, width, 3) as it is, in [0, 255]."""
        from PIL import Image

        frames = self.run("document.body.dataset.frames")
        self.run("requestAnimationFrame(draw)")
        self.wait(f"document.body.dataset.frames > {frames}")
        data = base64.b64decode(self("Page.captureScreenshot")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), float)

    def __call__(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and wait for its answer; events that come first are kept."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        self._write.write(json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self._keep(answer)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            data = os.read(self._read, 1 << 16)
            if not data:
                raise RuntimeError(f"Chromium ended with {self._process.wait()}")
            self._buffer += data
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def _keep(self, event: dict[str, Any]) -> None:
        method, x = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(str(x["exceptionDetails"].get("exception", x)))
        elif method == "Runtime.consoleAPICalled" and x["type"] in ("error", "warning", "assert"):
            self.errors.append(str([a.get("value") for a in x["args"]]))
        elif method == "Log.entryAdded" and x["entry"]["level"] in ("error", "warning"):
            self.errors.append(x["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(x["request"]["url"])
