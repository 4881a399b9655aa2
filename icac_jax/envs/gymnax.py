"""The reaching task with the interface of gymnax, so that agents written for gymnax train on the arms unchanged.

Optional extra `gymnax`. The task is that of `reach.make`; J is the number of joints, O the entries of an observation.
As gymnax has it, `reset(key, params)` gives (observation, state) and `step(key, state, action, params)` begins the next
episode by itself. gymnax 0.0.x returns (observation, state, reward, done, info), gymnax 1.x returns `terminated` and
`truncated` in place of `done`; this adapter serves both.
"""

import os
from typing import Any

import jax
import jax.numpy as jnp

from icac_jax.envs import own_arms, reach
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.physics import Physics, tip_function
from icac_jax.envs.reach import ReachParams, ReachState
from icac_jax.fields import ConfigError

try:
    from gymnax.environments import environment, spaces
except ImportError as error:
    raise ConfigError("gymnax: needs the extra, pip install 'icac_jax[gymnax]'") from error

# gymnax 1.x asks the environment for truncation; before, one `done` said that the episode is over for any reason.
_SPLIT = hasattr(environment.Environment, "is_truncated")


class EnvState(ReachState):
    """`reach.ReachState` with the name that gymnax has for the steps since the episode began."""

    @property
    def time(self) -> jax.Array:
        """[] int32, steps since the episode began."""
        return self.steps


class EnvParams(ReachParams):
    """`reach.ReachParams` with the name that gymnax has for the horizon."""

    @property
    def max_steps_in_episode(self) -> Any:
        """[] int32, the horizon; `replace(horizon=...)` changes it."""
        return self.horizon


class Reach(environment.Environment):
    """An arm's reaching task for gymnax.

    An action is [J] in units of the largest joint change a step; larger ones are clipped. `info` holds `terminated`
    (the goal was reached), `truncated` (time was up), `final_observation` [O] (before a reset) and `discount` (0 where
    the episode ended as the installed gymnax counts it, else 1).
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
        super().__init__()
        self.arm, self._params, physics, sub_steps = own_arms.for_world(
            arm, physics, sub_steps, task, goal_seed, numbers
        )
        self._world = reach.make(self.arm, physics, sub_steps)
        self._tip = tip_function(self.arm)

    @property
    def name(self) -> str:
        """Such as Planar2Reach-v0."""
        return f"{self.arm.name.capitalize()}Reach-v0"

    @property
    def default_params(self) -> EnvParams:  # pyright: ignore[reportIncompatibleMethodOverride]  (fields of its own)
        """The numbers of the task as arrays; `replace` changes some, joint limits in degrees."""
        return EnvParams(**vars(self._params.traced()))

    @property
    def num_actions(self) -> int:
        """J."""
        return self.arm.joints

    def reset_env(self, key: jax.Array, params: Any) -> tuple[jax.Array, EnvState]:
        """A random start and goal: observation [O] and state."""
        state, observation = self._world.init(key, params.traced())
        return observation, EnvState(**vars(state))

    def step_env(
        self, key: jax.Array, state: Any, action: Any, params: Any
    ) -> tuple[jax.Array, EnvState, jax.Array, jax.Array, dict[str, jax.Array]]:
        """One control step without a reset: observation [O], state, reward, end, info; `key` is not used.

        The end is that of the episode with gymnax 0.0.x, and whether it is terminated with gymnax 1.x.
        """
        state, seen = self._world.step(state, jnp.clip(action, -1.0, 1.0), params.traced())
        end = seen.terminated if _SPLIT else seen.terminated | seen.truncated
        info = {
            "discount": (~end).astype(jnp.float32),
            "terminated": seen.terminated,
            "truncated": seen.truncated,
            "final_observation": seen.observation,
        }
        return seen.observation, state, seen.reward, end, info

    def get_obs(  # pyright: ignore[reportIncompatibleMethodOverride]  (gymnax's own declarations disagree)
        self, state: Any, params: Any = None, key: Any = None
    ) -> jax.Array:
        """The observation [O] of a state."""
        return reach.observe(self.arm, state, (self.default_params if params is None else params).traced())

    def is_terminated(self, state: Any, params: Any) -> jax.Array:
        """Whether the tip is in the goal zone."""
        return jnp.linalg.norm(self._tip(state.joints) - state.goal) <= params.goal_radius

    def is_truncated(self, state: Any, params: Any) -> jax.Array:
        """Whether time is up, and the tip is not in the goal zone."""
        return (state.steps >= params.horizon) & ~self.is_terminated(state, params)

    def is_terminal(self, state: Any, params: Any) -> jax.Array:
        """Whether the episode is over (gymnax 0.0.x), or whether it is terminated (gymnax 1.x)."""
        terminated = self.is_terminated(state, params)
        return terminated if _SPLIT else terminated | (state.steps >= params.horizon)

    def action_space(self, params: Any = None) -> spaces.Box:
        """[-1, 1] for each joint."""
        return spaces.Box(-1.0, 1.0, (self.arm.joints,), jnp.float32)

    def observation_space(self, params: Any = None) -> spaces.Box:
        """The bounds of `reach.observation_bounds`."""
        low, high = (jnp.asarray(bound, jnp.float32) for bound in reach.observation_bounds(self.arm))
        return spaces.Box(low, high, (self.arm.observation_size,), jnp.float32)


def make(
    arm: str | os.PathLike[str] | ArmSpec = "planar2",
    physics: Physics | None = None,
    sub_steps: int | None = None,
    task: str = "reach",
    goal_seed: int = 0,
    **numbers: Any,
) -> tuple[Reach, EnvParams]:
    """An environment and its parameters, as `gymnax.make` gives them.

    Args:
      arm: as in `Reach`.
      physics: as in `Reach`.
      sub_steps: as in `Reach`.
      task: as in `Reach`.
      goal_seed: as in `Reach`.
      **numbers: as in `Reach`.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    env = Reach(arm, physics, sub_steps, task, goal_seed, **numbers)
    return env, env.default_params
