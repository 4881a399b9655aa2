"""Recording demonstrations in the Gymnasium world, by whoever acts there: a person, a controller, a trained agent.

Optional extra `gymnasium`. The file is that of `icac demonstrate`; `icac train --demonstrations FILE` starts from it.
"""

import os
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np

from icac_jax.envs.demonstrator import Recorded
from icac_jax.envs.gymnasium import ReachEnv
from icac_jax.fields import ConfigError
from icac_jax.runs import demonstrations

import gymnasium  # isort: skip  (after `envs.gymnasium`, which says in one line that the extra is missing)


class DemonstrationRecorder(gymnasium.Wrapper):
    """Keeps the episodes that end in the goal zone, and writes them as a file of demonstrations.

    Observations and rewards are kept as `ReachEnv` gives them, whatever `ReachGoalEnv` or wrappers between make of
    them; actions as they were executed, clipped to [-1, 1]. An episode that is given up or runs out of time is left
    out.
    """

    def __init__(self, env: gymnasium.Env, out: str | os.PathLike[str]) -> None:
        """Wraps an environment.

        Args:
          env: one of `icac_jax.envs.gymnasium`, perhaps with wrappers around it that leave actions as they are.
          out: the Parquet file that `close` and `write` write.

        Raises:
          ConfigError: the environment is none of an arm.
        """
        super().__init__(env)
        if not isinstance(env.unwrapped, ReachEnv):
            raise ConfigError(f"env: must be one of icac_jax.envs.gymnasium, got {type(env.unwrapped).__name__}")
        self._world: ReachEnv = env.unwrapped
        self._out = Path(out).expanduser()
        self._episode: list[tuple[Any, ...]] = []
        self._kept: list[list[tuple[Any, ...]]] = []

    @property
    def episodes(self) -> int:
        """How many episodes are kept so far."""
        return len(self._kept)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begins an episode; what was done in one that had not ended is dropped."""
        result = self.env.reset(seed=seed, options=options)
        self._episode = []
        return result

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """One control step, which is kept."""
        before = ReachEnv._observation(self._world)
        result = self.env.step(action)
        terminated = result[2]
        self._episode.append(
            (
                before,
                np.clip(np.asarray(action, np.float32), -1.0, 1.0),
                np.float32(ReachEnv._reward(self._world, terminated)),
                ReachEnv._observation(self._world),
                np.bool_(terminated),
                self._world._position().astype(np.float32),
            )
        )
        if terminated:
            self._kept.append(self._episode)
        if terminated or result[3]:
            self._episode = []
        return result

    def write(self) -> Path | None:
        """Writes what is kept so far; the file's path, or None where no episode has reached its goal yet.

        Raises:
          ConfigError: the file cannot be written.
        """
        if not self._kept:
            return None
        rows = [row for episode in self._kept for row in episode]
        lengths = [len(episode) for episode in self._kept]
        columns = [np.stack(column) for column in zip(*rows, strict=True)]
        recorded = Recorded._make([*columns, np.repeat(np.arange(len(lengths), dtype=np.int32), lengths)])
        world = self._world
        facts = {"by": "DemonstrationRecorder", "physics": world.physics, "sub_steps": world.sub_steps}
        demonstrations.write(self._out, recorded, world.arm, world.params, **facts)
        return self._out

    def close(self) -> None:
        """Writes the file, then closes the environment."""
        self.write()
        super().close()
