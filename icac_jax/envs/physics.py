"""How an arm moves in one control step: a table from a name to a function, and what MJX computes for it.

A kind of physics is a function (arm, sub_steps, cache) -> move, where move is (joints [J] rad, velocity [J] rad/s,
target [J] rad) -> (joints, velocity), pure and for one lane. A kind more is a line in `PHYSICS`. J is the number of
joints.
"""

import contextlib
import functools
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar

import jax
import jax.numpy as jnp

from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.model import facts_of_model, on_mjx
from icac_jax.fast import scalars
from icac_jax.fast.arithmetic import Arithmetic
from icac_jax.fields import ConfigError

SUB_STEPS = 3

_Function = TypeVar("_Function", bound=Callable[..., Any])
Move = Callable[[jax.Array, jax.Array, jax.Array], tuple[jax.Array, jax.Array]]


class Cache(Protocol):
    """Keeps what is traced from MJX, which takes seconds, from one process to the next. No file is touched here."""

    def arithmetic(self, facts: bytes, trace: Callable[[], Arithmetic]) -> Arithmetic:
        """The arithmetic of these facts where it is kept, else what `trace` gives, kept from now on.

        Args:
          facts: all about the model and what is traced that the result depends on.
          trace: traces it; NotImplementedError where MJX does what cannot be followed.
        """
        ...


def once(function: _Function) -> _Function:
    """`functools.cache` for a function with a keyword `cache`, which is no part of the key.

    What a cache holds is what would be computed, so the same arguments give the same object with it and without.
    """
    made: dict[tuple[Any, ...], Any] = {}

    @functools.wraps(function)
    def found(*arguments: Any, cache: Cache | None = None) -> Any:
        if arguments not in made:
            made[arguments] = function(*arguments, cache=cache)
        return made[arguments]

    return found  # pyright: ignore[reportReturnType]  (as the function, arguments by place)


@contextlib.contextmanager
def as_mjx_wants() -> Iterator[None]:
    """MJX computes in single precision and mixes types and ranks freely, whatever JAX has been told."""
    with jax.enable_x64(False), jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


def _as_arithmetic(
    name: str, arm: ArmSpec, build: Callable[[], Callable[..., Any]], arguments: int, cache: Cache | None
) -> Callable[..., list[jax.Array]]:
    """A function of arrays [J] by `scalars.unrolled`, or as it is where it cannot be followed; in float32."""

    def traced() -> Arithmetic:
        with as_mjx_wants():
            return scalars.unrolled(build(), *[(arm.joints,)] * arguments)

    def single(function: Callable[..., Any]) -> Callable[..., list[jax.Array]]:
        return lambda *arrays: function(*(jnp.asarray(array, jnp.float32) for array in arrays))

    try:
        if cache is None:
            return single(traced())
        return single(cache.arithmetic(b"\n".join([name.encode(), arm.tip.encode(), facts_of_model(arm)]), traced))
    except NotImplementedError:
        with as_mjx_wants():
            function = build()

        def plain(*arrays: jax.Array) -> list[jax.Array]:
            with as_mjx_wants():
                return jax.tree.leaves(function(*arrays))

        return single(plain)


@once
def tip_function(arm: ArmSpec, *, cache: Cache | None = None) -> Callable[[jax.Array], jax.Array]:
    """The arm's forward kinematics by `mjx.kinematics`: joints [J] in rad to the tip's position [3] in m."""

    def build() -> Callable[[jax.Array], jax.Array]:
        mjx, model, mjx_model, template = on_mjx(arm, kinematic=True)
        site = model.site(arm.tip).id
        return lambda joints: mjx.kinematics(mjx_model, template.replace(qpos=joints)).site_xpos[site]

    arithmetic = _as_arithmetic("tip", arm, build, 1, cache)
    return lambda joints: arithmetic(joints)[0]


@once
def step_function(arm: ArmSpec, *, cache: Cache | None = None) -> Callable[..., list[jax.Array]]:
    """One physics step by `mjx.step`: joints, velocities and servo targets [J] to the new joints and velocities [J]."""

    def build() -> Callable[..., tuple[jax.Array, jax.Array]]:
        mjx, _, mjx_model, template = on_mjx(arm)

        def physics_step(joints: jax.Array, velocity: jax.Array, target: jax.Array) -> tuple[jax.Array, jax.Array]:
            data = mjx.step(mjx_model, template.replace(qpos=joints, qvel=velocity, ctrl=target))
            return data.qpos, data.qvel

        return physics_step

    return _as_arithmetic("step", arm, build, 3, cache)


def servo(arm: ArmSpec, sub_steps: int, cache: Cache | None) -> Move:
    """`mjx.step` with position servos that hold the target for all sub-steps; gravity as in the model."""
    arithmetic = step_function(arm, cache=cache)

    def move(joints: jax.Array, velocity: jax.Array, target: jax.Array) -> tuple[jax.Array, jax.Array]:
        # A loop: three copies of the arithmetic would take three times as long to compile.
        moved = jax.lax.fori_loop(0, sub_steps, lambda _, moving: arithmetic(*moving, target), [joints, velocity])
        return moved[0], moved[1]

    return move


def kinematic(arm: ArmSpec, sub_steps: int, cache: Cache | None) -> Move:
    """The joints are where they were told to be, at the velocity that they had; no forces, no sub-steps."""
    return lambda joints, velocity, target: (target, velocity)


PHYSICS: dict[str, Callable[[ArmSpec, int, Cache | None], Move]] = {"servo": servo, "kinematic": kinematic}

if TYPE_CHECKING:
    Physics = str
else:
    Physics = Literal[*PHYSICS]  # the names that an option of this type takes


def check_physics(physics: str, sub_steps: int) -> None:
    """Checks the choice of physics.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    if physics not in PHYSICS:
        raise ConfigError(f"physics: must be one of {', '.join(PHYSICS)}, got {physics!r}")
    if not isinstance(sub_steps, int) or isinstance(sub_steps, bool) or not 1 <= sub_steps <= 1000:
        raise ConfigError(f"sub_steps: must be a whole number at least 1 and at most 1000, got {sub_steps!r}")
