"""Curiosity around any Gymnasium world whose observations and actions are boxes. Optional extra `gymnasium`.

The map, the predictors and the intrinsic reward (Eq. 8-10) are those of `icac_jax.curiosity`, on the host, one compiled
program per step. The learner may be anybody's: it is given extrinsic and intrinsic reward as a sum (Eq. 11).
"""

import dataclasses
from typing import Any, SupportsFloat

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax.curiosity import CuriosityHyper, CuriositySpec, signals
from icac_jax.curiosity.base import Step
from icac_jax.fields import ConfigError, close_match

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.utils import RecordConstructorArgs
except ImportError as error:
    raise ConfigError("gymnasium: needs the extra, pip install 'icac_jax[gymnasium]'") from error


class Curiosity(gymnasium.Wrapper, RecordConstructorArgs):
    """A world whose reward has the intrinsic reward of Eq. 10 added.

    Bounded observations and actions are scaled to [-1, 1] for the map and the predictors alone; what the learner sees
    and does stays as it is. `info` holds `extrinsic_reward`, `intrinsic_reward` (its weight applied) and, for signals
    with a map, `live_nodes` and `overflow`. What was learnt outlives `reset`.

    Hindsight (HER) computes rewards anew, without curiosity: use a replay buffer without it.
    """

    def __init__(self, env: gymnasium.Env, state_size: int | None = None, seed: int = 0, **options: Any) -> None:
        """Puts curiosity around a world.

        Args:
          env: with a box [O], or a dictionary with a box `observation`, as observations, and a box [A] of actions.
          state_size: D, how many of the first entries of an observation are the learner's own state, which is mapped;
            all by default.
          seed: randomness of first nodes and predictors.
          **options: static choices and numbers of curiosity by name, see `CuriositySpec` and `CuriosityHyper`, such as
            `curiosity` (the weight), `signal` and `e_max`.

        Raises:
          ConfigError: with one line that names the option and what is allowed.
        """
        RecordConstructorArgs.__init__(self, state_size=state_size, seed=seed, **options)
        gymnasium.Wrapper.__init__(self, env)
        box = env.observation_space
        self._inside = "observation" if isinstance(box, spaces.Dict) else None
        box = box.spaces.get("observation") if isinstance(box, spaces.Dict) else box
        if not isinstance(box, spaces.Box) or not isinstance(env.action_space, spaces.Box):
            raise ConfigError("env: must have boxes as observations and actions")
        self._seen, self._done = _scale(box), _scale(env.action_space)
        size = len(self._seen[0])
        sizes = {"observation_size": size, "state_size": size if state_size is None else state_size}
        sizes["action_size"] = len(self._done[0])
        static, traced = ({field.name for field in dataclasses.fields(one)} for one in (CuriositySpec, CuriosityHyper))
        known = [name for name in (*static, *traced) if name not in sizes]
        for name in options:
            if name not in known:
                raise ConfigError(f"{name}: no option of curiosity{close_match(name, known)}")
        choices: dict[str, Any] = {name: options[name] for name in options if name in static}
        choices |= sizes
        spec = CuriositySpec(**choices)
        hyper = CuriosityHyper(**{name: options[name] for name in options if name in traced})
        hyper.check_window(spec)
        signal, self._weight, numbers = signals.build(spec), vars(hyper)["curiosity"], hyper.traced()
        self._size = spec.map_size

        def step(state: Any, key: jax.Array, number: jax.Array, seen: Step) -> tuple[Any, jax.Array, dict]:
            state, paid = signal.update(state, seen, jax.random.fold_in(key, number), numbers, True)
            return state, paid.bonus, signal.counts(state)

        self._step = jax.jit(step)
        start, self._key = jax.random.split(jax.random.key(seed))
        self.state = jax.jit(lambda key: signal.init(key, numbers))(start)
        self._steps, self._before = 0, np.zeros(self._size, np.float32)

    def _sensed(self, observation: Any) -> np.ndarray:
        """[D] what is mapped of an observation."""
        inside = observation if self._inside is None else observation[self._inside]
        return _scaled(inside, self._seen)[: self._size]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """A new episode; map and predictors are kept."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._before = self._sensed(observation)
        return observation, info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """A step whose reward is the world's and the intrinsic one together."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        sensed = self._sensed(observation)
        seen = Step(*map(jnp.asarray, (self._before, np.clip(_scaled(action, self._done), -1, 1), sensed)))
        self.state, bonus, counts = self._step(self.state, self._key, jnp.int32(self._steps), seen)
        self._steps, self._before = self._steps + 1, sensed
        intrinsic = self._weight * float(bonus)
        told = {"extrinsic_reward": float(reward), "intrinsic_reward": intrinsic}
        told |= {name: int(count) for name, count in counts.items()}
        return observation, float(reward) + intrinsic, terminated, truncated, info | told


def _scale(box: spaces.Box) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half range of a box, flat; 0 and 1 where it has no bounds."""
    low, high = (np.asarray(end, np.float64).ravel() for end in (box.low, box.high))
    known = np.isfinite(low) & np.isfinite(high) & (low < high)
    low, high = np.where(known, low, -1.0), np.where(known, high, 1.0)
    return (low + high) / 2, (high - low) / 2


def _scaled(values: Any, scale: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return ((np.asarray(values, np.float64).ravel() - scale[0]) / scale[1]).astype(np.float32)
