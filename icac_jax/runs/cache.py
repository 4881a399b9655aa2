"""What takes seconds to compute and is the same in every start, kept as JSON in the user's cache folder.

A file is recognised by a checksum of all that its content depends on, and holds a checksum of its content. Reading one
runs nothing. One that is damaged, or cannot be read or written, costs only the time to compute it anew.
"""

import contextlib
import hashlib
import importlib.metadata
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from icac_jax import reading
from icac_jax.envs import model, oracle, physics, reach
from icac_jax.fast import arithmetic, folding, moves, scalars
from icac_jax.fast.arithmetic import Arithmetic
from icac_jax.runs import files

# Programs whose text decides what is computed.
_SOURCES = (arithmetic, folding, model, moves, oracle, physics, reach, scalars)


class Cache:
    """What is kept in one folder; without a folder everything is computed each time.

    Args:
      folder: need not exist.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder

    def kept(self, name: str, facts: bytes, compute: Callable[[], Any]) -> Any:
        """What `compute` gives, from the folder if it is there.

        Args:
          name: a word for what it is, for the file's name.
          facts: all that the result depends on, beside the versions of programs.
          compute: gives what JSON can hold.
        """
        if self.folder is None:
            return compute()
        path = self.folder / f"{name}-{_checksum(_versions() + facts)[:32]}.json"
        found = _read(path)
        if found is None:
            found = compute()
            _write(path, found)
        return found

    def arithmetic(self, facts: bytes, trace: Callable[[], Arithmetic]) -> Arithmetic:
        """What `trace` gives, from the folder if it is there; as `physics.Cache` has it.

        Args:
          facts: all that the result depends on, beside the versions and settings of programs.
          trace: gives it.
        """
        settings = f"{jax.default_backend()} {jax.config.values['jax_enable_x64']}\n".encode()
        written: list[Arithmetic] = []

        def as_json() -> Any:
            written.append(trace())
            return written[0].as_json()

        try:
            data = self.kept("arithmetic", settings + facts, as_json)
            return written[0] if written else arithmetic.from_json(data)
        except ValueError:  # it is something that JSON cannot hold, or not what it should be
            return written[0] if written else trace()


# The one setting of this process: which cache its runs use, as jax_compilation_cache_dir says it of compiled programs.
# Set at the start by `use`, read by `current`, and changed by nothing else.
_current = Cache()


def use(folder: Path) -> None:
    """Has the runs of this process keep things in this folder from now on."""
    global _current
    _current = Cache(folder)


def current() -> Cache:
    """The cache of this process; one without a folder until `use` is called."""
    return _current


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _versions() -> bytes:
    """The programs by which things are computed."""
    packages = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy", "scipy")
    facts = [f"{package} {importlib.metadata.version(package)}".encode() for package in packages]
    return b"\n".join([*facts, *(Path(str(module.__file__)).read_bytes() for module in _SOURCES), b""])


def _read(path: Path) -> Any:
    """The content of a file, None if it is not there or not whole."""
    try:
        checksum, _, body = reading.text(path).partition("\n")
        return reading.parsed_json(body) if checksum == _checksum(body.encode()) else None
    except (OSError, ValueError):
        return None


def _write(path: Path, value: Any) -> None:
    """Writes a file if that can be done."""
    body = json.dumps(value, separators=(",", ":"))
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        files.write_text(path, f"{_checksum(body.encode())}\n{body}")
