"""How much of the state space a learner has visited: a wrapper that counts cells of a grid, around any agent."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.agents import imitation
from icac_jax.agents.base import Agent, Report, Transition
from icac_jax.fields import ConfigError

# Of a grid: a byte per cell and lane.
MOST_CELLS = 100_000


class CountedState(struct.PyTreeNode):
    """What the agent remembers, and where the lane has been.

    Attributes:
      agent: state of the agent inside.
      visited: [bins ** D] bool, whether a step of the lane has led to the cell; the last dimension runs fastest.
      cells: [] int32, how many of them; kept, for a sum over the grid would cost each step more the finer it is.
    """

    agent: Any
    visited: jax.Array
    cells: jax.Array


def cell(state: jax.Array, bins: int) -> jax.Array:
    """Number [] of the cell that a state [D] in [-1, 1] lies in, of a grid with so many bins per dimension."""
    places = jnp.clip(jnp.floor((state + 1.0) / 2.0 * bins).astype(jnp.int32), 0, bins - 1)
    weights = jnp.array([bins**power for power in reversed(range(state.shape[0]))], jnp.int32)
    return jnp.sum(places * weights)


def check(bins: int, size: int) -> None:
    """Checks that a grid is not too large.

    Args:
      bins: of the grid, per dimension.
      size: D, its dimensions.

    Raises:
      ConfigError: it has too many cells.
    """
    if bins**size > MOST_CELLS:
        most = int(MOST_CELLS ** (1 / size) + 1e-9)
        raise ConfigError(f"coverage_bins: must be at most {most} for a state of {size} entries, got {bins}")


@functools.cache
def counted(agent: Agent, bins: int, size: int) -> Agent:
    """The agent, with the column `cells_visited`: cells of its state space that the lane's steps have led to so far.

    Args:
      agent: any agent.
      bins: of the grid, per dimension; at least 1.
      size: D, how many of the first entries of an observation are the state.

    Raises:
      ConfigError: the grid has too many cells.
    """
    check(bins, size)

    def update(
        state: CountedState, transition: Transition, key: jax.Array, hyper: Any, enabled: jax.typing.ArrayLike
    ) -> tuple[CountedState, Report]:
        here = cell(transition.next_observation[:size], bins)
        cells = state.cells + (jnp.asarray(enabled) & ~state.visited[here])
        visited = state.visited.at[jnp.where(enabled, here, bins**size)].set(True, mode="drop")
        learned, report = agent.update(state.agent, transition, key, hyper, enabled)
        return CountedState(learned, visited, cells), report._replace(last=report.last | {"cells_visited": cells})

    layers = agent.layers
    return agent._replace(
        init=lambda key, hyper: CountedState(
            agent.init(key, hyper), jnp.zeros(bins**size, bool), jnp.zeros((), jnp.int32)
        ),
        act=lambda state, observation, key, hyper: agent.act(state.agent, observation, key, hyper),
        update=update,
        greedy=lambda state, observation, hyper: agent.greedy(state.agent, observation, hyper),
        layers=None if layers is None else lambda state: layers(state.agent),
        imitate=imitation.inside(agent.imitate),
        slots=agent.slots and agent.slots.inside("agent"),
    )
