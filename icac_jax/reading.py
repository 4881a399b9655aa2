"""Reading files that may come from anybody: regular files of a sane size only, in UTF-8, TOML and JSON of sane depth.

Everything that a command reads from a run, a study, an arm or a policy goes through here. A failure is an `OSError`
(its `strerror` says why) or a `ValueError`, each in one line.
"""

import errno
import io
import json
import os
import stat
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

MOST = 2**26
"""Bytes of a file that is read as a whole."""
_MOST_LINES = 2**31
_DEPTH = 100
_BITS = 4096  # a whole number of about 1,200 digits; Python itself prints up to 4,300
# Opening a pipe must not wait for who writes into it, and a terminal must not become that of this process.
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)


def regular(path: Path) -> io.BufferedReader:
    """Opens a regular file, or a link to one, for reading.

    Raises:
      OSError: it cannot be opened, or is a folder, a pipe, a socket or a device.
    """
    descriptor = os.open(path, _FLAGS)
    try:
        mode = os.fstat(descriptor).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "Not a regular file", str(path))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def data(path: Path, most: int = MOST) -> bytes:
    """The bytes of a file.

    Raises:
      OSError: see `regular`; or it holds more than `most` bytes.
    """
    with regular(path) as file:
        found = file.read(most + 1)
    if len(found) > most:
        raise OSError(errno.EFBIG, f"Larger than {most >> 20} MiB", str(path))
    return found


def text(path: Path, most: int = MOST) -> str:
    """The text of a file in UTF-8, with or without a byte order mark.

    Raises:
      OSError: see `data`.
      ValueError: it is not UTF-8.
    """
    return data(path, most).decode("utf-8-sig")


def parsed_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises:
      ValueError: it is not TOML, or goes beyond what is read.
    """
    return _sane(lambda: tomllib.loads(text))


def toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file; errors as of `text` and `parsed_toml`."""
    return parsed_toml(text(path))


def parsed_json(text: str | bytes) -> Any:
    """What a JSON text holds.

    Raises:
      ValueError: it is not JSON, or goes beyond what is read.
    """
    return _sane(lambda: json.loads(text))


def json_object(path: Path) -> dict[str, Any]:
    """The JSON object in a file; empty where there is none or it cannot be read."""
    try:
        facts = parsed_json(text(path))
    except (OSError, ValueError):
        return {}
    return facts if isinstance(facts, dict) else {}


def json_lines(path: Path) -> Iterator[dict[str, Any]]:
    """The JSON objects of a file with one a line; lines that cannot be read are left out.

    Raises:
      OSError: the file cannot be read.
    """
    with regular(path) as file:
        left = _MOST_LINES
        while left > 0 and (line := file.readline(MOST)):
            left -= len(line)
            try:
                facts = parsed_json(line)
            except ValueError:
                continue
            if isinstance(facts, dict):
                yield facts


def _sane(parse: Any) -> Any:
    """What a parser gives, unless printing it or going through it could fail later."""
    try:
        value = parse()
    except RecursionError:
        raise ValueError("nested too deeply") from None
    level = [value]
    for _ in range(_DEPTH):
        if not level:
            return value
        inner: list[Any] = []
        for one in level:
            if isinstance(one, dict):
                inner += one.values()
            elif isinstance(one, list):
                inner += one
            elif isinstance(one, int) and one.bit_length() > _BITS:
                raise ValueError("a number has too many digits")
        level = inner
    raise ValueError("nested too deeply")
