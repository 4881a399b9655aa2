"""Files that an option names and a run depends on: each way in which one can be wrong is a line with the option."""

import contextlib
import hashlib
from collections.abc import Iterator
from pathlib import Path

from icac_jax import reading
from icac_jax.console import shown
from icac_jax.fields import ConfigError


def content(option: str, path: Path, most: int, sha256: str = "") -> bytes:
    """The bytes of a file.

    Args:
      option: that names it.
      path: of the file.
      most: bytes that it may have.
      sha256: what its checksum was when the run began, if it has begun.

    Raises:
      ConfigError: it cannot be read, or has changed.
    """
    try:
        found = reading.data(path, most)
    except OSError as error:
        raise ConfigError(f"{option}: cannot read {shown(str(path))}: {error.strerror or error}") from error
    if sha256 and checksum(found) != sha256:
        raise ConfigError(f"{option}: {shown(str(path))} is not what it was when the run began")
    return found


def checksum(content: bytes) -> str:
    """By which a run knows its file again."""
    return hashlib.sha256(content).hexdigest()


@contextlib.contextmanager
def parsing(option: str, path: Path, what: str) -> Iterator[None]:
    """Turns whatever a parser raises into a line: altered bytes make it raise nearly anything.

    Args:
      option: that names the file.
      path: of the file.
      what: the file should be.

    Raises:
      ConfigError: something was raised.
    """
    try:
        yield
    except ConfigError:
        raise
    except Exception as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise ConfigError(f"{option}: {shown(str(path))} is no readable {what} ({shown(reason)})") from error
