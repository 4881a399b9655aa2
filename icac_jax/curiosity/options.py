"""What can be chosen about curiosity: static choices and traced numbers, each declared once."""

import dataclasses
import math
from typing import Literal

import numpy as np

from icac_jax.fields import ConfigError, Numbers, check_record, param

# What may pay for exploration; `signals.SIGNALS` says what each is.
SignalName = Literal[
    "icac",
    "learning_progress",
    "perception_error",
    "normalised_progress",
    "signed_progress",
    "counts",
    "rnd",
    "icm",
    "none",
    "constant",
    "shuffled",
]


@dataclasses.dataclass(frozen=True)
class CuriositySpec:
    """The static choices of curiosity: whatever sets a shape or a branch of the program.

    Hashable; each distinct one is one compile.

    Raises:
      ConfigError: a value is not allowed.
    """

    observation_size: int = param(4, "entries of the actor's and critic's input", source="Sec. IV", low=1, derived=True)
    state_size: int = param(
        2,
        "leading entries of the observation that are the state",
        source="Sec. IV",
        low=1,
        derived=True,
    )
    action_size: int = param(2, "entries of an action", source="Sec. IV", low=1, derived=True)
    signal: SignalName = param("icac", "what pays for exploration", source="Eq. 10; rivals and controls: own")
    hidden_units: int = param(12, "width of each hidden layer", source="Sec. IV", low=1, high=4096)
    hidden_layers: int = param(1, "number of hidden layers", source="Sec. IV", low=1, high=8)
    map_capacity: int = param(128, "most nodes the map can hold", source="open point", low=2, high=16384)
    window: int = param(60, "errors kept per node, at least mu + T", source="Eq. 9-10", low=2, high=4096)
    map_input: Literal["state", "observation"] = param("state", "what the map is built over", source="Sec. IV")
    spacing_removal: Literal["second", "none"] = param(
        "second", "node removed when n and n' are too close", source="Alg. 1 line 20"
    )
    predictors: Literal["local", "single"] = param(
        "local", "one predictor per node, or one for the whole space", source="Sec. I, III.A"
    )
    predictor_output: Literal["tanh", "linear"] = param("tanh", "output activation of a predictor", source="Sec. IV")
    prediction_node: Literal["created", "nearest"] = param(
        "created", "who is asked and trained when a node was created", source="Sec. III.B"
    )
    prediction_error_time: Literal["before", "after"] = param(
        "before", "take the error before or after training the predictor", source="open point"
    )
    window_mean: Literal["available", "mu"] = param(
        "available", "divide a short window by its length or always by mu", source="Eq. 9"
    )
    early_learning_progress: Literal["zero", "first"] = param(
        "zero", "before T queries: 0, or against the first average", source="open point"
    )
    learning_progress_time: Literal["current", "previous"] = param(
        "current", "averages up to this query, or the one before (to the letter)", source="Eq. 8-10"
    )
    creation_perception_error: Literal["distance", "zero"] = param(
        "distance", "perception error of a state that created a node", source="open point"
    )

    def __post_init__(self) -> None:
        """Checks every field, and that the state is a part of the observation."""
        check_record(self)
        if self.signal == "counts" and self.predictors != "local":
            raise ConfigError("signal: must not be counts with predictors single, the visits of nodes are counted")
        if self.state_size > self.observation_size:
            raise ConfigError(
                f"state_size: must be at most observation_size = {self.observation_size}, got {self.state_size}"
            )

    @property
    def map_size(self) -> int:
        """Entries of a map stimulus."""
        return self.state_size if self.map_input == "state" else self.observation_size


class CuriosityHyper(Numbers):
    """The traced numbers of curiosity; a grid over any of them is one compile."""

    curiosity: float = param(1.0, "weight of the intrinsic reward", source="Eq. 11", low=0.0, neutral=1.0)
    predictor_rate: float = param(0.01, "learning rate of the predictors", source="Sec. IV", low=0.0, open_low=True)
    e_max: float = param(
        0.9,
        "mapping resolution, creation threshold",
        unit="normalised joints",
        source="Sec. IV, Alg. 1",
        low=0.0,
        open_low=True,
    )
    map_rate: float = param(
        1e-4,
        "learning step of the winner node (epsilon)",
        source="Sec. IV, Alg. 1 line 2",
        low=0.0,
        high=1.0,
    )
    map_init_range: float = param(
        1.0,
        "first two nodes are uniform in +- this",
        unit="normalised joints",
        source="open point",
        low=0.0,
        open_low=True,
    )
    predictor_weight_scale: float = param(
        0.1, "initial predictor weights are uniform in +- this", source="open point", low=0.0
    )
    mu: int = param(40, "errors averaged", unit="queries of a node", source="Sec. IV, Eq. 9", low=1)
    T: int = param(20, "lag of the learning progress", unit="queries of a node", source="Sec. IV, Eq. 10", low=1)
    learning_progress_weight: float = param(1.0, "weight of the learning progress", source="Eq. 10", low=0.0)
    perception_error_weight: float = param(1.0, "weight of the perception error", source="Eq. 10", low=0.0)
    rnd_target_scale: float = param(
        3.0,
        "RND's target: its parameters are uniform in +- this",
        source="own",
        low=0.0,
        open_low=True,
    )
    perception_half_life: float = param(
        math.inf,
        "the perception error's weight halves in this time",
        unit="steps",
        source="Sec. III.B",
        low=0.0,
        open_low=True,
    )
    perception_patience: float = param(
        math.inf,
        "no perception error once no node was new for so long",
        unit="steps",
        source="Sec. III.B",
        low=0.0,
    )

    def check_window(self, spec: CuriositySpec) -> None:
        """Checks that the window of errors is as long as the averages need (Eq. 9-10).

        Args:
          spec: `window` and `learning_progress_time`.

        Raises:
          ConfigError: with one line that names the field and what is allowed.
        """
        mu, lag = np.atleast_1d(self.mu, self.T)
        if np.any(mu < lag):
            raise ConfigError(f"T: must be at most mu = {mu[mu < lag].flat[0]} (Eq. 10), got {lag[mu < lag].flat[0]}")
        previous = spec.learning_progress_time == "previous"
        needed = int(np.max(mu + lag)) + previous
        if needed > spec.window:
            raise ConfigError(f"window: must be at least mu + T{' + 1' * previous} = {needed}, got {spec.window}")
