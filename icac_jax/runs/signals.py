"""Stopping politely: the first Ctrl-C, SIGTERM or SIGHUP asks a training to stop, anything else ends at once.

The interpreter's own handlers wait until the main thread returns from compiled code, which can take a whole
compilation, and an exception raised by one can be swallowed by a callback; here a socket is written at once, and a
thread reads it.
"""

import contextlib
import os
import shutil
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from icac_jax import console

WATCHED = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_listens = False
_numbers: list[int] = []
_sockets: list[socket.socket] = []  # a socket that nobody holds is closed
_active: "StopRequest | None" = None
_latest: "StopRequest | None" = None
_last_words: list[str] = ["interrupted"]
_unfinished: set[Path] = set()
_command = ""
_reason = ""


def asked_last() -> signal.Signals | None:
    """The signal that the latest `StopRequest` saw: what came too late for it stops whatever would be done next."""
    return _latest.signal if _latest is not None else None


def listen() -> Callable[[], None]:
    """Answers signals: asks the `StopRequest` that is in use to stop; without one, or asked before, ends the process.

    Does nothing if that is done already, nor outside the main thread, where Python allows no handlers.

    Returns:
      What puts everything back as it was before.
    """
    global _listens
    if _listens or threading.current_thread() is not threading.main_thread():
        return lambda: None
    read, write = socket.socketpair()
    write.setblocking(False)
    # Whoever started this with `nohup` wants it to outlive the terminal.
    numbers = [n for n in WATCHED if n == signal.SIGINT or signal.getsignal(n) is not signal.SIG_IGN]
    former_fd = signal.set_wakeup_fd(write.fileno(), warn_on_full_buffer=False)
    former = {number: signal.signal(number, _nothing) for number in numbers}
    thread = threading.Thread(target=_watch, args=(read, numbers), daemon=True)
    thread.start()
    _listens = True
    _numbers[:] = numbers
    _sockets[:] = read, write

    def stop() -> None:
        global _listens
        _listens = False
        _numbers.clear()
        _sockets.clear()
        signal.set_wakeup_fd(former_fd)
        for number, handler in former.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        write.close()
        thread.join()
        read.close()

    return stop


def listen_again() -> None:
    """Takes signals back from a library that has put handlers of its own in the place of those of `listen`."""
    if threading.current_thread() is threading.main_thread():
        for number in _numbers:
            signal.signal(number, _nothing)


def _nothing(*_: object) -> None:
    """The handler of a signal whose number goes through the socket."""


def _watch(read: socket.socket, numbers: list[int]) -> None:
    while seen := read.recv(1):
        if seen[0] not in numbers:
            continue
        if _active is None:
            end(seen[0], _last_words[-1])
        elif _active.signalled:
            end(seen[0], "stopped at once; what was trained after the last checkpoint is lost")
        else:
            _active.signalled = True
            if _active.signal is not None:  # asked to already, by `stop_because`
                continue
            _active.signal = signal.Signals(seen[0])
            _say("stopping after this chunk and saving; once more stops at once, unsaved")


def stop_because(reason: str) -> None:
    """Asks for a stop as SIGTERM would, because of something that is said in the line at the end."""
    global _reason
    if _reason:
        return
    _reason = f"{reason}; "
    if _active is None:
        end(signal.SIGTERM, _last_words[-1])
    elif _active.signal is None:
        _active.signal = signal.SIGTERM


def reason() -> str:
    """Why a stop was asked for, as the beginning of a line; empty if a signal asked."""
    return _reason


def end(number: int, words: str) -> None:
    """Ends the process because of a signal, with a line and without what it was in the middle of writing."""
    _say(f"icac{_command}: {_reason}{words}")
    for path in list(_unfinished):
        with contextlib.suppress(OSError):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    os._exit(128 + number)


def name_command(name: str) -> None:
    """Says which command is running, for the line at the end of it."""
    global _command
    _command = f" {name}" if name else ""


def _say(line: str) -> None:
    with contextlib.suppress(OSError, ValueError, AttributeError):
        if sys.stderr.isatty():  # the line that shows the progress, and ^C
            print(file=sys.stderr)
    console.say(line)


@contextlib.contextmanager
def saying(words: str) -> Iterator[None]:
    """What is said when a signal ends the process within, such as how to go on."""
    _last_words.append(words)
    try:
        yield
    finally:
        _last_words.pop()


@contextlib.contextmanager
def unfinished(path: Path) -> Iterator[None]:
    """A file or folder of no use until the block ends, removed when a signal ends the process within."""
    _unfinished.add(path)
    try:
        yield
    finally:
        _unfinished.discard(path)


class StopRequest:
    """What a signal asks of the work within. Use as a context manager.

    Attributes:
      signal: the signal that asked for the stop, or None.
    """

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None
        # Whether a signal has asked: a launcher sends one when a task has died, which `stop_because` may have
        # answered already.
        self.signalled = False

    def __enter__(self) -> Self:
        global _latest, _active
        _latest = _active = self
        self._stop_listening = listen()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        global _active
        self._stop_listening()
        _active = None
