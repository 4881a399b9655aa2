"""What a learner is: a few pure functions for one lane, what it is told and what it reports.

The shape is that of `optax.GradientTransformation` and `blackjax.SamplingAlgorithm`: a NamedTuple of functions. The
rollout, evaluation, records, checkpoints and films work on these and know no learner.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import jax

from icac_jax.curiosity.base import Map, Slots

if TYPE_CHECKING:
    from icac_jax.agents.imitation import Imitate


class SeenGoal(NamedTuple):
    """The goal of a step, and what the step would have been had it been another one: what hindsight needs.

    Attributes:
      achieved: [G] the goal that s_{t+1} would have reached.
      desired: [G] the goal that was asked for.
      outcome: (achieved [G], goal [G]) -> (extrinsic reward [], terminated [] bool) of a step that led to the one while
        the other was asked for.
      relabel: (observation [O], goal [G]) -> [O], the observation had this been the goal.
    """

    achieved: jax.Array
    desired: jax.Array
    outcome: Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]
    relabel: Callable[[jax.Array, jax.Array], jax.Array]


class Transition(NamedTuple):
    """One step of experience.

    Attributes:
      observation: [O] s_t, each entry in [-1, 1]; the first `state_size` entries are the agent's own state.
      action: [A] a_t as executed, in units of the action bound.
      reward: [] extrinsic reward.
      next_observation: [O] s_{t+1}, before any reset.
      terminated: [] bool, the goal was reached (not a time-out).
      truncated: [] bool, the episode ended because time was up.
      bonus: [] intrinsic reward that came with the step; 0 without curiosity.
      goal: the goal that was asked for, the one that was achieved, and how to ask for another; None where the
        environment has no goals.
    """

    observation: jax.Array
    action: jax.Array
    reward: jax.Array
    next_observation: jax.Array
    terminated: jax.Array
    truncated: jax.typing.ArrayLike = False
    bonus: jax.typing.ArrayLike = 0.0
    goal: SeenGoal | None = None


class Report(NamedTuple):
    """What one update tells.

    Attributes:
      sums: numbers [] that are added up over an episode; each is a column of `episodes.parquet`.
      last: numbers [] taken as they stand at the end of an episode; each is a column too.
      finite: [] bool; False freezes the lane, which counts as diverged.
    """

    sums: dict[str, jax.Array]
    last: dict[str, jax.Array]
    finite: jax.Array


class Layers(NamedTuple):
    """A policy as layers of a small network, for readers without JAX.

    Attributes:
      weights: [after, before] of each layer, from the input on.
      biases: [after] of each layer.
      hidden: activation of the hidden layers, "tanh" or "relu".
      output: activation of the last layer, "linear" or "tanh"; the action is its output clipped to [-1, 1].
    """

    weights: tuple[jax.Array, ...]
    biases: tuple[jax.Array, ...]
    hidden: str
    output: str


def _nothing_to_check(hyper: Any) -> None:
    pass


class Agent(NamedTuple):
    """A learner as pure functions for one lane; whoever runs it applies `jax.vmap` and `jax.jit`.

    Hashable by the identity of its functions, so it can be a static argument: build it once and reuse it.

    Attributes:
      init: (key, hyper) -> state; a learner that knows nothing.
      act: (state, observation [O], key, hyper) -> action [A] in [-1, 1], with exploration.
      update: (state, `Transition`, key, hyper, enabled) -> (state, `Report`). Where `enabled` [] bool is False the
        state comes back unchanged (a frozen lane).
      greedy: (state, observation [O], hyper) -> action [A], without exploration.
      check: (hyper) -> None, on the host and before anything is traced; raises `ConfigError` where numbers contradict
        each other. Bounds of single numbers are checked without it.
      layers: (state) -> `Layers`, or None where the policy is no such network; then only `jax.export` exports it.
      map: the map that the learner builds, for pictures; None without curiosity.
      slots: how its state has fewer slots of the map, at a lower cost per step; None where it needs all of them.
      flops: floating-point operations of an update where they take longer than the environment's step, as a batch
        from a replay buffer does; for estimates of time alone.
      imitate: (fresh state, `imitation.Demonstrations`, `SeenGoal` or None, key, hyper) -> state; a learner that was
        shown them. None where it cannot start from demonstrations.
    """

    init: Callable[[jax.Array, Any], Any]
    act: Callable[[Any, jax.Array, jax.Array, Any], jax.Array]
    update: Callable[[Any, Transition, jax.Array, Any, jax.typing.ArrayLike], tuple[Any, Report]]
    greedy: Callable[[Any, jax.Array, Any], jax.Array]
    check: Callable[[Any], None] = _nothing_to_check
    layers: Callable[[Any], Layers] | None = None
    map: Map | None = None
    slots: Slots | None = None
    flops: int = 0
    imitate: "Imitate | None" = None
