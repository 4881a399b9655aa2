"""Warm maps: a run that starts with the map and the predictors of another one, seed by seed.

What is taken over is the whole state of curiosity: nodes, predictors with their windows of errors, counts of steps.
Nothing of the actor, the critic or a buffer is. States are normalised over the joint ranges: with other ranges than the
first run's, nodes stand at other angles, and predictors know moves of another size.

A run keeps its own copy, so that it can be resumed, moved and evaluated without the run that the map came from. S is
the number of seeds that the map was kept of, L the number of lanes.
"""

import hashlib
import json
import re
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax import reading, shapes
from icac_jax.console import shown
from icac_jax.errors import ConfigError, DamagedError
from icac_jax.rollout import LaneState
from icac_jax.runs import build, checkpoints, files
from icac_jax.runs import folder as run_folder
from icac_jax.settings.options import Settings, resolve

# Choices that say what the numbers of a map and its predictors mean; sizes are those of the arrays.
_SAME = ("map", "signal", "map_input", "predictors", "predictor_output", "som_side", "som_dimensions", "grid_side")
# The state of curiosity within a lane, also where visits are counted around the learner.
_STATE = re.compile(r"agent\.(?:agent\.)?curiosity\.(.+)")
_META = "meta"
_META_SHAPE = shapes.record({"options": shapes.mapping(shapes.anything)})


class WarmMap(NamedTuple):
    """The map and the predictors of a run.

    Attributes:
      source: the folder or file that they were read from.
      options: of that run, by name.
      leaves: by name within the state of curiosity, [S, ...].
    """

    source: str
    options: dict[str, Any]
    leaves: dict[str, np.ndarray]

    @property
    def seeds(self) -> int:
        """S."""
        return len(next(iter(self.leaves.values())))

    def rows(self, seeds: np.ndarray) -> np.ndarray:
        """Whose map each of some seeds takes: that of the same seed, or of the first if there is one only.

        Raises:
          ConfigError: there is no map for a seed.
        """
        if self.seeds > 1 and np.max(seeds) >= self.seeds:
            raise self.refused(f"must be of one seed or at least {np.max(seeds) + 1}", str(self.seeds))
        return seeds if self.seeds > 1 else np.zeros_like(seeds)

    def onto(self, lanes: LaneState, seeds: np.ndarray) -> LaneState:
        """Lanes with this map in place of a fresh one.

        Args:
          lanes: leaves [L, ...].
          seeds: [L] of the jobs in the lanes.
        """
        rows, named = self.rows(seeds), checkpoints.named_leaves(lanes)
        wanted = {name: match[1] for name in named if (match := _STATE.fullmatch(name))}
        changed = {name: jnp.asarray(self.leaves[short][rows]) for name, short in wanted.items()}
        return jax.tree.unflatten(jax.tree.structure(lanes), (named | changed).values())

    def check_sizes(self, state: Any) -> None:
        """Refuses a map whose arrays are not those of a learner's state, of one lane."""
        named = checkpoints.named_leaves({"agent": state})
        wanted = {match[1]: leaf for name, leaf in named.items() if (match := _STATE.fullmatch(name))}
        if wanted.keys() != self.leaves.keys():
            raise self.refused("must have the arrays that this run has", "others")
        for name, leaf in wanted.items():
            mine = self.leaves[name]
            if (mine.shape[1:], mine.dtype) != (leaf.shape, leaf.dtype):
                wants = f"{name} of {leaf.shape} {leaf.dtype}"
                raise self.refused(f"must have {wants} as this run has", f"{mine.shape[1:]} {mine.dtype}")

    def refused(self, wanted: str, has: str) -> ConfigError:
        """The line that says what a warm map must be, and what this one has instead."""
        return ConfigError(f"warm_map: {wanted}, {shown(self.source)} has {has}")


def load(settings: Settings) -> WarmMap | None:
    """The warm map of a run, None if it has none.

    Args:
      settings: of the run that starts with it.

    Raises:
      ConfigError: what `warm_map` names is no run with a map, is not what it was when this run began, or is of another
        arm, map or signal.
    """
    named, begun = settings.warm.warm_map, settings.warm.warm_map_sha256
    if not named:
        return None
    if build.agent(settings).map is None:
        who = f"the signal {settings.flat()['signal']}" if "signal" in settings.flat() else settings.algo
        raise ConfigError(f"warm_map: must not be given, {who} has no map")
    path = Path(named).expanduser()
    try:
        if path.is_dir():
            found = _of_run(path)
        else:
            if _checksum(path) != begun and begun:
                raise ConfigError(f"warm_map: {shown(named)} is not what it was when the run began")
            found = _of_file(path)
    except OSError as error:
        raise ConfigError(f"warm_map: cannot read {shown(named)}: {error.strerror or error}") from error
    except DamagedError as error:
        raise ConfigError(f"warm_map: {error}") from error
    mine, its = settings.flat(), found.options
    arm = "arm_sha256" if mine["arm_sha256"] or its.get("arm_sha256") else "arm"
    for name in (arm, *_SAME):
        if name in mine and its.get(name) != mine[name]:
            what = "arm" if name == arm else name
            raise found.refused(f"must be of a run with {what} {shown(str(mine[what]))}", shown(str(its.get(what))))
    if its.get("encoder_sha256", "") != settings.camera.encoder_sha256:
        same = "the same encoder" if settings.camera.encoder else "no encoder"
        raise found.refused(f"must be of a run with {same}", "another" if its.get("encoder") else "none")
    found.check_sizes(jax.eval_shape(build.agent(settings).init, jax.random.key(0), settings.hyper.traced()))
    bad = [seed for seed in range(found.seeds) if not all(np.isfinite(leaf[seed]).all() for leaf in _numbers(found))]
    if bad:
        raise found.refused("must have finite numbers", f"others in seed {bad[0]}, which diverged")
    return found


def _checksum(path: Path) -> str:
    found = hashlib.sha256()
    with reading.regular(path) as file:
        while block := file.read(2**20):
            found.update(block)
    return found.hexdigest()


def _numbers(found: WarmMap) -> list[np.ndarray]:
    return [leaf for leaf in found.leaves.values() if np.issubdtype(leaf.dtype, np.floating)]


def _of_run(folder: Path) -> WarmMap:
    """The map in the newest checkpoint of a run that can be read."""
    settings = run_folder.load(folder)
    problem = None
    for path in reversed(checkpoints.listed(folder / run_folder.CHECKPOINTS)):
        try:
            checkpoints.read_meta(path)
            with checkpoints.damage(path), checkpoints.opened(path) as archive:
                names = {match[1]: name for name in archive.files if (match := _STATE.fullmatch(name))}
                leaves = {short: archive[name][: settings.run.seeds] for short, name in names.items()}
        except DamagedError as error:
            problem = problem or error
            continue
        if not any(short.startswith("map.") for short in leaves):
            raise ConfigError(f"warm_map: must be a run with a map, {shown(str(folder))} has none")
        return WarmMap(str(folder.resolve()), settings.flat(), leaves)
    raise problem or ConfigError(f"warm_map: {shown(str(folder))} has no checkpoint yet")


def _of_file(path: Path) -> WarmMap:
    """The map in a file that a run with a warm map keeps."""
    with checkpoints.damage(path), checkpoints.opened(path) as archive:
        meta = reading.parsed_json(archive[_META].tobytes())
        leaves = {name: archive[name] for name in archive.files if name != _META}
        if not shapes.fits(_META_SHAPE, meta) or not leaves or len({len(leaf) for leaf in leaves.values()}) != 1:
            raise ValueError("it is no warm map")
    return WarmMap(str(path), meta["options"], leaves)


def kept(folder: Path, settings: Settings) -> Settings:
    """Writes the warm map of a run into its folder, as a copy of its own.

    Args:
      folder: of the run, locked by this process.
      settings: of the run.

    Returns:
      The settings with the copy as the warm map and where it came from; the same settings without a warm map.

    Raises:
      ConfigError: as `load`.
      OSError: the copy cannot be written.
    """
    found = load(settings)
    if found is None:
        return settings
    there = folder / run_folder.WARM_MAP
    meta = np.frombuffer(json.dumps({"options": found.options}).encode(), np.uint8)
    with files.replacing(there) as file:
        np.savez(file, **{_META: meta}, **found.leaves)  # pyright: ignore[reportArgumentType]
    changes = {
        "warm_map": str(there.resolve()),
        "warm_map_from": settings.warm.warm_map_from or found.source,
        "warm_map_sha256": _checksum(there),
    }
    return resolve(**settings.flat() | changes)
