"""The reaching task with the interface of brax, so that agents written for brax train on the arms unchanged.

Its agents are those of MuJoCo Playground too. Importing this does not import brax, and all of it works without; where
brax is installed, what `Reach` makes counts as a `brax.envs.base.Env`, which some of its agents ask for. The task is
that of `reach.make`; J is the number of joints, O the entries of an observation.
"""

import importlib
import os
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.envs import own_arms, reach
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.physics import Physics
from icac_jax.envs.reach import ReachParams, ReachState


class State(struct.PyTreeNode):
    """What `brax.envs.base.State` holds, under the same names.

    Attributes:
      pipeline_state: the arm and its goal.
      obs: [O], each entry in [-1, 1].
      reward: [] float32.
      done: [] float32, 1 where the goal was reached. Time is counted by brax's `EpisodeWrapper`.
      metrics: `reached` [] float32; summed over an episode it is 1 or 0.
      info: what brax's wrappers put there.
    """

    pipeline_state: ReachState
    obs: jax.Array
    reward: jax.Array
    done: jax.Array
    metrics: dict[str, jax.Array] = struct.field(default_factory=dict)
    info: dict[str, Any] = struct.field(default_factory=dict)


class Reach:
    """An arm's reaching task for brax: the names of `brax.envs.base.Env`.

    An action is [J] in units of the largest joint change a step; larger ones are clipped. Agents of brax take
    `episode_length=env.episode_length`. brax's wrapper begins all episodes of an environment with the same start and
    goal; `num_resets_per_eval` draws new ones.
    """

    def __init__(
        self,
        arm: str | os.PathLike[str] | ArmSpec = "planar2",
        physics: Physics | None = None,
        sub_steps: int | None = None,
        task: str = "reach",
        goal_seed: int = 0,
        **numbers: Any,
    ) -> None:
        """Makes the environment.

        Args:
          arm: name of an arm, path of one's own (.toml, a folder with one, .xml, .urdf), or the arm.
          physics: "servo" or "kinematic"; None: the arm's, servo unless its file says otherwise or it has no actuators.
          sub_steps: physics steps per control step (servo); None: the arm's, or 3.
          task: name of a task, as the option `task` of `icac train`.
          goal_seed: which goal, where each seed has one for all episodes: that of this seed of a run with root seed 0.
          **numbers: numbers of the task by name, as in `reach.ReachParams` and `goals.GoalOptions`; the others are the
            task's, then the arm's, those of the preset `paper` of `icac train`.

        Raises:
          ConfigError: with one line that names the field and what is allowed.
        """
        self.arm, self.params, physics, sub_steps = own_arms.for_world(
            arm, physics, sub_steps, task, goal_seed, numbers
        )
        self._world = reach.make(self.arm, physics, sub_steps)
        self._traced: ReachParams = self.params.traced()
        try:
            importlib.import_module("brax.envs.base").Env.register(type(self))
        except ModuleNotFoundError as error:
            if error.name is None or error.name.partition(".")[0] != "brax":
                raise

    def reset(self, rng: jax.Array) -> State:
        """A random start and goal, from a key of either kind."""
        arm, observation = self._world.init(rng, self._traced)
        zero = jnp.zeros((), jnp.float32)
        return State(arm, observation, reward=zero, done=zero, metrics={"reached": zero}, info={})

    def step(self, state: State, action: jax.Array) -> State:
        """One control step; never resets by itself."""
        arm, seen = self._world.step(state.pipeline_state, jnp.clip(action, -1.0, 1.0), self._traced)
        done = seen.terminated.astype(jnp.float32)
        return state.replace(
            pipeline_state=arm,
            obs=seen.observation,
            reward=jnp.asarray(seen.reward, jnp.float32),
            done=done,
            metrics=state.metrics | {"reached": done},
        )

    @property
    def episode_length(self) -> int:
        """The horizon of the task, in control steps."""
        return int(self.params.horizon)

    @property
    def observation_size(self) -> int:
        """O."""
        return self.arm.observation_size

    @property
    def action_size(self) -> int:
        """J."""
        return self.arm.joints

    @property
    def backend(self) -> str:
        """The physics is MuJoCo MJX, kinematic or with servos."""
        return "mjx"

    @property
    def unwrapped(self) -> "Reach":
        """This."""
        return self
