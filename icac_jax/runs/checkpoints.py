"""Checkpoints: the whole state of a run in one NumPy archive, exact to the bit.

One file, so that at any instant either the old or the new one is there. The archive's checksums show a damaged file;
reading one runs no code.
"""

import contextlib
import json
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax import reading, shapes
from icac_jax.errors import DamagedError
from icac_jax.rollout import LaneState
from icac_jax.runs import files

_PATTERN = re.compile(r"checkpoint-(\d{8,12})\.npz")
_META = "meta"
_META_SHAPE = shapes.record({"options": shapes.mapping(shapes.anything), "seconds": shapes.amount})


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


def named_leaves(states: Any) -> dict[str, Any]:
    """Every array of a state by its path."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(states)
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def listed(folder: Path) -> list[Path]:
    """The checkpoints in `folder`, oldest first."""
    found = [path for path in folder.glob("checkpoint-*.npz") if _PATTERN.fullmatch(path.name)]
    return sorted(found, key=number)


def number(path: Path) -> int:
    """The number in the name of a checkpoint; a later one has a higher number."""
    match = _PATTERN.fullmatch(path.name)
    assert match is not None
    return int(match[1])


def save(folder: Path, lanes: LaneState, meta: dict[str, Any], keep: int = 2, width: int | None = None) -> Path:
    """Writes the next checkpoint and drops all but the last `keep`.

    Args:
      folder: where checkpoints lie; made if missing.
      lanes: the state of all lanes.
      meta: what JSON can hold.
      keep: how many to keep, the new one included.
      width: how many of the lanes are written; those beyond are padding. All by default.

    Raises:
      OSError: the disk is full or the folder cannot be written; earlier checkpoints are untouched.
    """
    files.make_folder(folder)
    old = listed(folder)
    path = folder / f"checkpoint-{number(old[-1]) + 1 if old else 1:08d}.npz"
    named = {
        name: np.asarray(jax.device_get(jax.random.key_data(leaf) if _is_key(leaf) else leaf))[:width]
        for name, leaf in named_leaves(lanes).items()
    }
    named[_META] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    with files.replacing(path) as file:
        np.savez(file, **named)  # pyright: ignore[reportArgumentType]  (names are array names)
    for stale in old[: len(old) + 1 - keep]:
        stale.unlink(missing_ok=True)
    return path


def read_meta(path: Path) -> dict[str, Any]:
    """The facts of the host loop in a checkpoint: `options` of the run, `seconds` trained.

    Raises:
      DamagedError: it cannot be read.
    """
    with damage(path), opened(path) as archive:
        meta = reading.parsed_json(archive[_META].tobytes())
        if not shapes.fits(_META_SHAPE, meta):
            raise _OtherRunError("its facts about the run are not valid")
        return meta


def load(path: Path, template: LaneState, lanes: int) -> Checkpoint:
    """Reads a checkpoint back into the shape of `template`.

    Args:
      path: the file.
      template: a state of the same run, for its structure; padding beyond what was saved takes its values.
      lanes: how many lanes must be there, padding left out.

    Raises:
      DamagedError: the file is cut short, altered, or of another run.
    """
    meta = read_meta(path)
    with damage(path):
        return Checkpoint(_read_lanes(path, template, lanes), meta, path)


class _OtherRunError(Exception):
    pass


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The arrays of an archive as `save` writes it: not compressed, so that they take no more memory than the file."""
    with reading.regular(path) as file:
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in zipfile.ZipFile(file).infolist()):
            raise ValueError("it is compressed")
        file.seek(0)
        with np.load(file, allow_pickle=False) as archive:
            yield archive


@contextlib.contextmanager
def damage(path: Path) -> Iterator[None]:
    """Turns whatever reading the archive raises into one line that names it."""
    try:
        yield
    except _OtherRunError as error:
        raise DamagedError(f"{path}: not a checkpoint of this run ({error})") from error
    except Exception as error:  # altered bytes make the archive reader raise nearly anything
        reason = getattr(error, "strerror", None) or str(error).partition("\n")[0] or type(error).__name__
        raise DamagedError(f"{path}: not a readable checkpoint ({reason})") from error


# Until version 0.1.0 the state of each learner had these places, and each lane summed up curiosity's reward.
_FORMER_PLACES = (("agent.cacla.", "agent.agent."), ("agent.cacla.", "agent."))
_FORMER_SUMS = ("totals.intrinsic_reward", "totals.learning_progress", "totals.perception_error")


def _as_now(stored: dict[str, np.ndarray], wanted: set[str]) -> dict[str, np.ndarray]:
    """Arrays of an earlier version under the names of this one; as they are where they are of something else."""
    for former, now in _FORMER_PLACES:
        renamed = {
            now + name.removeprefix(former) if name.startswith(former) else name: stored[name] for name in stored
        }
        kept = {name: renamed[name] for name in renamed if name in wanted or name not in _FORMER_SUMS}
        if set(kept) == wanted:
            return kept
    return stored


def _read_lanes(path: Path, template: LaneState, lanes: int) -> LaneState:
    with opened(path) as archive:
        stored = {name: archive[name] for name in archive.files if name != _META}
    named = named_leaves(template)
    if set(stored) != set(named):
        stored = _as_now(stored, set(named))
    if set(stored) != set(named):
        raise _OtherRunError("other arrays than expected")
    leaves = []
    for name, leaf in named.items():
        raw = np.array(jax.random.key_data(leaf) if _is_key(leaf) else leaf)
        value = stored[name]
        if value.dtype != raw.dtype or value.shape[1:] != raw.shape[1:] or value.shape[:1] < (lanes,):
            raise _OtherRunError(f"{name} has another shape or type")
        shared = min(len(raw), len(value))
        raw[:shared] = value[:shared]
        if _is_key(leaf):
            leaves.append(jax.random.wrap_key_data(jnp.asarray(raw), impl=jax.random.key_impl(leaf)))
        else:
            leaves.append(raw)
    return jax.tree.unflatten(jax.tree.structure(template), leaves)
