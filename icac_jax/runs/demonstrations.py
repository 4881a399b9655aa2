"""What the learners of a run are shown: episodes of the oracle, each seed's its own, or those of a file.

J is the number of jobs, T the largest number of transitions that one of them is shown.
"""

import functools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from icac_jax.agents.imitation import NONE, Demonstrations
from icac_jax.agents.replay import Experience
from icac_jax.envs import demonstrator, reach
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.demonstrator import Recorded
from icac_jax.envs.reach import ReachParams
from icac_jax.errors import ConfigError
from icac_jax.runs import build, cache, files
from icac_jax.settings import demonstration_files
from icac_jax.settings.options import Settings

# Of the key of a seed, beside the three streams of its lane (`rollout`).
_STREAM = 3
_LEAST_ROWS = 256

Task = tuple[Settings, int, ReachParams]
"""Settings, seed, and the task's Python numbers for that seed."""


def shown(tasks: Sequence[Task]) -> Callable[[], Demonstrations] | None:
    """What gives the demonstrations of jobs, leaves [J, ...]; None where all start from nothing.

    Args:
      tasks: of the jobs.
    """
    if all(settings.imitation.demonstrations == NONE for settings, *_ in tasks):
        return None
    return functools.partial(_stacked, list(tasks))


def _stacked(tasks: list[Task]) -> Demonstrations:
    most: dict[Any, int] = {}
    for task in tasks:
        most[_key(task)] = max(most.get(_key(task), 0), task[0].imitation.of_oracle)
    recorded = [_of(task, most[_key(task)]) for task in tasks]
    longest = max(len(one.episode) for one in recorded)
    longest = max(_LEAST_ROWS, 1 << max(0, longest - 1).bit_length())  # few shapes, few compiles

    def column(*parts: np.ndarray) -> Any:
        whole = np.zeros((len(parts), longest, *parts[0].shape[1:]), parts[0].dtype)
        for number, part in enumerate(parts):
            whole[number, : len(part)] = part
        return whole

    columns: Any = Recorded(*map(column, *recorded))
    over = column(*(np.append(np.diff(one.episode) != 0, True)[: len(one.episode)] for one in recorded))
    options = [settings.imitation for settings, *_ in tasks]
    numbers: Any = np.array  # on the host, as all leaves
    return Demonstrations(
        seen=Experience(
            observation=columns.observation,
            action=columns.action,
            next_observation=columns.next_observation,
            achieved=columns.achieved,
            reward=columns.reward,
            bonus=np.zeros_like(columns.reward),
            terminated=columns.terminated,
        ),
        over=over,
        count=numbers([len(one.episode) for one in recorded], np.int32),
        updates=numbers([one.pretraining_updates for one in options], np.int32),
        rate=numbers([one.pretraining_rate for one in options], np.float32),
    )


def _key(task: Task) -> tuple[Any, ...]:
    """What episodes of the oracle depend on."""
    settings, seed, params = task
    run = settings.run
    return settings.arm, run.physics, run.sub_steps, run.root_seed, seed, params, settings.imitation.demonstration_noise


def _of(task: Task, most: int) -> Recorded:
    """What a job is shown; `most` is how many episodes of the same ones any job is."""
    settings, _, params = task
    if settings.imitation.from_file:
        return demonstration_files.read(settings.imitation, settings.arm, params)
    return _played(*_key(task), most).first(settings.imitation.of_oracle)


@functools.lru_cache(maxsize=4096)
def _played(
    arm: ArmSpec,
    physics: str,
    sub_steps: int,
    root_seed: int,
    seed: int,
    params: ReachParams,
    noise: float,
    episodes: int,
) -> Recorded:
    env = reach.make(arm, physics, sub_steps, cache=cache.current())
    stream = jax.random.fold_in(jax.random.fold_in(jax.random.key(root_seed), seed), _STREAM)
    return demonstrator.demonstrate(arm, env, params, stream, episodes, noise)


def of_oracle(settings: Settings, seed: int) -> Recorded:
    """The episodes that a run with these settings shows to a seed.

    Raises:
      ConfigError: there are walls, or too few episodes reach their goal.
    """
    return _of((settings, seed, build.task(settings, seed)), settings.imitation.of_oracle)


def write(path: Path, recorded: Recorded, arm: ArmSpec, params: ReachParams, **facts: Any) -> None:
    """Writes demonstrations as a Parquet file with a row per transition.

    Args:
      path: of the file; one that is there is replaced.
      recorded: at least one episode.
      arm: of the task.
      params: Python numbers of the task.
      facts: what else its metadata is to say.

    Raises:
      ConfigError: it cannot be written.
    """
    meta = {
        "format": demonstration_files.FORMAT,
        "arm": arm.name,
        "task": demonstration_files.task_of(arm, params),
        **facts,
    }
    arrays = [_array(column) for column in recorded]
    table = pa.table(dict(zip(demonstration_files.COLUMNS, arrays, strict=True)))
    table = table.replace_schema_metadata({demonstration_files.METADATA: json.dumps(meta).encode()})
    try:
        with files.replacing(path) as file:
            pq.write_table(table, file, compression="zstd", write_page_checksum=True)
    except OSError as error:
        raise ConfigError(f"out: cannot write to {path}: {error.strerror or error}") from error


def _array(column: np.ndarray) -> pa.Array:
    """A column of numbers, or of lists of one length."""
    flat = pa.array(np.ascontiguousarray(column).ravel())
    return flat if column.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, column.shape[1])
