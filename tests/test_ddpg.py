"""DDPG and TD3: one update against NumPy, the replay buffer against a list, hindsight against what happened."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax.agents import ddpg, ddpg_learning, hindsight, replay, td3
from icac_jax.agents.base import SeenGoal, Transition
from icac_jax.agents.ddpg_options import DdpgHyper, DdpgSpec
from icac_jax.agents.replay import Experience
from icac_jax.fast.when import when
from icac_jax.precision import as_given
from tests.reference.ddpg import Learner

SIZES = {"observation_size": 5, "action_size": 3, "hidden_units": 16, "batch_size": 8, "buffer_size": 32}


def layers(params):
    found = params["params"]
    return [(found[f"Dense_{n}"]["kernel"], found[f"Dense_{n}"]["bias"]) for n in range(len(found))]


@pytest.mark.parametrize(("algo", "clip", "penalty"), [("ddpg", True, 0.0), ("td3", False, 0.0), ("td3", True, 0.3)])
def test_updates_agree_with_the_reference(algo, clip, penalty):
    refined, kind, numbers = {"ddpg": (ddpg_learning.DDPG, DdpgSpec, DdpgHyper), "td3": (td3.TD3, td3.Spec, td3.Hyper)}[
        algo
    ]
    rng = np.random.default_rng(0)
    with jax.enable_x64(True), as_given():
        spec = kind(**SIZES, clip_target=clip)
        chosen = {"actor_rate": 0.01, "critic_rate": 0.02, "preactivation_penalty": penalty}
        hyper = numbers(gamma=0.9, tau=0.05, **chosen).traced()
        assert (hyper.preactivation_penalty is None) == (penalty == 0)
        learned = ddpg.init(spec, jax.random.key(1), 0, refined).learned
        plain = {"policy_delay": 1, "target_noise": 0.0} if algo == "ddpg" else {}
        named = {name: float(value) for name, value in vars(hyper).items() if value is not None} | plain
        critics = [layers(jax.tree.map(lambda leaf, k=k: leaf[k], learned.critics)) for k in range(refined.critics)]
        reference = Learner(layers(learned.actor), critics, named)
        step = jax.jit(functools.partial(ddpg_learning.learn, spec, refined))
        for _ in range(60):
            observation, following = rng.uniform(-1, 1, (2, 8, 5))
            action, noise = rng.uniform(-1, 1, (8, 3)), rng.normal(size=(8, 3))
            ended = (rng.uniform(size=8) < 0.3).astype(float)
            reward = np.where(ended, 0.0, -1.0)
            batch = ddpg_learning.Batch(observation, action, reward, following, ended, noise)
            learned, loss = step(learned, batch, (-1.0, 0.0), hyper)
            wanted = reference.update(
                observation, action, reward, following, ended, noise, (-10.0, 0.0) if clip else None
            )
            np.testing.assert_allclose(loss, wanted, atol=1e-9)
        pairs = [(learned.actor, reference.actor), (learned.actor_target, reference.actor_target)]
        for k in range(refined.critics):
            own, aim = (jax.tree.map(lambda leaf, k=k: leaf[k], p) for p in (learned.critics, learned.critics_target))
            pairs += [(own, reference.critics[k]), (aim, reference.critic_targets[k])]
        for got, net in pairs:
            for (kernel, bias), (w, b) in zip(layers(got), net.layers, strict=True):
                np.testing.assert_allclose(kernel, w, rtol=0, atol=1e-9)
                np.testing.assert_allclose(bias, b, rtol=0, atol=1e-9)


def experience(number):
    return Experience(
        jnp.full(2, number), jnp.full(1, number), jnp.full(2, number + 0.5), jnp.full(3, number), number, 0.1, 0.0
    )


def test_the_buffer_holds_the_last_transitions_and_where_their_episodes_end():
    capacity, lengths = 16, [3, 5, 1, 7, 4, 9, 2]
    buffer = replay.init(capacity, 2, 1, 3)
    add = jax.jit(replay.add)
    look = jax.jit(lambda buffer, places: (replay.read(buffer, places, 2, 1), replay.steps_left(buffer, places)))
    episodes = [[]]
    number = 0
    for length in lengths:
        for step in range(length):
            over = jnp.array(step == length - 1)
            disabled = add(buffer, experience(-1.0), over, jnp.array(False))
            jax.tree.map(np.testing.assert_array_equal, disabled, buffer)
            buffer = add(buffer, experience(float(number)), over, jnp.array(True))
            episodes[-1].append(number)
            number += 1
            kept = {n: episode for episode in episodes for n in episode if n >= number - capacity}
            places = np.array([n % capacity for n in kept])
            every = jax.device_get(look(buffer, jnp.arange(capacity)))
            read, left = jax.tree.map(lambda leaf, places=places: leaf[places], every)
            np.testing.assert_array_equal(read.reward, list(kept))
            np.testing.assert_array_equal(read.next_observation[:, 1], np.array(list(kept)) + 0.5)
            np.testing.assert_array_equal(left, [episode[-1] - n for n, episode in kept.items()])
            goals = np.asarray(buffer.rows)[(places + left) % capacity, 5:-3]
            np.testing.assert_array_equal(goals[:, 0], [episode[-1] for episode in kept.values()])
        episodes.append([])
    drawn = np.asarray(replay.sample(buffer, jax.random.key(0), 4000))
    assert np.bincount(drawn, minlength=capacity).min() > 4000 / capacity * 0.7


def walk(goal_share, kind, horizon=3):
    """A buffer of an episode of 10 and one under way of 4 on a line; the goal is at 100, reward 1 there and -1 else."""
    buffer = replay.init(32, 2, 1, 1)
    for n in range(14):
        place = n if n < 10 else n - 10
        seen = Experience(
            jnp.array([place, 100.0]),
            jnp.zeros(1),
            jnp.array([place + 1, 100.0]),
            jnp.array([place + 1.0]),
            -1.0,
            0.25,
            0.0,
        )
        buffer = replay.add(buffer, seen, jnp.array(n == 9), jnp.array(True))
    goal = SeenGoal(
        achieved=jnp.zeros(1),
        desired=jnp.array([100.0]),
        outcome=lambda achieved, goal: (jnp.where(achieved[0] == goal[0], 1.0, -1.0), achieved[0] == goal[0]),
        relabel=lambda observation, goal: observation.at[1].set(goal[0]),
    )
    places = jnp.arange(14).repeat(200)
    drawn = replay.read(buffer, places, 2, 1)
    hyper = hindsight.HindsightHyper(hindsight_share=goal_share, hindsight_horizon=horizon).traced()
    return places, drawn, hindsight.relabelled(kind, buffer, places, drawn, goal, jax.random.key(3), hyper)


@pytest.mark.parametrize("kind", ["future", "final"])
def test_hindsight_asks_for_what_was_reached_later(kind):
    places, drawn, got = walk(1.0, kind)
    ahead = np.asarray(got.observation[:, 1] - drawn.next_observation[:, 0])
    left = np.where(places < 10, 9 - places, 13 - places)
    if kind == "final":
        np.testing.assert_array_equal(ahead, left)
    else:
        for place in range(14):
            mine = ahead[np.asarray(places) == place]
            possible = np.arange(min(3, left[places == place][0] + 1))
            counts = np.bincount(mine.astype(int), minlength=len(possible))
            assert len(counts) == len(possible)
            assert counts.min() > 200 / len(possible) * 0.7
    np.testing.assert_array_equal(got.terminated, ahead == 0)
    np.testing.assert_array_equal(got.reward, np.where(ahead == 0, 1.0, -1.0))
    np.testing.assert_array_equal(got.bonus, 0.25)
    np.testing.assert_array_equal(got.observation[:, 1], got.next_observation[:, 1])


def test_hindsight_replaces_its_share():
    _, _, got = walk(0.8, "future")
    assert abs(np.mean(np.asarray(got.observation[:, 1]) != 100.0) - 0.8) < 0.03
    _, drawn, none = walk(0.0, "future")
    jax.tree.map(np.testing.assert_array_equal, none, drawn)


def test_a_change_that_no_lane_wants_is_not_computed():
    def grown(state, by):
        return state + by

    state, by = jnp.arange(3.0), jnp.full(3, 10.0)
    step = jax.jit(jax.vmap(lambda wanted, state, by: when(wanted, grown, state, by)))
    np.testing.assert_array_equal(step(jnp.array([True, False, True]), state, by), [10, 1, 12])
    np.testing.assert_array_equal(step(jnp.zeros(3, bool), state, by), state)
    shared = jax.jit(jax.vmap(lambda wanted, state, by: when(wanted, grown, state, by), in_axes=(0, None, None)))
    np.testing.assert_array_equal(shared(jnp.array([True, False]), 1.0, 2.0), [3, 1])
    assert when(jnp.array(True), grown, 1.0, 2.0) == 3.0
    text = (
        jax.jit(jax.vmap(lambda wanted, state, by: when(wanted, grown, state, by)))
        .lower(jnp.zeros(3, bool), state, by)
        .as_text()
    )
    assert "stablehlo.case" in text or "stablehlo.if" in text


def transition(rng, goal=None):
    observation, following = rng.uniform(-1, 1, (2, 5))
    return Transition(
        observation=jnp.asarray(observation, jnp.float32),
        action=jnp.asarray(rng.uniform(-1, 1, 3), jnp.float32),
        reward=jnp.array(0.0),
        next_observation=jnp.asarray(following, jnp.float32),
        terminated=jnp.array(False),
        truncated=jnp.array(False),
        goal=goal,
    )


def test_nothing_is_learnt_before_the_warm_up_nor_in_a_frozen_lane():
    spec, rng = td3.Spec(**SIZES), np.random.default_rng(0)
    agent, hyper = ddpg.agent(spec, 0, td3.TD3), td3.Hyper(warm_up=4).traced()
    first = state = agent.init(jax.random.key(0), hyper)
    update = jax.jit(agent.update)
    for number in range(6):
        frozen, _ = update(state, transition(rng), jax.random.key(number), hyper, jnp.array(False))
        jax.tree.map(np.testing.assert_array_equal, frozen, state)
        state, report = update(state, transition(rng), jax.random.key(number), hyper, jnp.array(True))
        assert int(state.learned.updates) == max(0, number - 2)
        assert (float(report.sums["critic_loss"]) > 0) == (number >= 3)
    # The actor moves with every second update of the critics.
    assert int(state.learned.actor_rule.count) == 1
    assert int(state.learned.critics_rule.count) == 3
    moved = jax.tree.map(lambda new, old: bool(jnp.any(new != old)), state.learned.critics, first.learned.critics)
    assert all(jax.tree.leaves(moved))


def test_several_updates_per_step():
    spec = td3.Spec(**SIZES, updates_per_step=3)
    agent, hyper = ddpg.agent(spec, 0, td3.TD3), td3.Hyper(warm_up=1).traced()
    state = agent.init(jax.random.key(0), hyper)
    state, _ = agent.update(state, transition(np.random.default_rng(0)), jax.random.key(0), hyper, jnp.array(True))
    assert int(state.learned.updates) == 3


@pytest.mark.parametrize(
    ("refined", "kind", "numbers"), [(ddpg_learning.DDPG, DdpgSpec, DdpgHyper), (td3.TD3, td3.Spec, td3.Hyper)]
)
def test_the_operations_that_estimates_of_time_count_are_those_of_the_program(refined, kind, numbers):
    spec = kind(observation_size=5, action_size=3, hidden_layers=3, updates_per_step=2)
    learned = ddpg.init(spec, jax.random.key(0), 0, refined).learned
    rows = [jnp.zeros((spec.batch_size, *shape)) for shape in [(5,), (3,), (), (5,), (), (3,)]]
    step = jax.jit(functools.partial(ddpg_learning.learn, spec, refined))
    of_one = step.lower(learned, ddpg_learning.Batch(*rows), (-1.0, 0.0), numbers().traced()).cost_analysis()["flops"]
    assert ddpg_learning.flops(spec, refined) / 2 == pytest.approx(of_one, rel=0.1)
