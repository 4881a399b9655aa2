"""Checkpoints: the whole state of a run in one NumPy archive, exact to the bit.

One file, written beside its place, flushed to the disk and then moved, so that at any instant either the old or the new
one is there. The archive's checksums show a damaged file; reading one runs no code.
"""

import json
import os
import re
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax.rollout import LaneState

_PATTERN = re.compile(r"checkpoint-(\d{8})\.npz")
_META = "meta"


class DamagedError(Exception):
    """A file of the run cannot be read; the message is one line that names it."""


class Checkpoint(NamedTuple):
    """What was saved.

    Attributes:
      lanes: leaves [L, ...] on the host, padding included.
      meta: facts of the host loop (`lane_steps`, `seconds`, the options of the run).
      path: the file.
    """

    lanes: LaneState
    meta: dict[str, Any]
    path: Path


def _named_leaves(lanes: LaneState) -> dict[str, Any]:
    """Every array of the state by its path; typed keys as their raw words."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(lanes)
    return {jax.tree_util.keystr(path).lstrip("."): leaf for path, leaf in leaves}


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def listed(folder: Path) -> list[Path]:
    """The checkpoints in `folder`, oldest first."""
    found = [path for path in folder.glob("checkpoint-*.npz") if _PATTERN.fullmatch(path.name)]
    return sorted(found)


def save(folder: Path, lanes: LaneState, meta: dict[str, Any], keep: int = 2) -> Path:
    """Writes the next checkpoint and drops all but the last `keep`.

    Args:
      folder: where checkpoints lie; made if missing.
      lanes: the state of all lanes.
      meta: what JSON can hold.
      keep: how many to keep, the new one included.

    Raises:
      OSError: the disk is full or the folder cannot be written; earlier checkpoints are untouched.
    """
    folder.mkdir(exist_ok=True)
    old = listed(folder)
    number = int(_PATTERN.fullmatch(old[-1].name)[1]) + 1 if old else 1  # pyright: ignore[reportOptionalSubscript]
    path = folder / f"checkpoint-{number:08d}.npz"
    named = {
        name: np.asarray(jax.device_get(jax.random.key_data(leaf) if _is_key(leaf) else leaf))
        for name, leaf in _named_leaves(lanes).items()
    }
    named[_META] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("wb") as file:
            np.savez(file, **named)  # pyright: ignore[reportArgumentType]  (names are array names)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise
    for stale in old[: len(old) + 1 - keep]:
        stale.unlink(missing_ok=True)
    return path


def load(path: Path, template: LaneState) -> Checkpoint:
    """Reads a checkpoint back into the shape of `template`.

    Args:
      path: the file.
      template: a state of the same run, for its structure; its values are not used. More lanes than were saved (another
        padding) take the values of the template.

    Raises:
      DamagedError: the file is cut short, altered, or of another run.
    """
    names = _named_leaves(template)
    try:
        with np.load(path, allow_pickle=False) as archive:
            stored = {name: archive[name] for name in archive.files}
        meta = json.loads(stored.pop(_META).tobytes())
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, NotImplementedError) as error:
        raise DamagedError(f"{path}: not a readable checkpoint ({str(error).splitlines()[0]})") from error
    if set(stored) != set(names) or not isinstance(meta, dict):
        raise DamagedError(f"{path}: not a checkpoint of this run (other arrays than expected)")
    leaves = []
    for name, leaf in names.items():
        raw = np.array(jax.random.key_data(leaf) if _is_key(leaf) else leaf)
        value = stored[name]
        if value.dtype != raw.dtype or value.shape[1:] != raw.shape[1:]:
            raise DamagedError(f"{path}: not a checkpoint of this run ({name} has another shape or type)")
        shared = min(len(raw), len(value))
        raw[:shared] = value[:shared]
        leaves.append(jax.random.wrap_key_data(raw, impl=jax.random.key_impl(leaf)) if _is_key(leaf) else raw)  # pyright: ignore[reportArgumentType]
    return Checkpoint(jax.tree.unflatten(jax.tree.structure(template), leaves), meta, path)
