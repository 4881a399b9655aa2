"""Connections by which processes that share work notice at once that one of them has ended, and say which.

Processes send what they are over a connection to process 0 and keep it open. Where one ends without having said that
it is done, process 0 tells the others.
"""

import atexit
import contextlib
import json
import socket
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from icac_jax.fields import ConfigError

_PATIENCE = 120.0  # seconds for all to come
# A host without power closes no connection: seconds until it is asked, between askings, and how many go unanswered.
_ASKING = {"TCP_KEEPIDLE": 30, "TCP_KEEPINTVL": 10, "TCP_KEEPCNT": 3}
_DONE = "done"
_LONGEST = 2**16  # bytes of a line: anybody may connect

Facts = dict[str, Any]


class Link:
    """A connection that carries lines of JSON."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _ASKING.items():
            if hasattr(socket, name):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        self._connection = connection
        self._lines = connection.makefile("rb")

    def say(self, words: Any) -> None:
        """Sends something; nothing happens where nobody is at the other end."""
        with contextlib.suppress(OSError):
            self._connection.sendall(json.dumps(words).encode() + b"\n")

    def hear(self, seconds: float | None = None) -> Any:
        """What the other end sends next; None if it has ended, or sends what this module does not."""
        try:
            self._connection.settimeout(seconds)
            return json.loads(self._lines.readline(_LONGEST))
        except (OSError, ValueError):
            return None

    def close(self) -> None:
        """Ends it; whoever waits in `hear` gets None."""
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        with contextlib.suppress(OSError):
            self._lines.close()
            self._connection.close()


def join(address: str, index: int, facts: Facts, count: int) -> tuple[list[Facts], dict[int, Link]]:
    """Connects processes; all must call it.

    Args:
      address: host:port where process 0 listens.
      index: of this process.
      facts: what the others are to know of this one.
      count: how many processes there are.

    Returns:
      What all processes are, in order, and the connections by index: to all others from process 0, to it from others.

    Raises:
      ConfigError: they do not come together.
    """
    host, _, port = address.rpartition(":")
    end = time.monotonic() + _PATIENCE
    mine = {"index": index, "facts": facts}
    if index > 0:
        return _reach(host.strip("[]"), int(port), mine, end)
    links: dict[int, Link] = {}
    known = {0: facts}
    with _listening(int(port), end) as server:
        while len(known) < count:
            server.settimeout(max(0.01, end - time.monotonic()))
            try:
                link = Link(server.accept()[0])
            except TimeoutError as error:
                lacking = sorted(set(range(count)) - set(known))
                raise ConfigError(f"coordinator: process {lacking[0]} of {count} does not answer") from error
            theirs = link.hear(10.0)
            try:
                known[int(theirs["index"])] = dict(theirs["facts"])
                links[int(theirs["index"])] = link
            except (KeyError, TypeError, ValueError):  # nobody of these processes
                link.close()
    everyone = [known[number] for number in range(count)]
    for link in links.values():
        link.say(everyone)
    return everyone, links


def _listening(port: int, end: float) -> socket.socket:
    """A server at a port that another server may be leaving."""
    while True:
        try:
            if socket.has_dualstack_ipv6():
                return socket.create_server(("", port), family=socket.AF_INET6, dualstack_ipv6=True)
            return socket.create_server(("", port))
        except OSError as error:
            if time.monotonic() > end:
                raise ConfigError(f"coordinator: cannot listen at port {port} ({error.strerror})") from error
            time.sleep(0.1)


def _reach(host: str, port: int, mine: Facts, end: float) -> tuple[list[Facts], dict[int, Link]]:
    while time.monotonic() < end:
        with contextlib.suppress(OSError):
            link = Link(socket.create_connection((host, port), timeout=10.0))
            link.say(mine)
            everyone = link.hear(max(0.01, end - time.monotonic()))
            if isinstance(everyone, list):
                return everyone, {0: link}
            link.close()  # a server that is leaving
        time.sleep(0.1)
    raise ConfigError(f"coordinator: process 0 does not answer at {host}:{port}")


def watch(links: dict[int, Link], ended: Callable[[int], None]) -> None:
    """Calls `ended` in a thread, with its index, when a process ends before its work is done.

    What this process says at its own end is "done", unless an exception or `os._exit` ends it.

    Args:
      links: as `join` gives them.
      ended: called once per process that ended, perhaps in several threads.
    """

    def listen(index: int, link: Link) -> None:
        said = link.hear()
        if said == _DONE:
            return
        gone = said if isinstance(said, int) else index
        for other, their in links.items():
            if other != index:
                their.say(gone)
        ended(gone)

    for index, link in links.items():
        threading.Thread(target=listen, args=(index, link), daemon=True).start()
    atexit.register(_leave, links)


def _leave(links: dict[int, Link]) -> None:
    if not hasattr(sys, "last_value"):  # what an exception that nobody caught leaves behind
        for link in links.values():
            link.say(_DONE)
