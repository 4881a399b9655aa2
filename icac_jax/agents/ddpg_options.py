"""What can be chosen about DDPG, and about TD3 too: static choices and traced numbers, each declared once."""

import dataclasses
from typing import Literal

from icac_jax.agents.hindsight import Hindsight, HindsightHyper
from icac_jax.fields import check_record, param


@dataclasses.dataclass(frozen=True)
class DdpgSpec:
    """The static choices of DDPG and TD3.

    Hashable; each distinct one is one compile.

    Raises:
      ConfigError: a value is not allowed.
    """

    observation_size: int = param(4, "entries of an observation", source="environment", low=1, derived=True)
    action_size: int = param(2, "entries of an action", source="environment", low=1, derived=True)
    hidden_units: int = param(64, "width of each hidden layer", source="trials", low=1, high=4096)
    hidden_layers: int = param(2, "number of hidden layers", source="Lillicrap 2016, Sec. 7", low=1, high=8)
    buffer_size: int = param(
        8192, "transitions kept per learner", unit="transitions", source="trials", low=2, high=10**7
    )
    batch_size: int = param(64, "transitions per update", source="Lillicrap 2016, Sec. 7", low=1, high=65536)
    updates_per_step: int = param(1, "updates per step", source="Lillicrap 2016, Alg. 1", low=1, high=1000)
    hindsight: Hindsight = param(
        "none", "which goals take the place of those asked for", source="Andrychowicz 2017, Sec. 4.5"
    )
    greedy_policy: Literal["actor", "target"] = param(
        "actor", "policy without exploration; the target is the actor's mean", source="trials"
    )
    clip_target: bool = param(
        True, "targets stay within what the rewards seen allow", source="Andrychowicz 2017, App. A"
    )

    def __post_init__(self) -> None:
        """Checks every field."""
        check_record(self)


class DdpgHyper(HindsightHyper):
    """The traced numbers of DDPG; a grid over any of them is one compile."""

    gamma: float = param(0.95, "discount factor", source="trials", low=0.0, high=1.0, open_high=True)
    tau: float = param(
        0.05, "rate of the target networks", source="Lillicrap 2016, Alg. 1; value: trials", low=0.0, high=1.0
    )
    actor_rate: float = param(1e-3, "learning rate of the actor (Adam)", source="Fujimoto 2018, App. C", low=0.0)
    critic_rate: float = param(1e-3, "learning rate of the critic (Adam)", source="Fujimoto 2018, App. C", low=0.0)
    sigma: float = param(
        0.2,
        "standard deviation of the exploration",
        unit="action bound of 10 deg",
        source="trials",
        low=0.0,
    )
    random_share: float = param(0.2, "share of random actions", source="Andrychowicz 2017, App. A", low=0.0, high=1.0)
    warm_up: int = param(500, "random steps before learning begins", unit="steps", source="trials", low=1)
    preactivation_penalty: float = param(
        0.0,
        "cost of what enters the actor's last tanh, squared",
        source="Andrychowicz 2017, App. A; value: Lillicrap 2016 has none",
        low=0.0,
        neutral=0.0,
    )
    reward_scale: float = param(0.02, "factor on the extrinsic reward", source="trials", low=0.0)
    reward_bias: float = param(
        -1.0, "added to each scaled reward; 0 at the goal of an arm", source="Andrychowicz 2017, Sec. 4"
    )
