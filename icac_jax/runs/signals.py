"""Stopping politely: the first Ctrl-C or SIGTERM asks for a stop, a second one ends the process at once."""

import contextlib
import os
import signal
import socket
import sys
import threading
from types import TracebackType
from typing import Self

_WATCHED = (signal.SIGINT, signal.SIGTERM)
_latest: "StopRequest | None" = None


def asked_last() -> signal.Signals | None:
    """The signal that the latest `StopRequest` saw: what came too late for it stops whatever would be done next."""
    return _latest.signal if _latest is not None else None


class StopRequest:
    """Watches for SIGINT and SIGTERM. Use as a context manager, from the main thread.

    The interpreter's own handlers wait until the main thread returns from compiled code, which can take a whole
    compilation; the wake-up socket is written at once, and a thread reads it.

    Attributes:
      signal: the signal that asked for the stop, or None.
    """

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None

    def __enter__(self) -> Self:
        global _latest
        _latest = self
        self._read, self._write = socket.socketpair()
        self._write.setblocking(False)
        self._former_fd = signal.set_wakeup_fd(self._write.fileno(), warn_on_full_buffer=False)
        self._former = {number: signal.signal(number, lambda *_: None) for number in _WATCHED}
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.set_wakeup_fd(self._former_fd)
        for number, handler in self._former.items():
            signal.signal(number, handler)
        self._write.close()
        self._thread.join()
        self._read.close()

    def _watch(self) -> None:
        while seen := self._read.recv(1):
            if seen[0] not in _WATCHED:
                continue
            if self.signal is not None:
                os._exit(128 + seen[0])
            self.signal = signal.Signals(seen[0])
            with contextlib.suppress(OSError, ValueError):  # the terminal may be gone
                print("\nstopping after this chunk and saving; once more stops at once", file=sys.stderr, flush=True)
