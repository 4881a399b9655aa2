"""Writing into a run folder: whole files or nothing, flushed to the disk, never through a link to somewhere else."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO

PARTIAL = ".partial"
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW


def _flush(folder: Path) -> None:
    """Makes names that were added to or moved in a folder survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """A file to write to, which takes the place of `path` when the block ends without an error.

    It is written beside `path`, flushed to the disk and then moved, and the move itself is flushed too: at any instant
    either the old file or the new one is there, whole.

    Raises:
      OSError: the disk is full or the folder cannot be written; nothing half-written is left.
    """
    partial = path.with_name(path.name + PARTIAL)
    partial.unlink(missing_ok=True)
    try:
        with os.fdopen(os.open(partial, _NEW, 0o666), "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    _flush(path.parent)


def write_text(path: Path, text: str) -> None:
    """Replaces `path` by a file with this text."""
    with replacing(path) as file:
        file.write(text.encode())


def append_line(path: Path, line: str) -> None:
    """Adds a line to a file, which is made if it is not there."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o666)
    with os.fdopen(descriptor, "w") as file:
        file.write(line + "\n")


def make_folder(path: Path) -> None:
    """Makes a folder within an existing one if it is not there."""
    if path.is_symlink():
        raise NotADirectoryError(20, "is a link", str(path))
    path.mkdir(exist_ok=True)
    _flush(path.parent)
