"""Writing a file so that at any instant either the old one or the new one is there, whole."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO

PARTIAL = ".partial"


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """A file to write to, which takes the place of `path` when the block ends without an error.

    It is written beside `path`, flushed to the disk and then moved, and the move itself is flushed too.

    Raises:
      OSError: the disk is full or the folder cannot be written; `path` is untouched and nothing is left beside it.
    """
    partial = path.with_name(path.name + PARTIAL)
    try:
        with partial.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def write_text(path: Path, text: str) -> None:
    """Replaces `path` by a file with this text."""
    with replacing(path) as file:
        file.write(text.encode())
