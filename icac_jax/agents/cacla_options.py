"""What can be chosen about CACLA and CACLA+Var: static choices and traced numbers, each declared once."""

import dataclasses
from typing import Literal

from icac_jax.fields import Numbers, check_record, param


@dataclasses.dataclass(frozen=True)
class CaclaSpec:
    """The static choices of the actor-critic: whatever sets a shape, a trip count or a branch of the program.

    Hashable; each distinct one is one compile.

    Raises:
      ConfigError: a value is not allowed.
    """

    observation_size: int = param(4, "entries of the actor's and critic's input", source="Sec. IV", low=1, derived=True)
    action_size: int = param(2, "entries of an action", source="Sec. IV", low=1, derived=True)
    hidden_units: int = param(12, "width of each hidden layer", source="Sec. IV", low=1, high=4096)
    hidden_layers: int = param(1, "number of hidden layers", source="Sec. IV", low=1, high=8)
    optimizer: Literal["sgd", "adam", "rmsprop"] = param(
        "sgd", "update rule of actor and critic", source="Eq. 3, 5 (sgd)"
    )
    exploration: Literal["gaussian", "epsilon_greedy"] = param(
        "gaussian", "how actions are explored", source="Eq. 7, Sec. II"
    )
    action_clipping: Literal["executed", "output", "both"] = param(
        "executed",
        "clip the noisy action, the output before the noise, or both",
        source="open point",
    )
    critic_target: Literal["current", "previous"] = param(
        "current",
        "critic of the target: as it is, or one update older",
        source="Eq. 3, Alg. 2 line 11",
    )
    variance_order: Literal["updated", "previous"] = param(
        "updated",
        "variance in the update count: after or before line 14",
        source="Alg. 2 line 14-16",
    )

    hindsight: Literal["none", "future"] = param(
        "none", "learn as if the position just reached were the goal too", source="Andrychowicz 2017"
    )
    hindsight_updates: int = param(1, "such updates per step", source="own", low=1, high=1000)
    hindsight_horizon: int = param(
        4, "how far back such a transition may lie", unit="steps", source="trials", low=1, high=10**6
    )

    def __post_init__(self) -> None:
        """Checks every field."""
        check_record(self)


class CaclaHyper(Numbers):
    """The traced numbers of the actor-critic; a grid over any of them is one compile."""

    gamma: float = param(0.9, "discount factor", source="Sec. IV", low=0.0, high=1.0, open_high=True)
    sigma: float = param(
        0.1,
        "standard deviation of the exploration",
        unit="action bound of 10 deg",
        source="Sec. IV",
        low=0.0,
    )
    exploration_epsilon: float = param(
        0.1, "share of random actions (epsilon_greedy)", source="Sec. II", low=0.0, high=1.0
    )
    actor_rate: float = param(0.01, "learning rate of the actor", source="Sec. IV, Eq. 5", low=0.0, open_low=True)
    critic_rate: float = param(0.01, "learning rate of the critic", source="Sec. IV, Eq. 3", low=0.0, open_low=True)
    beta: float = param(
        0.01,
        "rate of the TD-error variance",
        source="Sec. IV, Eq. 6",
        low=0.0,
        high=1.0,
        open_low=True,
    )
    variance_init: float = param(1.0, "initial TD-error variance", source="Alg. 2 line 2", low=0.0, open_low=True)
    max_actor_updates: int = param(100, "cap on actor updates per step (CACLA+Var)", source="own", low=1, high=10000)
    bootstrap_at_goal: bool = param(True, "target at the goal includes gamma V(s')", source="Alg. 2 line 11")
    reward_scale: float = param(1.0, "factor on the extrinsic reward", source="Sec. IV", low=0.0, open_low=True)
    weight_scale: float = param(
        0.1, "initial weights are uniform in +- this", source="open point", low=0.0, open_low=True
    )
