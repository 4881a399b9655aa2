"""What is fixed at compile time (`Spec`), what is traced (`Hyper`), and the rules both must keep.

Every field is declared once, here, with its default, unit, meaning, source and allowed range; the command line, the
documentation and the validation all read these declarations.
"""

import dataclasses
import math
import typing
from collections.abc import Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

Algo = Literal["cacla", "cacla_var", "icac"]


class ConfigError(ValueError):
    """A wrong setting; the message is one line that names the field and what is allowed."""


def param(
    default: Any,
    help: str,
    *,
    unit: str = "",
    source: str,
    low: float = -math.inf,
    high: float = math.inf,
    open_low: bool = False,
    open_high: bool = False,
) -> Any:
    """A dataclass field that carries its own documentation and bounds.

    Args:
      default: the value used when nothing else is said.
      help: one line saying what the field is.
      unit: its unit; empty for a pure number or a choice.
      source: section or equation of the paper, or where else the value comes from.
      low: least allowed value; `open_low` excludes the value itself.
      high: largest allowed value; `open_high` excludes the value itself.
      open_low: whether `low` itself is forbidden.
      open_high: whether `high` itself is forbidden.
    """
    metadata = {
        "help": help,
        "unit": unit,
        "source": source,
        "bounds": (low, high, open_low, open_high),
    }
    return dataclasses.field(default=default, metadata=metadata)


@dataclasses.dataclass(frozen=True)
class Spec:
    """The static choices of one learner: whatever sets a shape, a trip count or a branch of the program.

    Hashable; a static argument of every jitted function. Each distinct `Spec` is one compile.
    """

    observation_size: int = param(4, "entries of the actor's and critic's input", source="Sec. IV", low=1)
    state_size: int = param(
        2,
        "leading entries of the observation that are the state",
        source="Sec. IV",
        low=1,
    )
    action_size: int = param(2, "entries of an action", source="Sec. IV", low=1)
    algo: Algo = param("icac", "learning algorithm", source="Sec. II, III")
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
    map_capacity: int = param(128, "most nodes the map can hold", source="open point", low=2, high=16384)
    window: int = param(60, "errors kept a node, at least mu + T", source="Eq. 9-10", low=2, high=4096)
    map_input: Literal["state", "observation"] = param("state", "what the map is built over", source="Sec. IV")
    spacing_removal: Literal["second", "none"] = param(
        "second", "node removed when n and n' are too close", source="Alg. 1 line 20"
    )
    predictors: Literal["local", "single"] = param(
        "local", "a predictor a node, or one for the whole space", source="Sec. I, III.A"
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

    @property
    def map_size(self) -> int:
        """Entries of a map stimulus."""
        return self.state_size if self.map_input == "state" else self.observation_size


class Hyper(struct.PyTreeNode):
    """The traced numbers of one learner; a grid over any of them is one compile.

    Host code holds Python numbers here; `traced` turns them into strongly typed scalars (shape []).
    """

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
    predictor_rate: float = param(0.01, "learning rate of the predictors", source="Sec. IV", low=0.0, open_low=True)
    beta: float = param(
        0.01,
        "rate of the TD-error variance",
        source="Sec. IV, Eq. 6",
        low=0.0,
        high=1.0,
        open_low=True,
    )
    variance_init: float = param(1.0, "initial TD-error variance", source="Alg. 2 line 2", low=0.0, open_low=True)
    max_actor_updates: int = param(100, "cap on actor updates a step (CACLA+Var)", source="own", low=1, high=10000)
    bootstrap_at_goal: bool = param(True, "target at the goal includes gamma V(s')", source="Alg. 2 line 11")
    reward_scale: float = param(1.0, "factor on the extrinsic reward", source="Sec. IV", low=0.0, open_low=True)
    weight_scale: float = param(
        0.1, "initial weights are uniform in +- this", source="open point", low=0.0, open_low=True
    )
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

    def traced(self) -> "Hyper":
        """The same numbers as strongly typed arrays of the default float, int and bool types."""
        return strong(self)


_Record = typing.TypeVar("_Record")
_KINDS = {int: jnp.int32, bool: jnp.bool_}


def strong(record: _Record) -> _Record:
    """Casts each field to a strong type: a Python number is weakly typed and would cost a second trace.

    Args:
      record: a dataclass of numbers, tuples of numbers or arrays.

    Returns:
      The same record with array fields; tuples become arrays of shape [length].
    """
    values = {
        field.name: jnp.asarray(getattr(record, field.name), _KINDS.get(field.type, float))
        for field in dataclasses.fields(record)  # pyright: ignore[reportArgumentType]
    }
    return type(record)(**values)


def stacked(records: Sequence[_Record]) -> _Record:
    """Several records as one with host arrays [n, ...] in each field, of the types that `strong` gives.

    Args:
      records: n dataclasses of one type, of numbers or tuples of numbers.
    """
    values = {
        field.name: np.array(
            [getattr(record, field.name) for record in records],
            jax.dtypes.canonicalize_dtype(_KINDS.get(field.type, float)),
        )
        for field in dataclasses.fields(records[0])  # pyright: ignore[reportArgumentType]
    }
    return type(records[0])(**values)


def allowed(field: dataclasses.Field) -> str:
    """What a field accepts, in words: a list of choices or a range."""
    choices = typing.get_args(field.type) if typing.get_origin(field.type) is Literal else ()
    if choices:
        return "one of " + ", ".join(map(str, choices))
    if field.type is bool:
        return "true or false"
    if field.type is str:
        return "text"
    kind = "a list of numbers"
    if field.type in (int, float):
        kind = "a whole number" if field.type is int else "a number"
    low, high, open_low, open_high = field.metadata["bounds"]
    limits = []
    if low > -math.inf:
        limits.append(f"{'greater than' if open_low else 'at least'} {_plain(low)}")
    if high < math.inf:
        limits.append(f"{'less than' if open_high else 'at most'} {_plain(high)}")
    return " ".join([kind, " and ".join(limits)]).strip()


def _plain(number: float) -> str:
    return str(int(number)) if number == int(number) else f"{number:g}"


def check_field(field: dataclasses.Field, value: Any) -> None:
    """Raises `ConfigError` unless `value` has the field's type and lies within its bounds."""

    def refuse() -> typing.NoReturn:
        raise ConfigError(f"{field.name}: must be {allowed(field)}, got {value!r}")

    if typing.get_origin(field.type) is Literal:
        if value not in typing.get_args(field.type):
            refuse()
        return
    if field.type in (bool, str):
        if not isinstance(value, field.type):  # pyright: ignore[reportArgumentType]
            refuse()
        return
    several = typing.get_origin(field.type) is tuple
    if isinstance(value, tuple | list) != several:
        refuse()
    values = value if several else (value,)
    low, high, open_low, open_high = field.metadata["bounds"]
    for number in values:
        if isinstance(number, bool) or not isinstance(number, int if field.type is int else (int, float)):
            refuse()
        if not -1e300 < number < 1e300 and abs(number) != math.inf:  # NaN, or too large to be a float
            refuse()
        if number < low or number > high:
            refuse()
        if (open_low and number == low) or (open_high and number == high):
            refuse()
        if math.isinf(number) and field.default != math.inf:
            refuse()


def check_record(record: Any) -> None:
    """Checks each field of a dataclass by itself; raises `ConfigError` at the first wrong one."""
    for field in dataclasses.fields(record):
        if "bounds" in field.metadata:
            check_field(field, getattr(record, field.name))


def validate(spec: Spec, hyper: Hyper) -> None:
    """Checks a learner's settings, each by itself and against one another.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    check_record(spec)
    check_record(hyper)
    if spec.state_size > spec.observation_size:
        raise ConfigError(
            f"state_size: must be at most observation_size = {spec.observation_size}, got {spec.state_size}"
        )
    if hyper.mu < hyper.T:
        raise ConfigError(f"T: must be at most mu = {hyper.mu} (Eq. 10), got {hyper.T}")
    previous = spec.learning_progress_time == "previous"
    needed = hyper.mu + hyper.T + previous
    if needed > spec.window:
        raise ConfigError(f"window: must be at least mu + T{' + 1' * previous} = {needed}, got {spec.window}")
