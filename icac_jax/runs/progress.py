"""Progress with time left: a bar on a terminal, plain lines otherwise. Always on standard error."""

import contextlib
import sys
import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

_PLAIN_EVERY = 10.0
# A run goes on when the terminal or the pipe it reports to is gone.
_TERMINAL_GONE = (OSError, ValueError)


def duration(seconds: float) -> str:
    """Seconds as h:mm:ss or m:ss."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"


class Reporter:
    """Shows how far a run is. Use as a context manager.

    Args:
      title: what is running.
      total: episodes of all lanes together.
      done: episodes finished before this start.
    """

    def __init__(self, title: str, total: int, done: int = 0) -> None:
        self.title, self.total, self.begin = title, total, done
        self.last_line = time.monotonic()
        self.bar: Progress | None = None
        if sys.stderr.isatty():
            self.bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("episodes"),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[note]}"),
                console=Console(stderr=True),
            )
            self.task = self.bar.add_task(title, total=total, completed=done, note="compiling")

    def __enter__(self) -> Self:
        with contextlib.suppress(*_TERMINAL_GONE):
            if self.bar is not None:
                self.bar.start()
            else:
                print(f"{self.title}: compiling", file=sys.stderr, flush=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.bar is not None:
            with contextlib.suppress(*_TERMINAL_GONE):
                self.bar.stop()

    def update(self, done: int, seconds: float, note: str) -> None:
        """Shows that `done` episodes are finished after `seconds` of training; `note` is the latest figure."""
        with contextlib.suppress(*_TERMINAL_GONE):
            self._update(done, seconds, note)

    def _update(self, done: int, seconds: float, note: str) -> None:
        if self.bar is not None:
            self.bar.update(self.task, completed=done, note=note)
            return
        now = time.monotonic()
        if now - self.last_line < _PLAIN_EVERY and done < self.total:
            return
        self.last_line = now
        fresh = done - self.begin
        left = duration(seconds * (self.total - done) / fresh) if fresh > 0 else "?"
        print(
            f"{self.title}: {done:,} of {self.total:,} episodes, {duration(seconds)} spent, {left} left, {note}",
            file=sys.stderr,
            flush=True,
        )
