"""What an environment is: pure functions for one lane, and their sizes."""

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


class Goal(NamedTuple):
    """What hindsight needs of a world whose task is to reach a goal: pure functions, for one lane.

    A goal is an array [G] of the same quantity as what is achieved: where the tip of an arm is to be, and where it is.

    Attributes:
      size: G.
      achieved: state -> [G], what the state has achieved.
      desired: state -> [G], the goal of the episode.
      reached: (achieved [G], goal [G], params) -> [] bool, whether the one counts as the other. `step` terminates an
        episode by the same rule.
      reward: (reached [] bool, params) -> [], the extrinsic reward of a step that did or did not reach the goal. `step`
        gives the same.
      relabel: (observation [O], goal [G]) -> [O], what the observation would have been had this been the goal.
    """

    size: int
    achieved: Callable[[Any], jax.Array]
    desired: Callable[[Any], jax.Array]
    reached: Callable[[jax.Array, jax.Array, Any], jax.Array]
    reward: Callable[[jax.Array, Any], jax.Array]
    relabel: Callable[[jax.Array, jax.Array], jax.Array]

    def outcome(self, params: Any) -> Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
        """(achieved [G], goal [G]) -> (reward [], reached [] bool) of a step, in a world with these params."""

        def found(achieved: jax.Array, goal: jax.Array) -> tuple[jax.Array, jax.Array]:
            reached = self.reached(achieved, goal, params)
            return self.reward(reached, params), reached

        return found


class Environment(NamedTuple):
    """A world as pure functions of its state, its parameters and a key, for one lane.

    Equal to another and hashed by the identity of `init` and `step`, so it can be a static argument whatever its params
    are: make it once and reuse it.

    Attributes:
      init: (key, params) -> (state, observation [O]); starts an episode.
      step: (state, action [A], params) -> (state, `TimeStep`); never resets by itself. An environment with randomness
        of its own keeps a key in its state.
      observation_size: O.
      action_size: A; each entry of an action is in [-1, 1] for the learners here.
      state_size: how many of the first entries of an observation are the learner's own state: what curiosity maps.
      params: what `init` and `step` are given where nobody says otherwise; Python numbers or arrays.
      goal: the task as a goal that can be replaced; None where there is none.
    """

    init: Callable[[jax.Array, Any], tuple[Any, jax.Array]]
    step: Callable[[Any, jax.Array, Any], tuple[Any, TimeStep]]
    observation_size: int
    action_size: int
    state_size: int
    params: Any = None
    goal: Goal | None = None

    def __hash__(self) -> int:
        return hash((id(self.init), id(self.step)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Environment) and self.init is other.init and self.step is other.step

    def __ne__(self, other: object) -> bool:  # a tuple has its own
        return not self == other
