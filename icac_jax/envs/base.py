"""What an environment is: two pure functions for one lane."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax


class TimeStep(NamedTuple):
    """What one step gives back.

    Attributes:
      observation: [O] the observation after the step, before any reset; each entry in [-1, 1].
      reward: [] extrinsic reward.
      terminated: [] bool, the episode ended because the goal was reached.
      truncated: [] bool, the episode ended because time was up.
    """

    observation: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array


class Environment(NamedTuple):
    """A world as two pure functions of its state, its parameters and a key.

    Hashable by the identity of the functions, so it can be a static argument: make it once and reuse it.

    Attributes:
      init: (key, params) -> (state, observation [O]); starts an episode.
      step: (state, action [A], params) -> (state, `TimeStep`); never resets by itself. An environment with randomness
        of its own keeps a key in its state.
    """

    init: Callable[[jax.Array, Any], tuple[Any, jax.Array]]
    step: Callable[[Any, jax.Array, Any], tuple[Any, TimeStep]]
