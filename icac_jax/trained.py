"""What `icac_jax.train` gives back: arrays over seeds and settings, tables, policies."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
import pyarrow as pa

from icac_jax.agents.base import Agent
from icac_jax.fields import ConfigError
from icac_jax.reports.results import mean_of_known
from icac_jax.runs import records
from icac_jax.runs.loop import Chunk


class Trained(NamedTuple):
    """Learners after training; *shape is the common shape of seeds and options.

    Attributes:
      success: [*shape] share of the last tenth of the episodes that reached the goal; a learner that diverged fails the
        episodes that it did not get to.
      steps: [*shape] mean steps of the last tenth of the episodes that were run; a failure counts as the horizon.
      episodes: columns [*shape, episodes] of the record by name, `steps`, `reached`, `extrinsic_reward` and what the
        learner reports; NaN where a learner diverged before.
      diverged: [*shape] bool, learners that were frozen when a number stopped being finite.
      varied: seeds and options that were given as arrays, by name, each [*shape].
      seconds: spent training, compilation left out.
      agent: who learnt.
      states: what the learners know, leaves [jobs, ...] in the order of the flattened shape.
      hyper: traced numbers of the learners, leaves [jobs, ...].
    """

    success: np.ndarray
    steps: np.ndarray
    episodes: dict[str, np.ndarray]
    diverged: np.ndarray
    varied: dict[str, np.ndarray]
    seconds: float
    agent: Agent
    states: Any
    hyper: Any

    def __repr__(self) -> str:
        """Shape and outcome in one line."""
        each = " x ".join(map(str, self.success.shape)) or "1"
        lost = f", {int(self.diverged.sum())} diverged" if self.diverged.any() else ""
        return (
            f"Trained({each} learners, {self.episodes['steps'].shape[-1]:,} episodes each: success "
            f"{np.mean(self.success):.1%}, steps {np.nanmean(self.steps):.1f} in the last tenth{lost})"
        )

    def policy(self, *index: int) -> Callable[[Any], np.ndarray]:
        """A learner's policy without exploration.

        Args:
          *index: which learner, a number per axis of `success`.

        Returns:
          A function from an observation [O], or several [..., O], to actions [A] or [..., A] in [-1, 1].

        Raises:
          ConfigError: there is no such learner, or it diverged.
        """
        shape = self.success.shape
        if len(index) != len(shape) or not all(-n <= i < n for i, n in zip(index, shape, strict=True)):
            raise ConfigError(f"index: must name one learner of shape {shape}, got {index}")
        if self.diverged[index]:
            raise ConfigError(f"index: the learner {index} diverged, take another")
        number = int(np.ravel_multi_index(tuple(np.mod(index, shape)), shape)) if shape else 0
        state, hyper = jax.tree.map(lambda leaf: leaf[number], (self.states, self.hyper))
        act = jax.jit(jax.vmap(lambda observation: self.agent.greedy(state, observation, hyper)))

        def policy(observation: Any) -> np.ndarray:
            observation = np.asarray(observation, np.float32)
            actions = np.asarray(act(observation.reshape(-1, observation.shape[-1])))
            return actions.reshape(*observation.shape[:-1], actions.shape[-1])

        return policy

    def to_arrow(self) -> pa.Table:
        """One row per episode that was finished: seeds and options, `episode`, and the columns of the record."""
        steps = self.episodes["steps"]
        done = ~np.isnan(steps)
        named = {name: np.broadcast_to(value[..., None], steps.shape)[done] for name, value in self.varied.items()}
        named["episode"] = np.broadcast_to(np.arange(steps.shape[-1]), steps.shape)[done]
        return pa.table(named | {name: value[done] for name, value in self.episodes.items()})

    def to_pandas(self) -> Any:
        """`to_arrow` as a pandas data frame; pandas must be installed."""
        try:
            return self.to_arrow().to_pandas()
        except ImportError as error:
            raise ConfigError("to_pandas: needs pandas, pip install pandas") from error

    def to_polars(self) -> Any:
        """`to_arrow` as a polars data frame; polars must be installed."""
        try:
            import polars
        except ImportError as error:
            raise ConfigError("to_polars: needs polars, pip install polars") from error
        return polars.from_arrow(self.to_arrow())


def of_rows(
    agent: Agent,
    hyper: Any,
    states: Any,
    rows: list[pa.Table],
    last: Chunk,
    varied: dict[str, np.ndarray],
    shape: tuple[int, ...],
    episodes: int,
) -> Trained:
    """The result of a training.

    Args:
      agent: who learnt.
      hyper: traced numbers, leaves [jobs, ...].
      states: of the learners at the end, leaves [jobs, ...].
      rows: of the record; the column `seed` holds numbers of jobs.
      last: the last chunk.
      varied: seeds and options by name, each [*shape].
      shape: of the whole.
      episodes: per learner.
    """
    table = records.joined(rows)
    place = tuple(table[name].to_numpy() for name in ("seed", "episode"))
    columns = {}
    for name in table.column_names:
        if name not in ("seed", "episode"):
            values = np.full((int(np.prod(shape)), episodes), np.nan)
            values[place] = table[name].to_numpy()
            columns[name] = values.reshape(*shape, episodes)
    tenth = slice(episodes - max(episodes // 10, 1), None)
    return Trained(
        success=np.nan_to_num(columns["reached"][..., tenth]).mean(axis=-1),
        steps=mean_of_known(columns["steps"][..., tenth], axis=-1),
        episodes=columns,
        diverged=last.failed.reshape(shape),
        varied=varied,
        seconds=last.seconds,
        agent=agent,
        states=states,
        hyper=hyper,
    )
