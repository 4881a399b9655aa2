"""Progress with time left: one line that is written over on a terminal, plain lines otherwise. On standard error."""

import contextlib
import sys
import time
from types import TracebackType
from typing import Self

from icac_jax import console

_PLAIN_EVERY = 10.0
_DRAWN_EVERY = 0.1
# A run goes on when the terminal or the pipe it reports to is gone, or there was none.
_TERMINAL_GONE = (OSError, ValueError, AttributeError)
_SHORTEST_BAR, _LONGEST_BAR = 6, 40


def duration(seconds: float) -> str:
    """Seconds as h:mm:ss or m:ss."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"


def one_line(
    width: int, title: str, done: int, total: int, spent: str, left: str, note: str, unit: str = "episodes"
) -> str:
    """The line of a terminal: count, time left and the figure always, the rest as far as it has room.

    Args:
      width: columns of the terminal.
      title: what is running.
      done: episodes finished.
      total: episodes of all lanes together.
      spent: time spent.
      left: time left.
      note: the latest figure; what comes after " in " explains it.
      unit: what is counted.
    """
    parts = {"count": f"{done:,}/{total:,}", "left": f"{left} left", "note": note.partition(" in ")[0]}
    room = {
        "count": f"{parts['count']} {unit}",
        "title": title,
        "note": note,
        "spent": f"{spent} spent",
    }
    order = ("title", "bar", "count", "spent", "left", "note")

    def joined() -> str:
        return "  ".join(parts[name] for name in order if parts.get(name))

    for name, text in room.items():  # the most welcome first
        before = parts.get(name, "")
        parts[name] = text
        if len(joined()) > width:
            parts[name] = before
    bar = min(_LONGEST_BAR, width - len(joined()) - 4)
    if bar >= _SHORTEST_BAR:
        full = bar * done // total if total else 0
        parts["bar"] = f"[{'#' * full}{'.' * (bar - full)}]"
    return joined()[:width]


class Reporter:
    """Shows how far a run is. Use as a context manager.

    Args:
      title: what is running.
      total: episodes of all lanes together.
      done: episodes finished before this start.
      unit: what is counted, if not episodes.
    """

    def __init__(self, title: str, total: int, done: int = 0, unit: str = "episodes") -> None:
        self.unit = unit
        self.title, self.total, self.begin = console.shown(title, 60), total, done
        self.last = time.monotonic()
        self.terminal = False
        with contextlib.suppress(*_TERMINAL_GONE):
            self.terminal = sys.stderr.isatty()

    def __enter__(self) -> Self:
        if self.terminal:
            self._draw(self.begin, "0:00", "?", "compiling")
        else:
            console.say(f"{self.title}: compiling")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.terminal:
            with contextlib.suppress(*_TERMINAL_GONE):
                print(file=sys.stderr, flush=True)

    def update(self, done: int, seconds: float, note: str) -> None:
        """Shows that `done` episodes are finished after `seconds` of training; `note` is the latest figure."""
        now = time.monotonic()
        if now - self.last < (_DRAWN_EVERY if self.terminal else _PLAIN_EVERY) and done < self.total:
            return
        self.last = now
        fresh = done - self.begin
        spent = duration(seconds)
        left = duration(seconds * (self.total - done) / fresh) if fresh > 0 else "?"
        if self.terminal:
            self._draw(done, spent, left, note)
        else:
            console.say(f"{self.title}: {done:,} of {self.total:,} {self.unit}, {spent} spent, {left} left, {note}")

    def _draw(self, done: int, spent: str, left: str, note: str) -> None:
        with contextlib.suppress(*_TERMINAL_GONE):
            # One column stays free: a terminal that is full to the last one begins a new line.
            width = console.columns(sys.stderr) - 1
            line = one_line(width, self.title, done, self.total, spent, left, note, self.unit)
            print(f"\r{line}\x1b[K", end="", file=sys.stderr, flush=True)
