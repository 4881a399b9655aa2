"""Trained policies that come with the package, a folder each: what acts, configuration, evaluation, card.

`icac render --policy best-planar2` needs no run. A policy is the arrays of a learner that its actions without
exploration depend on, as `runs.best_policies` keeps them: a network, and no replay buffer.
"""

import shutil
import textwrap
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

from icac_jax.envs import assets
from icac_jax.fields import ConfigError
from icac_jax.policies import SHIPPED, card, evaluate, saved
from icac_jax.policies.saved import Learner
from icac_jax.runs import best_policies, build, checkpoints
from icac_jax.runs import folder as run_folder

_ACTING = "acting.npz"
_SEED, _EPISODES = "seed", "episodes"


def folder_of(name: str) -> Path:
    """The folder of a policy of the package."""
    return assets.path(f"policies/{name}/{run_folder.CONFIG}").parent


def load(name: str) -> Learner:
    """The learner of a policy of the package; what it does not need for acting is zero.

    Args:
      name: one of `policies.SHIPPED`.

    Raises:
      DamagedError: the file was altered.
    """
    place = folder_of(name)
    settings = run_folder.load(place)
    agent, hyper = build.agent(settings), settings.hyper.traced()
    shapes = jax.eval_shape(lambda: agent.init(jax.random.key(0), hyper))
    state = jax.tree.map(lambda leaf: np.zeros((1, *leaf.shape), leaf.dtype), shapes)
    path = place / _ACTING
    with checkpoints.damage(path), checkpoints.opened(path) as stored:
        parts = {name: stored[name] for name in best_policies.acting(settings, state)}
        seed, episodes = int(stored[_SEED]), int(stored[_EPISODES])
    leaves = [parts.get(name, leaf[0]) for name, leaf in checkpoints.named_leaves(state).items()]
    return Learner(settings, seed, jax.tree.unflatten(jax.tree.structure(state), leaves), episodes)


def chosen(run: Path | None, seed: str, policy: str, warn: Callable[[str], None]) -> Learner:
    """Whose policy a command is about: a seed's of a run, or one of the package.

    Args:
      run: folder of a run, None for a policy of the package.
      seed: see `saved.pick`.
      policy: see `saved.pick`, or one of `policies.SHIPPED`.
      warn: told of checkpoints that cannot be read.

    Raises:
      ConfigError: there is no such policy, or a run is given for one of the package or missing for another.
      DamagedError: nothing of it can be read.
    """
    check(run, policy)
    return load(policy) if run is None else saved.pick(run, seed, warn, policy)


def check(run: Path | None, policy: str) -> None:
    """Refuses a run with a policy of the package, and no run with any other.

    Raises:
      ConfigError: one line that says which.
    """
    if run is None and policy not in SHIPPED:
        raise ConfigError(f"policy: must be one of {', '.join(SHIPPED)} without a run, got {policy!r}")
    if run is not None and policy in SHIPPED:
        raise ConfigError(f"run: must be left out with policy {policy}, which comes with the package")


def pack(run: Path, out: Path, seed: str = saved.BEST) -> None:
    """Makes a folder such as the package has of an evaluated run.

    Args:
      run: its folder; its `evaluation.json` must be of its newest policies.
      out: a new folder.
      seed: see `saved.pick`.

    Raises:
      ConfigError: there is no such run or seed.
      DamagedError: nothing of it can be read.
    """
    learner = saved.pick(run, seed)
    out.mkdir(parents=True)
    shutil.copy(run / run_folder.CONFIG, out)
    one = jax.tree.map(lambda leaf: np.asarray(leaf)[None], learner.agent)
    parts = {name: part[0] for name, part in best_policies.acting(learner.settings, one).items()}
    np.savez(out / _ACTING, **parts, **{_SEED: learner.seed, _EPISODES: learner.episodes})  # pyright: ignore
    (out / card.CARD).write_text(_card(out.name, run, learner))


def _card(name: str, run: Path, learner: Learner) -> str:
    """What a policy of the package is, how it was trained and how far it was tried, as Markdown."""
    settings, summary = learner.settings, run_folder.read_json(run / run_folder.SUMMARY)
    options, params = settings.run, settings.params
    task = (
        f"{options.arm}, task {options.task}, {options.physics} physics, joint changes of at most "
        f"{params.action_bound:g} degrees per step. Starts and goals are in the central {params.reset_range:.0%} of "
        f"the joints' range, the goal zone has a radius of {params.goal_radius:g} m."
    )
    training = (
        f"`icac train --config config.toml` trained {options.seeds} seeds of {settings.algo} (preset "
        f"{options.preset}), {options.episodes:,} episodes each and {summary['lane_steps']:,} steps in all; this is "
        f"seed {learner.seed}, the best of them in the last tenth of training."
    )
    limits = "Nothing is known of it outside that task: other ranges, walls, loads, delays, a robot."
    parts = (f"# {name}", task, training, card.success(run, learner), limits)
    return "\n\n".join("\n".join(textwrap.wrap(part, 100)) for part in parts) + "\n"


def evaluated(name: str, pairs: int, pair_seed: int) -> dict:
    """What a policy of the package does without exploration, as `evaluate.evaluate` gives it for a run.

    Args:
      name: one of `policies.SHIPPED`.
      pairs: start and goal pairs.
      pair_seed: randomness of the pairs.

    Raises:
      ConfigError: a number is not allowed.
    """
    learner = load(name)
    states = jax.tree.map(lambda leaf: np.asarray(leaf)[None], learner.agent)
    return evaluate.of_states(learner.settings, states, np.array([learner.episodes]), name, pairs, pair_seed)
