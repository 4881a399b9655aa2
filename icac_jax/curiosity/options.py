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

# What may hold the experience; `maps.MAPS` says what each is.
MapName = Literal["itm", "gng", "som", "grid"]

_FRITZKE, _KOHONEN = "own; Fritzke 1995", "own; Kohonen 1990"
_FREE = ("map", ("itm", "gng"))  # maps of free nodes
_ITM, _GNG, _SOM = ("map", ("itm",)), ("map", ("gng",)), ("map", ("som",))


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
    map: MapName = param("itm", "map of experience", source="Sec. III.A; others: own")
    map_capacity: int = param(128, "most nodes the map can hold", source="open point", low=2, high=16384, only=_FREE)
    window: int = param(60, "errors kept per node, at least mu + T", source="Eq. 9-10", low=2, high=4096)
    map_input: Literal["state", "observation"] = param("state", "what the map is built over", source="Sec. IV")
    spacing_removal: Literal["second", "none"] = param(
        "second", "node removed when n and n' are too close", source="Alg. 1 line 20", only=_ITM
    )
    som_side: int = param(8, "nodes per dimension of the SOM's lattice", source=_KOHONEN, low=2, high=128, only=_SOM)
    som_dimensions: int = param(2, "dimensions of the SOM's lattice", source=_KOHONEN, low=1, high=14, only=_SOM)
    grid_side: int = param(
        4, "cells of the grid per entry of a stimulus", source="own", low=1, high=16384, only=("map", ("grid",))
    )
    predictors: Literal["local", "single"] = param(
        "local", "one predictor per node, or one for the whole space", source="Sec. I, III.A"
    )
    predictor_output: Literal["tanh", "linear"] = param("tanh", "output activation of a predictor", source="Sec. IV")
    prediction_node: Literal["created", "nearest"] = param(
        "created", "who is asked and trained when a node was created", source="Sec. III.B", only=_ITM
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
        "distance",
        "perception error of a state that created a node",
        source="open point",
        only=("map", ("itm", "grid")),
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
        only=_ITM,
    )
    map_rate: float = param(
        1e-4,
        "learning step of the winner node (epsilon)",
        source="Sec. IV, Alg. 1 line 2",
        low=0.0,
        high=1.0,
        only=_ITM,
    )
    map_init_range: float = param(
        1.0,
        "first nodes are uniform in +- this",
        unit="normalised joints",
        source="open point",
        low=0.0,
        open_low=True,
        only=("map", ("itm", "gng", "som")),
    )
    gng_interval: int = param(
        100, "a node is created once in so many (lambda)", unit="stimuli", source=_FRITZKE, low=1, only=_GNG
    )
    gng_max_age: int = param(
        50, "an edge that is older is removed (a_max)", unit="wins of a node", source=_FRITZKE, low=1, only=_GNG
    )
    gng_rate: float = param(
        0.2, "learning step of the winner node (epsilon_b)", source=_FRITZKE, low=0.0, high=1.0, only=_GNG
    )
    gng_neighbour_rate: float = param(
        0.006, "learning step of its neighbours (epsilon_n)", source=_FRITZKE, low=0.0, high=1.0, only=_GNG
    )
    gng_split_decay: float = param(
        0.5, "errors beside a new node are times this (alpha)", source=_FRITZKE, low=0.0, high=1.0, only=_GNG
    )
    gng_error_decay: float = param(
        0.995, "all errors are times this at each stimulus (d)", source=_FRITZKE, low=0.0, high=1.0, only=_GNG
    )
    som_rate: float = param(0.5, "learning step at first", source=_KOHONEN, low=0.0, high=1.0, open_low=True, only=_SOM)
    som_final_rate: float = param(
        0.01, "learning step at the end", source=_KOHONEN, low=0.0, high=1.0, open_low=True, only=_SOM
    )
    som_radius: float = param(
        4.0,
        "radius of the neighbourhood at first",
        unit="nodes of the lattice",
        source=_KOHONEN,
        low=0.0,
        open_low=True,
        only=_SOM,
    )
    som_final_radius: float = param(
        0.5,
        "radius of the neighbourhood at the end",
        unit="nodes of the lattice",
        source=_KOHONEN,
        low=0.0,
        open_low=True,
        only=_SOM,
    )
    som_decay_steps: int = param(
        10000, "rate and radius decay for so many", unit="stimuli", source=_KOHONEN, low=1, only=_SOM
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
