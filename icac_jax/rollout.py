"""Agent meets environment: lanes, chunks of steps, automatic resets, the record of each episode.

A lane is one learner in one world. Everything is written for one lane; `run_chunk` makes it L lanes. Lanes never talk
to each other.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jax.core import Tracer
from jax.sharding import Mesh, PartitionSpec

from icac_jax.agents.base import Agent, Report, SeenGoal, Transition
from icac_jax.envs.base import Environment, Goal, TimeStep
from icac_jax.fast import threefry
from icac_jax.fast.blocks import in_blocks
from icac_jax.fast.kernel import one_kernel
from icac_jax.fast.lanes_last import NotFollowed
from icac_jax.fast.layouts import LanesFirst, LanesLast, Layout
from icac_jax.fields import ConfigError, check_array, check_traced
from icac_jax.precision import usual

# Names of a lane's three streams of randomness. They depend on the seed alone, so that algorithms and settings are
# compared on the same starts, goals and noise.
_INIT, _NOISE, _EPISODE = 0, 1, 2
# Of the key of a step: what `update` draws from; `act` draws from the key itself.
_UPDATE = 1
# Columns of the record that no learner may use.
_OWN_COLUMNS = ("seed", "episode", "reached", "steps", "extrinsic_reward")


class LaneState(struct.PyTreeNode):
    """One learner in one world.

    Attributes:
      agent: the learner's own state.
      env: the environment's own state.
      observation: [O] what the learner sees now.
      noise_key: key of the exploration noise; step t uses fold_in(noise_key, t).
      episode_key: key of the resets; episode k starts from fold_in(episode_key, k).
      step: [] int32, steps taken.
      episode: [] int32, episodes finished.
      totals: of the episode under way: `steps` [] int32, `extrinsic_reward` [], and the sums of the learner's report.
      failed: [] bool, a number stopped being finite; the lane is frozen as it was then.
    """

    agent: Any
    env: Any
    observation: jax.Array
    noise_key: jax.Array
    episode_key: jax.Array
    step: jax.Array
    episode: jax.Array
    totals: dict[str, jax.Array]
    failed: jax.Array


class EpisodeRecord(NamedTuple):
    """One row of the record, all []; it counts only where `done`.

    Attributes:
      done: bool, an episode ended at this step.
      episode: int32, its number from 0.
      reached: bool, it ended in the goal zone.
      totals: its sums: `steps`, `extrinsic_reward` (unscaled), and those of the learner's report.
      last: what the learner's report says at its end.
    """

    done: jax.Array
    episode: jax.Array
    reached: jax.Array
    totals: dict[str, jax.Array]
    last: dict[str, jax.Array]


def report_of(agent: Agent, env: Environment, hyper: Any, params: Any) -> Report:
    """Shapes and types of what the learner reports, found without running anything; leaves are `ShapeDtypeStruct`.

    Raises:
      ConfigError: the learner uses a name twice, or one of the record's own.
    """

    def one(key: jax.Array) -> Report:
        state, (env_state, observation) = agent.init(key, hyper), env.init(key, params)
        action = agent.act(state, observation, key, hyper)
        env_state, seen = env.step(env_state, action, params)
        transition = _transition(env, observation, action, env_state, seen, params)
        return agent.update(state, transition, key, hyper, jnp.array(True))[1]

    report = jax.eval_shape(one, jax.random.key(0))
    taken = [*_OWN_COLUMNS, *report.sums, *report.last]
    for name in taken:
        if taken.count(name) > 1:
            raise ConfigError(f"report: {name} must be the name of one column only")
    return report


def _transition(
    env: Environment, observation: jax.Array, action: jax.Array, env_state: Any, seen: TimeStep, params: Any
) -> Transition:
    """A step as the learner is told of it; `env_state` is what the step led to."""
    return Transition(
        observation=observation,
        action=action,
        reward=seen.reward,
        next_observation=seen.observation,
        terminated=seen.terminated,
        truncated=seen.truncated,
        bonus=jnp.zeros_like(seen.reward),
        goal=None if env.goal is None else _seen_goal(env.goal, env_state, params),
    )


def _seen_goal(goal: Goal, env_state: Any, params: Any) -> SeenGoal:
    return SeenGoal(goal.achieved(env_state), goal.desired(env_state), goal.outcome(params), goal.relabel)


def init_lane(agent: Agent, env: Environment, key: jax.Array, seed: jax.Array, hyper: Any, params: Any) -> LaneState:
    """A fresh lane.

    Args:
      agent: the learner.
      env: the world.
      key: root key of the run.
      seed: [] int32; the same seed gives the same streams in any batch, for any algorithm and setting.
      hyper: traced numbers of the learner.
      params: traced numbers of the world.
    """
    lane_key = jax.random.fold_in(key, seed)
    episode_key = jax.random.fold_in(lane_key, _EPISODE)
    env_state, observation = env.init(jax.random.fold_in(episode_key, 0), params)
    sums = report_of(agent, env, hyper, params).sums
    own = {"steps": jnp.zeros((), jnp.int32), "extrinsic_reward": jnp.zeros(())}
    return LaneState(
        agent=agent.init(jax.random.fold_in(lane_key, _INIT), hyper),
        env=env_state,
        observation=observation,
        noise_key=jax.random.fold_in(lane_key, _NOISE),
        episode_key=episode_key,
        step=jnp.zeros((), jnp.int32),
        episode=jnp.zeros((), jnp.int32),
        totals=own | {name: jnp.zeros(leaf.shape, leaf.dtype) for name, leaf in sums.items()},
        failed=jnp.zeros((), bool),
    )


def step_lane(
    agent: Agent, env: Environment, lane: LaneState, hyper: Any, params: Any, episodes: jax.Array
) -> tuple[LaneState, EpisodeRecord]:
    """One step of one lane (Alg. 2 lines 6-17); where an episode ends, `begin_lane` has to begin the next.

    A lane that has finished its `episodes`, or failed, comes back unchanged.

    Args:
      agent: the learner.
      env: the world.
      lane: the lane.
      hyper: traced numbers of the learner.
      params: traced numbers of the world.
      episodes: [] int32, how many episodes the lane runs.
    """
    running = (lane.episode < episodes) & ~lane.failed
    key = threefry.fold_in(lane.noise_key, lane.step)
    action = agent.act(lane.agent, lane.observation, key, hyper)
    env_state, seen = env.step(lane.env, action, params)
    transition = _transition(env, lane.observation, action, env_state, seen, params)
    learner, report = agent.update(lane.agent, transition, threefry.fold_in(key, jnp.array(_UPDATE)), hyper, running)

    added = {"steps": 1, "extrinsic_reward": seen.reward} | report.sums
    totals = {name: lane.totals[name] + added[name] for name in lane.totals}
    # One sum tells whether anything in it stopped being finite: NaN and infinity both survive adding up.
    finite = report.finite & jnp.isfinite(jnp.sum(seen.observation) + seen.reward)
    failed = running & ~finite
    done = running & ~failed & (seen.terminated | seen.truncated)
    record = EpisodeRecord(
        done=done,
        episode=lane.episode,
        reached=seen.terminated,
        totals=totals,
        last=report.last,
    )

    new_lane = LaneState(
        agent=learner,
        env=_select(running, env_state, lane.env),
        observation=_select(running, seen.observation, lane.observation),
        noise_key=lane.noise_key,
        episode_key=lane.episode_key,
        step=lane.step + running,
        episode=lane.episode + done,
        totals=_select(done, jax.tree.map(jnp.zeros_like, totals), _select(running, totals, lane.totals)),
        failed=lane.failed | failed,
    )
    return new_lane, record


def _select(which: jax.Array, first: Any, second: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(which, a, b), first, second)


def begin_lane(env: Environment, lane: LaneState, params: Any, done: jax.Array) -> dict[str, Any]:
    """The fields of a lane that the next episode begins with, where one has ended (Alg. 2 line 4).

    Args:
      env: the world.
      lane: the lane.
      params: traced numbers of the world.
      done: [] bool, whether one has ended.
    """
    fresh = env.init(threefry.fold_in(lane.episode_key, lane.episode), params)
    state, observation = _select(done, fresh, (lane.env, lane.observation))
    return {"env": state, "observation": observation}


def init_lanes(agent: Agent, env: Environment, key: jax.Array, seeds: jax.Array, hyper: Any, params: Any) -> LaneState:
    """L fresh lanes; every argument as in `init_lane`.

    Args:
      agent: the learner.
      env: the world.
      key: root key of the run, shared by all lanes.
      seeds: [L] int32.
      hyper: leaves [L].
      params: leaves [L, ...].

    Raises:
      ConfigError: a number is out of its bounds, numbers contradict each other, or an array has not one entry per lane.
    """
    check_array("seeds", seeds, (None,), int)
    _check_lanes("hyper", hyper, len(seeds))
    _check_lanes("params", params, len(seeds))
    for record in (hyper, params):
        check_traced(record)
    if not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(hyper)):
        agent.check(hyper)
    return _init_lanes(agent, env, key, seeds, hyper, params)


def _check_lanes(name: str, record: Any, lanes: int) -> None:
    """Checks that each array of a record has one entry per lane.

    Raises:
      ConfigError: with one line that names the record and the field.
    """
    for path, leaf in jax.tree_util.tree_flatten_with_path(record)[0]:
        if jnp.ndim(leaf) < 1 or jnp.shape(leaf)[0] != lanes:
            field = name + jax.tree_util.keystr(path)
            raise ConfigError(f"{field}: must have one entry per lane, {lanes}, got shape {jnp.shape(leaf)}")


@functools.partial(jax.jit, static_argnames=("agent", "env"))
@usual
def _init_lanes(agent: Agent, env: Environment, key: jax.Array, seeds: jax.Array, hyper: Any, params: Any) -> LaneState:
    def one(seed: jax.Array, hyper: Any, params: Any) -> LaneState:
        return init_lane(agent, env, key, seed, hyper, params)

    return jax.vmap(one)(seeds, hyper, params)


@functools.partial(
    jax.jit, static_argnames=("agent", "env", "length", "mesh", "blocks", "lanes_last"), donate_argnames="lanes"
)
@usual
def run_chunk(
    agent: Agent,
    env: Environment,
    lanes: LaneState,
    hyper: Any,
    params: Any,
    episodes: jax.Array,
    *,
    length: int,
    mesh: Mesh | None = None,
    blocks: int = 1,
    lanes_last: bool = False,
) -> tuple[LaneState, EpisodeRecord]:
    """`length` steps of L lanes in one compiled program; the lanes handed in are consumed.

    Args:
      agent: the learner.
      env: the world.
      lanes: leaves [L, ...].
      hyper: leaves [L].
      params: leaves [L, ...].
      episodes: [L] int32, episodes each lane runs.
      length: steps.
      mesh: devices with one axis `lane` over which the lanes are spread, L a multiple of their number; each device runs
        its lanes by itself. None runs on the default device.
      blocks: a device runs its lanes in so many equal parts, one after the other, each for all of the steps. Lanes that
        a processor's cache holds cost less per step than all of them together.
      lanes_last: the faster layout on a CPU (`fast.lanes_last`), for learners whose operations it knows; blocks should
        then have as many lanes as a vector has numbers, or a multiple. Numbers may differ in their last digit.

    Returns:
      The lanes, and records with leaves [length, L].

    Raises:
      ConfigError: an array has not one entry per lane.
    """
    check_array("episodes", episodes, (None,), int)
    for name, record in (("lanes", lanes), ("hyper", hyper), ("params", params)):
        _check_lanes(name, record, len(episodes))

    def step(lane: LaneState, numbers: Any) -> tuple[LaneState, EpisodeRecord]:
        return step_lane(agent, env, lane, *numbers)

    def begin(lane: LaneState, numbers: Any, done: jax.Array) -> dict[str, Any]:
        return begin_lane(env, lane, numbers[1], done)

    def chunk(lanes: LaneState, *numbers: Any) -> tuple[LaneState, EpisodeRecord]:
        if lanes_last:
            try:
                layout = LanesLast(step, begin, lanes, numbers)
                return one_kernel(functools.partial(_steps, layout, length), lanes)
            except NotFollowed:
                pass
        return _steps(LanesFirst(step, begin, lanes, numbers), length, lanes)

    if blocks > 1:
        chunk = in_blocks(chunk, blocks)
    if mesh is not None:
        each, over_time = PartitionSpec("lane"), PartitionSpec(None, "lane")
        chunk = jax.shard_map(chunk, mesh=mesh, in_specs=each, out_specs=(each, over_time), check_vma=False)
    return chunk(lanes, hyper, params, episodes)


def _steps(layout: Layout, length: int, lanes: LaneState) -> tuple[LaneState, EpisodeRecord]:
    """`length` steps of lanes in a layout; the lanes, and records with leaves [length, L]."""
    # Numbers of one type are written as one array: each array that a step writes is an operation of its own.
    kinds = sorted({str(leaf.dtype) for leaf in jax.tree.leaves(layout.record)})

    def body(carried: Any, _: None) -> tuple[Any, list[jax.Array]]:
        carried, record = layout.step(carried)
        leaves = jax.tree.leaves(record)
        return carried, [jnp.stack([leaf for leaf in leaves if str(leaf.dtype) == kind]) for kind in kinds]

    carried, packed = jax.lax.scan(body, layout.enter(lanes), None, length=length)
    columns = {kind: iter(jnp.moveaxis(array, 1, 0)) for kind, array in zip(kinds, packed, strict=True)}
    return layout.leave(carried), jax.tree.map(lambda leaf: next(columns[str(leaf.dtype)]), layout.record)


def broadcast(record: Any, lanes: int) -> Any:
    """The same traced numbers for every lane: leaves [...] become [lanes, ...]."""
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (lanes, *leaf.shape)), record)
