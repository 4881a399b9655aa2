"""Agent meets environment: lanes, chunks of steps, automatic resets, the record of each episode.

A lane is one learner in one world. Everything is written for one lane; `run_chunk` makes it L lanes. Lanes never talk
to each other.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jax.sharding import Mesh, PartitionSpec

from icac_jax.agents import agent
from icac_jax.agents.agent import AgentState, Transition
from icac_jax.envs.base import Environment
from icac_jax.fast import threefry
from icac_jax.fields import Hyper, Spec

# Names of a lane's three streams of randomness. They depend on the seed alone, so that algorithms and settings are
# compared on the same starts, goals and noise.
_INIT, _NOISE, _EPISODE = 0, 1, 2


class EpisodeTotals(struct.PyTreeNode):
    """What an episode adds up to, all [].

    Attributes:
      steps: int32.
      extrinsic_reward: sum of the world's rewards, unscaled.
      intrinsic_reward: sum of r^int.
      learning_progress: its first part.
      perception_error: its second part.
    """

    steps: jax.Array
    extrinsic_reward: jax.Array
    intrinsic_reward: jax.Array
    learning_progress: jax.Array
    perception_error: jax.Array


class LaneState(struct.PyTreeNode):
    """One learner in one world.

    Attributes:
      agent: the learner.
      env: the environment's own state.
      observation: [O] what the learner sees now.
      noise_key: key of the exploration noise; step t uses fold_in(noise_key, t).
      episode_key: key of the resets; episode k starts from fold_in(episode_key, k).
      step: [] int32, steps taken.
      episode: [] int32, episodes finished.
      totals: of the episode under way.
      failed: [] bool, a number stopped being finite; the lane is frozen as it was then.
    """

    agent: AgentState
    env: Any
    observation: jax.Array
    noise_key: jax.Array
    episode_key: jax.Array
    step: jax.Array
    episode: jax.Array
    totals: EpisodeTotals
    failed: jax.Array


class EpisodeRecord(NamedTuple):
    """One row of the record, all []; it counts only where `done`.

    Attributes:
      done: bool, an episode ended at this step.
      episode: int32, its number from 0.
      reached: bool, it ended in the goal zone.
      totals: its sums.
      live_nodes: int32, nodes in the map at its end.
    """

    done: jax.Array
    episode: jax.Array
    reached: jax.Array
    totals: EpisodeTotals
    live_nodes: jax.Array


def _no_totals() -> EpisodeTotals:
    zero = jnp.zeros(())
    return EpisodeTotals(
        steps=jnp.zeros((), jnp.int32),
        extrinsic_reward=zero,
        intrinsic_reward=zero,
        learning_progress=zero,
        perception_error=zero,
    )


def init_lane(spec: Spec, env: Environment, key: jax.Array, seed: jax.Array, hyper: Hyper, params: Any) -> LaneState:
    """A fresh lane.

    Args:
      spec: static choices of the learner.
      env: the world.
      key: root key of the run.
      seed: [] int32; the same seed gives the same streams in any batch, for any algorithm and setting.
      hyper: traced numbers of the learner.
      params: traced numbers of the world.
    """
    lane_key = jax.random.fold_in(key, seed)
    episode_key = jax.random.fold_in(lane_key, _EPISODE)
    env_state, observation = env.init(jax.random.fold_in(episode_key, 0), params)
    return LaneState(
        agent=agent.init(spec, jax.random.fold_in(lane_key, _INIT), hyper),
        env=env_state,
        observation=observation,
        noise_key=jax.random.fold_in(lane_key, _NOISE),
        episode_key=episode_key,
        step=jnp.zeros((), jnp.int32),
        episode=jnp.zeros((), jnp.int32),
        totals=_no_totals(),
        failed=jnp.zeros((), bool),
    )


def step_lane(
    spec: Spec, env: Environment, lane: LaneState, hyper: Hyper, params: Any, episodes: jax.Array
) -> tuple[LaneState, EpisodeRecord]:
    """One step of one lane (Alg. 2 lines 6-17); where an episode ends, `reset_lanes` has to begin the next.

    A lane that has finished its `episodes`, or failed, comes back unchanged.

    Args:
      spec: static choices of the learner.
      env: the world.
      lane: the lane.
      hyper: traced numbers of the learner.
      params: traced numbers of the world.
      episodes: [] int32, how many episodes the lane runs.
    """
    running = (lane.episode < episodes) & ~lane.failed
    action = agent.act(spec, lane.agent, lane.observation, threefry.fold_in(lane.noise_key, lane.step), hyper)
    env_state, seen = env.step(lane.env, action, params)
    transition = Transition(lane.observation, action, seen.reward, seen.observation, seen.terminated)
    learner, info = agent.update(spec, lane.agent, transition, hyper, running)

    totals = EpisodeTotals(
        steps=lane.totals.steps + 1,
        extrinsic_reward=lane.totals.extrinsic_reward + seen.reward,
        intrinsic_reward=lane.totals.intrinsic_reward + info.intrinsic_reward,
        learning_progress=lane.totals.learning_progress + info.learning_progress,
        perception_error=lane.totals.perception_error + info.perception_error,
    )
    # One sum tells whether anything that matters stopped being finite: NaN and infinity both survive adding up.
    total = (
        jnp.sum(learner.cacla.actor)
        + jnp.sum(learner.cacla.critic)
        + learner.cacla.variance
        + jnp.sum(seen.observation)
        + info.td_error
        + info.prediction_error
        + totals.intrinsic_reward
    )
    failed = running & ~jnp.isfinite(total)
    done = running & ~failed & (seen.terminated | seen.truncated)
    record = EpisodeRecord(
        done=done,
        episode=lane.episode,
        reached=seen.terminated,
        totals=totals,
        live_nodes=info.live_nodes,
    )

    new_lane = LaneState(
        agent=learner,
        env=_select(running, env_state, lane.env),
        observation=_select(running, seen.observation, lane.observation),
        noise_key=lane.noise_key,
        episode_key=lane.episode_key,
        step=lane.step + running,
        episode=lane.episode + done,
        totals=_select(done, _no_totals(), _select(running, totals, lane.totals)),
        failed=lane.failed | failed,
    )
    return new_lane, record


def _select(which: jax.Array, first: Any, second: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(which, a, b), first, second)


def reset_lanes(env: Environment, lanes: LaneState, done: jax.Array, params: Any) -> LaneState:
    """Begins the next episode in the lanes where one has ended.

    Nothing is drawn in a step in which no episode ends, hence for all lanes together.

    Args:
      env: the world.
      lanes: leaves [L, ...].
      done: [L] bool.
      params: leaves [L, ...].
    """

    def start(lane: LaneState, done: jax.Array, params: Any) -> tuple[Any, jax.Array]:
        fresh = env.init(threefry.fold_in(lane.episode_key, lane.episode), params)
        return _select(done, fresh, (lane.env, lane.observation))

    world, observation = jax.lax.cond(
        jnp.any(done),
        lambda: jax.vmap(start)(lanes, done, params),
        lambda: (lanes.env, lanes.observation),
    )
    return lanes.replace(env=world, observation=observation)


@functools.partial(jax.jit, static_argnames=("spec", "env"))
def init_lanes(spec: Spec, env: Environment, key: jax.Array, seeds: jax.Array, hyper: Hyper, params: Any) -> LaneState:
    """L fresh lanes; every argument as in `init_lane`.

    Args:
      spec: static choices of the learner.
      env: the world.
      key: root key of the run, shared by all lanes.
      seeds: [L] int32.
      hyper: leaves [L].
      params: leaves [L, ...].
    """

    def one(seed: jax.Array, hyper: Hyper, params: Any) -> LaneState:
        return init_lane(spec, env, key, seed, hyper, params)

    return jax.vmap(one)(seeds, hyper, params)


@functools.partial(jax.jit, static_argnames=("spec", "env", "length", "mesh"), donate_argnames="lanes")
def run_chunk(
    spec: Spec,
    env: Environment,
    lanes: LaneState,
    hyper: Hyper,
    params: Any,
    episodes: jax.Array,
    *,
    length: int,
    mesh: Mesh | None = None,
) -> tuple[LaneState, EpisodeRecord]:
    """`length` steps of L lanes in one compiled program; the lanes handed in are consumed.

    Args:
      spec: static choices of the learner.
      env: the world.
      lanes: leaves [L, ...].
      hyper: leaves [L].
      params: leaves [L, ...].
      episodes: [L] int32, episodes each lane runs.
      length: steps.
      mesh: devices with one axis `lane` over which the lanes are spread, L a multiple of their number; each device runs
        its lanes by itself. None runs on the default device.

    Returns:
      The lanes, and records with leaves [length, L].
    """

    def one(lane: LaneState, hyper: Hyper, params: Any, episodes: jax.Array) -> tuple[LaneState, EpisodeRecord]:
        return step_lane(spec, env, lane, hyper, params, episodes)

    def chunk(lanes: LaneState, hyper: Hyper, params: Any, episodes: jax.Array) -> tuple[LaneState, EpisodeRecord]:
        def body(lanes: LaneState, _: None) -> tuple[LaneState, EpisodeRecord]:
            lanes, record = jax.vmap(one)(lanes, hyper, params, episodes)
            return reset_lanes(env, lanes, record.done, params), record

        return jax.lax.scan(body, lanes, None, length=length)

    if mesh is not None:
        each, over_time = PartitionSpec("lane"), PartitionSpec(None, "lane")
        chunk = jax.shard_map(chunk, mesh=mesh, in_specs=each, out_specs=(each, over_time), check_vma=False)
    return chunk(lanes, hyper, params, episodes)


def broadcast(record: Any, lanes: int) -> Any:
    """The same traced numbers for every lane: leaves [...] become [lanes, ...]."""
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (lanes, *leaf.shape)), record)
