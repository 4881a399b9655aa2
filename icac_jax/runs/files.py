"""Writing into a run folder: whole files or nothing, flushed to the disk, never through a link to somewhere else."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from icac_jax.runs import signals

PARTIAL = ".partial"
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | _NO_LINK
# A pipe that lies where a file should must not make this process wait.
_MORE = os.O_WRONLY | os.O_CREAT | os.O_APPEND | _NO_LINK | getattr(os, "O_NONBLOCK", 0)


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
        with signals.unfinished(partial):
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
    """Replaces `path` by a file with this text in UTF-8; bytes of a name that are none are written as escapes."""
    with replacing(path) as file:
        file.write(text.encode(errors="backslashreplace"))


def append_line(path: Path, line: str) -> None:
    """Adds a line to a file, which is made if it is not there."""
    with os.fdopen(os.open(path, _MORE, 0o666), "wb") as file:
        file.write(f"{line}\n".encode(errors="backslashreplace"))


def remove_partial(*folders: Path) -> None:
    """Removes what a killed process was in the middle of writing into these folders."""
    for folder in folders:
        for path in folder.glob(f"*{PARTIAL}"):
            with contextlib.suppress(OSError):
                path.unlink()


def make_folder(path: Path) -> None:
    """Makes a folder within an existing one if it is not there."""
    if path.is_symlink():
        raise NotADirectoryError(20, "is a link", str(path))
    path.mkdir(exist_ok=True)
    _flush(path.parent)
