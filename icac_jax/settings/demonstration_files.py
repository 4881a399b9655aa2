"""Files of demonstrations: Parquet with a row per transition, the task that they are of in its metadata.

What is read here is written by `runs.demonstrations`; every way in which a file can be wrong is a line.
"""

import dataclasses
import functools
import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from icac_jax import reading, shapes
from icac_jax.agents.imitation import ImitationOptions
from icac_jax.console import shown
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.demonstrator import Recorded
from icac_jax.envs.reach import ReachParams
from icac_jax.fields import ConfigError
from icac_jax.settings import named_files

if TYPE_CHECKING:
    import pyarrow as pa

_OPTION = "demonstrations"
METADATA = b"icac_jax"
FORMAT = 1
# Columns in the file, in the order of `Recorded`.
COLUMNS = ("observation", "action", "reward", "next_observation", "terminated", "achieved_goal", "episode")
MOST = 2**30
# Numbers of the task that observations, actions and rewards depend on.
_OF_TASK = ("joint_low", "joint_high", "action_bound", "goal_radius", "goal_reward", "step_cost")
_SHAPE = shapes.record({"format": shapes.whole, "arm": shapes.text, "task": shapes.mapping(shapes.anything)})


def whole(name: Any) -> Any:
    """The option `demonstrations` with the whole path of a file, the same wherever the command is called."""
    if not isinstance(name, str) or not ImitationOptions(demonstrations=name).from_file:
        return name
    return str(Path(name).expanduser().resolve())


def found(options: ImitationOptions, arm: ArmSpec, params: ReachParams) -> ImitationOptions:
    """The options with the whole path and the checksum of their file, which is read if it has none yet.

    Args:
      options: as said; those without a file come back unchanged.
      arm: of the run.
      params: Python numbers of its task.

    Raises:
      ConfigError: the file cannot be read, is damaged or is of another task.
    """
    if not options.from_file:
        return options
    path = Path(whole(options.demonstrations))
    if options.demonstrations_sha256:  # of a run that was begun: its copy is read where it is needed
        return dataclasses.replace(options, demonstrations=str(path))
    sha256 = named_files.checksum(named_files.content(_OPTION, path, MOST))
    options = dataclasses.replace(options, demonstrations=str(path), demonstrations_sha256=sha256)
    read(options, arm, params)
    return options


def task_of(arm: ArmSpec, params: ReachParams) -> dict[str, Any]:
    """What the numbers in demonstrations depend on, as JSON holds it."""
    facts = {name: getattr(params, name) for name in _OF_TASK}
    facts |= {name: getattr(arm, name) for name in ("goal_axes", "goal_low", "goal_high")}
    return json.loads(json.dumps(facts))


def read(options: ImitationOptions, arm: ArmSpec, params: ReachParams) -> Recorded:
    """The episodes that a run takes from its file.

    Args:
      options: of the run, with path and checksum of the file.
      arm: of the run.
      params: Python numbers of its task.

    Raises:
      ConfigError: the file cannot be read, has changed, is damaged, of another task, or has too few episodes.
    """
    path = Path(options.demonstrations)
    named = shown(str(path))
    recorded, facts = _read(str(path), options.demonstrations_sha256)
    if facts["arm"] != arm.name:
        raise ConfigError(f"demonstrations: must be of {arm.name}, {named} is of {shown(facts['arm'])}")
    for name, value in task_of(arm, params).items():
        if facts["task"].get(name) != value:
            there = shown(json.dumps(facts["task"].get(name)))
            raise ConfigError(
                f"demonstrations: {name} must be {json.dumps(value)} as in the run, {named} was recorded with {there}"
            )
    sizes = {"observation": arm.observation_size, "action": arm.joints, "achieved_goal": 3}
    for name, column in (
        ("observation", recorded.observation),
        ("action", recorded.action),
        ("achieved_goal", recorded.achieved),
    ):
        if column.shape[1] != sizes[name]:
            raise ConfigError(f"demonstrations: {name} must have {sizes[name]} entries, {named} has {column.shape[1]}")
    if options.demonstrated_episodes > recorded.episodes:
        raise ConfigError(
            f"demonstrated_episodes: must be at most {recorded.episodes}, the episodes of {named}, "
            f"got {options.demonstrated_episodes}"
        )
    return recorded if options.demonstrated_episodes < 0 else recorded.first(options.demonstrated_episodes)


@functools.lru_cache(maxsize=4)
def _read(name: str, sha256: str) -> tuple[Recorded, dict[str, Any]]:
    """What a file holds, and what its metadata says; kept by its checksum."""
    path = Path(name)
    content = named_files.content(_OPTION, path, MOST, sha256)
    import pyarrow.parquet as pq  # only who has demonstrations waits for it

    with named_files.parsing(_OPTION, path, "file of demonstrations"):
        table = pq.read_table(io.BytesIO(content), page_checksum_verification=True, pre_buffer=False, use_threads=False)
        facts = reading.parsed_json((table.schema.metadata or {}).get(METADATA, b"null"))
        if not shapes.fits(_SHAPE, facts) or facts["format"] != FORMAT:
            raise ValueError("no metadata of icac demonstrate")
        return _recorded(table), facts


def _recorded(table: "pa.Table") -> Recorded:
    missing = [name for name in COLUMNS if name not in table.column_names]
    if missing:
        raise ValueError(f"it has no column {', '.join(missing)}")
    if not table.num_rows:
        raise ValueError("it has no rows")
    columns = {}
    for name in COLUMNS:
        column = table[name]
        if column.null_count:
            raise ValueError(f"{name} has missing values")
        kind = {"terminated": np.bool_, "episode": np.int32}.get(name, np.float32)
        if name in ("observation", "action", "next_observation", "achieved_goal"):
            rows = column.to_pylist()
            size = len(rows[0])
            if size == 0 or any(len(row) != size or None in row for row in rows):
                raise ValueError(f"{name} has rows of several sizes, or missing values")
            columns[name] = np.array(rows, kind)
        else:
            columns[name] = column.to_numpy().astype(kind)
        if not np.all(np.isfinite(columns[name])):
            raise ValueError(f"{name} must be finite numbers")
    if columns["observation"].shape != columns["next_observation"].shape:
        raise ValueError("next_observation has another size than observation")
    episode = columns["episode"]
    if episode[0] != 0 or np.any((np.diff(episode) != 0) & (np.diff(episode) != 1)):
        raise ValueError("episode must count from 0 in steps of 1")
    last = np.append(np.diff(episode) != 0, True)
    if np.any(columns["terminated"] & ~last):
        raise ValueError("terminated must be true in the last row of an episode only")
    if np.max(np.abs(columns["action"])) > 1.0 + 1e-6:
        raise ValueError("action must be within -1 and 1")
    return Recorded(*(columns[name] for name in COLUMNS))
