"""The reaching task for Gymnasium, one arm on C MuJoCo. Optional extra `gymnasium`.

Importing this module registers, for each arm of `arms.ARMS`, `icac_jax/Planar2Reach-v0` (observations as on MJX) and
`icac_jax/Planar2ReachGoal-v0` (dict observations for goal-conditioned agents); the task is that of `reach`, whose
numbers are keywords of `gymnasium.make`. `gymnasium.make("icac_jax.envs.gymnasium:icac_jax/Planar2Reach-v0")` needs no
import. J is the number of joints, G the number of goal coordinates in an observation, O = J + G.
"""

import os
import time
import weakref
from collections.abc import Mapping
from typing import Any, ClassVar, SupportsFloat

import numpy as np

from icac_jax.console import shown
from icac_jax.envs import arms, own_arms, pictures, reach, walls
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.model import load_model, tip_bounds
from icac_jax.envs.physics import Physics
from icac_jax.fields import ConfigError

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as error:
    raise ConfigError("gymnasium: needs the extra, pip install 'icac_jax[gymnasium]'") from error

import mujoco  # after `model`, which says in one line what is missing where OpenGL is

# Positions and angles in float32, as MJX has them, are let through; in m and rad.
_SLACK = 1e-6


class ReachEnv(gymnasium.Env):
    """The task of `reach.make` in float64: the same model, servo, limits, observation, reward and end of an episode.

    An episode is terminated in the goal zone and truncated by the environment itself at the horizon. An action is [J]
    in units of the largest joint change a step; larger ones are clipped. `info` holds `is_success` (the tip is in the
    goal zone), `distance` (of the tip to the goal, in m) and `steps` (since the episode began).
    """

    # Seven pictures a second: a control step is 0.15 s. No ClassVar, for gymnasium.Env has none.
    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["human", "rgb_array"], "render_fps": 7}  # pyright: ignore

    def __init__(
        self,
        arm: str | os.PathLike[str] | ArmSpec = "planar2",
        physics: Physics | None = None,
        sub_steps: int | None = None,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        task: str = "reach",
        goal_seed: int = 0,
        **numbers: Any,
    ) -> None:
        """Makes the environment; `reset` begins the first episode.

        Args:
          arm: name of an arm, path of one's own (.toml, a folder with one, .xml, .urdf), or the arm.
          physics: "servo" or "kinematic"; None: the arm's, servo unless its file says otherwise or it has no actuators.
          sub_steps: physics steps per control step (servo); None: the arm's, or 3.
          render_mode: "rgb_array", "human" (a window from the first reset on, needs a display) or None.
          width: of a picture, in pixels.
          height: of a picture, in pixels.
          task: name of a task, as the option `task` of `icac train`.
          goal_seed: which goal, where each seed has one for all episodes: that of this seed of a run with root seed 0.
          **numbers: numbers of the task by name, as in `reach.ReachParams` and `goals.GoalOptions`; the others are the
            task's, then the arm's, those of the preset `paper` of `icac train`.

        Raises:
          ConfigError: with one line that names the field and what is allowed.
        """
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(f"render_mode: must be one of human, rgb_array or None, got {render_mode!r}")
        self.arm, self.params, self.physics, self.sub_steps = own_arms.for_world(
            arm, physics, sub_steps, task, goal_seed, numbers
        )
        self.render_mode = render_mode
        self.model = load_model(self.arm, lit=True)
        self.data = mujoco.MjData(self.model)  # pyright: ignore[reportAttributeAccessIssue]
        self._tip = self.model.site(self.arm.tip).id
        self._low, self._high = np.radians(self.params.joint_low), np.radians(self.params.joint_high)
        self._walls = walls.in_rad(self.params.walls, self.arm.joints)
        self._joints, self._velocity, self._goal = np.zeros(self.arm.joints), np.zeros(self.arm.joints), np.zeros(3)
        self._steps = 0
        self.action_space = spaces.Box(-1.0, 1.0, (self.arm.joints,), np.float32)
        self.observation_space = self._make_observation_space()
        pictures.check_size(self.model, width, height)
        # Opened by the first picture: who draws nothing needs no OpenGL, and what else uses it may be loaded first.
        self._size = (width, height)
        self._screen: Any = None
        self._close: Any = None

    def _make_observation_space(self) -> spaces.Space:
        low, high = (bound.astype(np.float32) for bound in reach.observation_bounds(self.arm))
        return spaces.Box(low, high, dtype=np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begins an episode at a random configuration, with the tip's place at another one as the goal.

        Args:
          seed: of the random numbers; the same seed gives the same start and goal.
          options: `joints` [J] in rad, within the joint limits and outside the walls, and `goal` [3] in m, within the
            arm's reach, replace what was drawn.

        Raises:
          ConfigError: an option that does not exist, or a value that is not allowed; the episode goes on as it was.
        """
        given = _given({} if options is None else options, {"joints": self.arm.joints, "goal": 3})
        reach_of = tip_bounds(self.arm)
        for name, value, (least, most) in (
            ("joints", given.get("joints"), (self._low, self._high)),
            ("goal", given.get("goal"), reach_of),
        ):
            if value is not None and (np.any(value < least - _SLACK) or np.any(value > most + _SLACK)):
                limits, unit = ("the joint limits", "rad") if name == "joints" else ("the arm's reach", "m")
                raise ConfigError(
                    f"{name}: must be within {limits}, {_numbers(least)} to {_numbers(most)} {unit}, in the options of "
                    f"reset, got {_numbers(value)}"
                )
        if "joints" in given and len(self._walls) and walls.within(given["joints"], self._walls):
            raise ConfigError(
                f"joints: must be outside the walls, in the options of reset, got {_numbers(given['joints'])}"
            )
        super().reset(seed=seed)
        start, goal_joints = reach.placed(self.params, self.np_random.uniform(-0.5, 0.5, (2, self.arm.joints)))
        drawn = {"joints": start, "goal": self._tip_at(goal_joints)}
        begin = drawn | given
        self._joints = np.clip(begin["joints"], self._low, self._high)
        self._goal = np.clip(begin["goal"], *reach_of)
        self._velocity, self._steps = np.zeros(self.arm.joints), 0
        self._tip_at(self._joints)
        self._show()
        return self._observation(), self._info()

    def step(self, action: np.ndarray) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Moves the arm by one control step.

        Args:
          action: [J] joint changes in units of the largest change a step, clipped to [-1, 1].

        Raises:
          ValueError: the action is not J finite numbers.
        """
        action = np.asarray(action, float)
        if action.shape != (self.arm.joints,) or not np.all(np.isfinite(action)):
            raise ValueError(f"action: must be {self.arm.joints} finite numbers, got {action.tolist()}")
        change = np.radians(self.params.action_bound) * np.clip(action, -1.0, 1.0)
        before = self._joints
        target = np.clip(before + change, self._low, self._high)
        self._move(target)
        if len(self._walls) and walls.blocked(before, self._joints, self._walls):
            self._joints, self._velocity = before, np.zeros_like(before)
        self._steps += 1
        self._tip_at(self._joints)
        terminated = bool(self._within(self._position(), self._goal))
        truncated = not terminated and self._steps >= self.params.horizon
        self._show()
        return self._observation(), self._reward(terminated), terminated, truncated, self._info()

    def _move(self, target: np.ndarray) -> None:
        """One control step of `reach.make`, from the current joints and velocities."""
        if self.physics == "kinematic":
            self._joints = target
            return
        self.data.qpos[:], self.data.qvel[:], self.data.ctrl[:] = self._joints, self._velocity, target
        mujoco.mj_step(self.model, self.data, self.sub_steps)  # pyright: ignore[reportAttributeAccessIssue]
        moved = np.array(self.data.qpos)
        self._joints = np.clip(moved, self._low, self._high)
        self._velocity = np.where(self._joints == moved, self.data.qvel, 0.0)

    def _tip_at(self, joints: np.ndarray) -> np.ndarray:
        """Puts the joints [J] where told, at rest for a picture; the tip's position [3] in m."""
        self.data.qpos[:], self.data.qvel[:] = joints, 0.0
        mujoco.mj_kinematics(self.model, self.data)  # pyright: ignore[reportAttributeAccessIssue]
        return self._position()

    def _position(self) -> np.ndarray:
        return np.array(self.data.site_xpos[self._tip])

    def _within(self, achieved: Any, desired: Any) -> np.ndarray:
        """Whether positions [..., 3] in m are in the goal zones about others; in float32, as observations hold them."""
        achieved, desired = np.asarray(achieved, np.float32), np.asarray(desired, np.float32)
        return np.sqrt(np.sum(np.square(achieved - desired), axis=-1)) <= self.params.goal_radius

    def _observation(self) -> Any:
        low, high = np.array(self.arm.goal_low), np.array(self.arm.goal_high)
        goal = 2 * (self._goal[list(self.arm.goal_axes)] - low) / (high - low) - 1
        return np.concatenate([self._scaled_joints(), goal]).astype(np.float32)

    def _scaled_joints(self) -> np.ndarray:
        return 2 * (self._joints - self._low) / (self._high - self._low) - 1

    def _reward(self, terminated: bool) -> float:
        return float(self.params.goal_reward if terminated else -self.params.step_cost)

    def _info(self) -> dict[str, Any]:
        tip = self._position()
        return {
            "is_success": bool(self._within(tip, self._goal)),
            "distance": float(np.linalg.norm(tip - self._goal)),
            "steps": self._steps,
        }

    def _draw(self) -> None:
        """Brings everything that a picture shows up to date."""
        goal = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, "goal")  # pyright: ignore
        if goal >= 0:
            self.model.site_pos[goal], self.model.site_size[goal, 0] = self._goal, self.params.goal_radius
        mujoco.mj_forward(self.model, self.data)  # pyright: ignore[reportAttributeAccessIssue]

    def _open(self) -> Any:
        """What this render mode draws on; closed at the latest when the interpreter ends."""
        if self._screen is None:
            if self.render_mode == "human":
                self._screen = pictures.open_viewer(self.model, self.data)
            else:
                self._screen = pictures.Renderer(self.model, *self._size)
            self._close = weakref.finalize(self, self._screen.close)
        return self._screen

    def _show(self) -> None:
        """Human mode: the window follows the arm at the pace of the arm."""
        if self.render_mode == "human" and (window := self._open()).is_running():
            with window.lock():
                self._draw()
            window.sync()
            time.sleep(1 / self.metadata["render_fps"])

    def render(self) -> np.ndarray | None:
        """The picture [height, width, 3] of bytes in mode "rgb_array"; the other modes have nothing to return.

        Raises:
          ConfigError: the machine has no OpenGL.
        """
        if self.render_mode != "rgb_array":
            return None
        self._draw()
        screen = self._open()
        screen.update(self.data, pictures.camera(self.model))
        return screen.picture()

    def close(self) -> None:
        """Closes the window or frees the renderer."""
        if self._close is not None:
            self._close()
        self._screen, self._close = None, None


class ReachGoalEnv(ReachEnv):
    """The task for goal-conditioned agents, such as hindsight experience replay: observations are dicts.

    `observation` [J] are the joints scaled to [-1, 1], `achieved_goal` [3] and `desired_goal` [3] the positions of the
    tip and of the goal in m. The reward is 0 in the goal zone and -1 elsewhere, as in the goal-conditioned tasks of
    Gymnasium-Robotics; everything else is as in `ReachEnv`.
    """

    def __init__(self, arm: str | os.PathLike[str] | ArmSpec = "planar2", **options: Any) -> None:
        """Makes the environment.

        Args:
          arm: as in `ReachEnv`.
          **options: those of `ReachEnv` but `goal_reward` and `step_cost`.

        Raises:
          ConfigError: with one line that names the field and what is allowed.
        """
        for name in ("goal_reward", "step_cost"):
            if name in options:
                raise ConfigError(f"{name}: not used here, the reward is 0 in the goal zone and -1 elsewhere")
        super().__init__(arm, **options)

    def _make_observation_space(self) -> spaces.Space:
        low, high = (bound.astype(np.float32) for bound in tip_bounds(self.arm))
        # Each entry its own object: some agents change the space of one.
        return spaces.Dict(
            {
                "observation": spaces.Box(-1.0, 1.0, (self.arm.joints,), np.float32),
                "achieved_goal": spaces.Box(low, high, dtype=np.float32),
                "desired_goal": spaces.Box(low, high, dtype=np.float32),
            }
        )

    def _observation(self) -> Any:
        return {
            "observation": self._scaled_joints().astype(np.float32),
            "achieved_goal": self._position().astype(np.float32),
            "desired_goal": self._goal.astype(np.float32),
        }

    def _reward(self, terminated: bool) -> float:
        return 0.0 if terminated else -1.0

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any = None) -> Any:
        """The reward that goals would have had: a number, or an array [...] for batches of goals [..., 3].

        Args:
          achieved_goal: [..., 3] positions of the tip, in m.
          desired_goal: [..., 3] positions of the goal, in m.
          info: not used; goal-conditioned agents pass the step's info, or an array of them.
        """
        reward = np.where(self._within(achieved_goal, desired_goal), 0.0, -1.0)
        return float(reward) if reward.ndim == 0 else reward.astype(np.float32)

    def compute_terminated(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any = None) -> Any:
        """Whether the episode would have been terminated: a bool, or an array [...] for batches of goals [..., 3].

        Args:
          achieved_goal: [..., 3] positions of the tip, in m.
          desired_goal: [..., 3] positions of the goal, in m.
          info: not used.
        """
        within = self._within(achieved_goal, desired_goal)
        return bool(within) if within.ndim == 0 else within


def _numbers(values: np.ndarray) -> str:
    return f"[{', '.join(f'{value:.4g}' for value in values)}]"


def _given(options: Any, sizes: dict[str, int]) -> dict[str, np.ndarray]:
    """The options of a reset as float arrays of the given sizes."""
    if not isinstance(options, Mapping):
        raise ConfigError(f"options: must be a dict with some of {', '.join(sizes)}, got {shown(repr(options))}")
    found = {}
    for name, value in options.items():
        if name not in sizes:
            raise ConfigError(f"{shown(name)}: no such option of reset; there are {', '.join(sizes)}")
        try:
            found[name] = np.array(value, float)
        except (TypeError, ValueError, OverflowError):
            found[name] = np.empty(0)
        if found[name].shape != (sizes[name],) or not np.all(np.isfinite(found[name])):
            got = " ".join(repr(value).split())
            raise ConfigError(f"{name}: must be {sizes[name]} finite numbers in the options of reset, got {shown(got)}")
    return found


for _name in arms.ARMS:
    for _variant, _class in (("Reach", ReachEnv), ("ReachGoal", ReachGoalEnv)):
        gymnasium.register(
            id=f"icac_jax/{_name.capitalize()}{_variant}-v0",
            entry_point=f"{__name__}:{_class.__name__}",
            kwargs={"arm": _name},
        )
