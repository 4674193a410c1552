"""A progress bar on stderr: on terminals alone, and only for what takes longer than a moment."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

Item = TypeVar("Item")

DELAY = 2.0
"""Seconds before the bar appears."""


class Bar:
    """The running command's stage; drawn by rich from another thread once it has been shown."""

    def __init__(self) -> None:
        self._text, self._total, self._done = "starting", None, 0.0
        self._rich: Any = None
        self._task: Any = None
        self._lock, self._over = threading.Lock(), False

    def stage(self, text: str, total: float | None = None, done: float = 0.0) -> None:
        """What is being done, and how much of how much where that is known."""
        with self._lock:
            self._text, self._total, self._done = text, total, done
            self._update()

    def show(self) -> None:
        """Begin to draw."""
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            TimeElapsedColumn(),
        )
        with self._lock:
            if self._over:
                return
            self._rich = Progress(*columns, console=Console(stderr=True), transient=True)
            self._task = self._rich.add_task(self._text, total=None)
            self._update()
            self._rich.start()

    def hide(self) -> None:
        """End, without a trace on the terminal."""
        with self._lock:
            self._over = True
            if self._rich is not None:
                self._rich.stop()

    def _update(self) -> None:
        if self._rich is not None:
            self._rich.update(
                self._task, description=self._text, total=self._total, completed=self._done
            )


_current: ContextVar[Bar | None] = ContextVar("bar", default=None)


@contextmanager
def progress(wanted: bool = True) -> Iterator[None]:
    """Shows a bar while its body runs, where stderr is a terminal and DELAY has passed."""
    if not (wanted and sys.stderr.isatty()):
        yield
        return
    bar = Bar()
    token = _current.set(bar)
    timer = threading.Timer(DELAY, bar.show)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        bar.hide()
        _current.reset(token)


def end_bar() -> None:
    """No bar from here on: the command goes on until the user ends it."""
    if bar := _current.get():
        bar.hide()


def stage(text: str) -> None:
    """Names what the command does next."""
    if bar := _current.get():
        bar.stage(text)


def track(items: Iterable[Item], text: str) -> Iterator[Item]:
    """The items, counted on the bar."""
    bar, total = _current.get(), len(items) if isinstance(items, Sized) else None
    for done, item in enumerate(items):
        if bar is not None:
            bar.stage(text, total, done)
        yield item
