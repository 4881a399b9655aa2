"""The best policies of a run, `best.npz`: of each seed what acts, as it was at the seed's best evaluation. S seeds."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax.errors import DamagedError
from icac_jax.fields import ConfigError
from icac_jax.runs import build, checkpoints, files
from icac_jax.settings.options import Settings

FILE = "best.npz"

NEWEST, BEST = "newest", "best"
POLICIES = (NEWEST, BEST)
"""Which policies of a run are taken: those of its newest checkpoint, or each seed's best by --evaluate-every."""

_PART = "agent."  # before the names of arrays of the learner, in the file


class Best(NamedTuple):
    """What is kept.

    Attributes:
      success_rate: [S] float64 of the best evaluation, -1 where a seed has had none.
      steps: [S] float64 mean steps there; a failure counts as the horizon.
      episode: [S] int64 episodes that the seed had finished then.
      parts: by name, arrays [S, ...] of the learners that their actions without exploration depend on.
    """

    success_rate: np.ndarray
    steps: np.ndarray
    episode: np.ndarray
    parts: dict[str, np.ndarray]

    @property
    def known(self) -> np.ndarray:
        """[S] bool, whether the seed has been evaluated."""
        return self.success_rate >= 0


def acting(settings: Settings, states: Any) -> dict[str, np.ndarray]:
    """The arrays of learners that their actions without exploration depend on: a network, and no replay buffer.

    Args:
      settings: of the run.
      states: of the learners, leaves [S, ...].
    """
    agent, hyper = build.agent(settings), settings.hyper.traced()
    one = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), states)
    observation = jax.ShapeDtypeStruct((build.environment(settings).observation_size,), jnp.float32)
    program = jax.make_jaxpr(lambda state, seen: agent.greedy(state, seen, hyper))(one, observation).jaxpr
    read = {id(variable) for equation in program.eqns for variable in equation.invars}
    # The program's first arguments are the leaves of the state, in their order.
    used = zip(checkpoints.named_leaves(states).items(), program.invars, strict=False)
    return {name: np.asarray(leaf) for (name, leaf), variable in used if id(variable) in read}


def better(best: Best | None, success_rate: np.ndarray, steps: np.ndarray, episode: np.ndarray, parts: dict) -> Best:
    """The best of what is kept and of an evaluation: more success, among equals fewer steps, else the earlier one.

    Args:
      best: what is kept, None at first.
      success_rate: [S] of the evaluation, NaN for a seed that has none.
      steps: [S] mean steps.
      episode: [S] episodes finished.
      parts: see `acting`.
    """
    if best is None:
        nothing = np.full(len(episode), -1)
        best = Best(nothing.astype(float), nothing.astype(float), nothing, parts)
    more = success_rate > best.success_rate
    more |= (success_rate == best.success_rate) & (steps < best.steps)

    def chosen(new: np.ndarray, old: np.ndarray) -> np.ndarray:
        return np.where(more.reshape(-1, *[1] * (new.ndim - 1)), new, old)

    return Best(
        *(chosen(new, old) for new, old in zip((success_rate, steps, episode), best[:3], strict=True)),
        parts={name: chosen(new, best.parts[name]) for name, new in parts.items()},
    )


def save(folder: Path, best: Best) -> None:
    """Writes them into the folder of a run.

    Raises:
      OSError: the folder cannot be written; what was there still is.
    """
    parts = {_PART + name: part for name, part in best.parts.items()}
    numbers = {"success_rate": best.success_rate, "steps": best.steps, "episode": best.episode}
    with files.replacing(folder / FILE) as file:
        np.savez(file, **parts, **numbers)  # pyright: ignore[reportArgumentType]  (names are array names)


def read(folder: Path, settings: Settings, states: Any) -> Best | None:
    """What is kept in the folder of a run, None where nothing is.

    Args:
      folder: of the run.
      settings: of the run.
      states: learners of the run, leaves [S, ...].

    Raises:
      DamagedError: the file is cut short, altered, or of another run.
    """
    path = folder / FILE
    if not path.exists():
        return None
    wanted = acting(settings, states)
    with checkpoints.damage(path), checkpoints.opened(path) as stored:
        parts = {name.removeprefix(_PART): stored[name] for name in stored.files if name.startswith(_PART)}
        numbers = [stored[name] for name in ("success_rate", "steps", "episode")]
    shapes = {name: (part.shape, part.dtype) for name, part in wanted.items()}
    alike = shapes == {name: (part.shape, part.dtype) for name, part in parts.items()}
    seeds = (settings.run.seeds,)
    if not alike or any(kept.shape != seeds or kept.dtype.kind not in "fi" for kept in numbers):
        raise DamagedError(f"{path}: not the best policies of this run (other arrays than expected)")
    return Best(*numbers, parts=parts)


def states_with(folder: Path, settings: Settings, states: Any) -> tuple[Any, np.ndarray]:
    """Learners that act as each seed did at its best, and how many episodes each had finished then.

    Args:
      folder: of the run.
      settings: of the run.
      states: learners of the run, leaves [S, ...], for all that is not kept.

    Raises:
      ConfigError: nothing is kept, or not of every seed.
      DamagedError: the file cannot be read.
    """
    best = read(folder, settings, states)
    if best is None or not best.known.all():
        raise ConfigError(
            f"policy: {BEST} needs an evaluation of every seed (icac train --evaluate-every N), {folder} has none; "
            f"{NEWEST} does not"
        )
    leaves = [best.parts.get(name, leaf) for name, leaf in checkpoints.named_leaves(states).items()]
    return jax.tree.unflatten(jax.tree.structure(states), leaves), best.episode
