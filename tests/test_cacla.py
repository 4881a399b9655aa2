"""CACLA and CACLA+Var: hand-computed values, exploration, and probe worlds that a wrong version fails."""

from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax import networks, rollout
from icac_jax.agents import cacla, registry
from icac_jax.agents.cacla import CaclaHyper as Hyper
from icac_jax.agents.cacla import CaclaSpec as Spec
from icac_jax.networks import Network
from tests.worlds import bandit, learner

SMALL = Spec(observation_size=1, action_size=1, hidden_units=2)


@pytest.mark.parametrize(
    ("repeats", "td_error", "variance", "count"),
    [
        (cacla.once, 5.0, 4.0, 1),
        (cacla.once, 0.0, 4.0, 0),
        (cacla.once, -1.0, 4.0, 0),
        (cacla.by_variance, 5.0, 4.0, 3),  # ceil(5 / 2)
        (cacla.by_variance, 4.0, 4.0, 2),  # exactly two deviations
        (cacla.by_variance, 0.1, 4.0, 1),
        (cacla.by_variance, 0.1, 1e-6, 7),  # ceil(100) capped at 7
        (cacla.by_variance, -3.0, 1.0, 0),
    ],
)
def test_update_count(repeats, td_error, variance, count):
    got = cacla.update_count(repeats, jnp.array(td_error), jnp.array(variance), Hyper(max_actor_updates=7).traced())
    assert int(got) == count
    assert got.dtype == jnp.int32


def test_network_by_hand():
    net = Network((1, 2, 1))
    #             w1    b1   w2    b2   v1   v2   c
    params = jnp.array([0.5, 0.1, -1.0, 0.2, 2.0, 3.0, 0.4])
    hidden = np.tanh([0.5 * 0.3 + 0.1, -1.0 * 0.3 + 0.2])
    out = 2 * hidden[0] + 3 * hidden[1] + 0.4
    assert net.size == 7
    np.testing.assert_allclose(networks.apply(net, params, jnp.array([0.3])), [out], rtol=1e-6)
    error = 1.0 - out
    by_hand = [
        error * 2 * (1 - hidden[0] ** 2) * 0.3,
        error * 2 * (1 - hidden[0] ** 2),
        error * 3 * (1 - hidden[1] ** 2) * 0.3,
        error * 3 * (1 - hidden[1] ** 2),
        error * hidden[0],
        error * hidden[1],
        error,
    ]
    np.testing.assert_allclose(networks.descent(net, params, jnp.array([0.3]), jnp.array([1.0])), by_hand, rtol=1e-5)
    squashed = networks.apply(Network((1, 2, 1), "tanh"), params, jnp.array([0.3]))
    np.testing.assert_allclose(squashed, [np.tanh(out)], rtol=1e-6)


@pytest.mark.parametrize("layers", [1, 2, 3])
def test_depth_and_width_are_choices(layers):
    net = cacla.actor_network(Spec(hidden_layers=layers, hidden_units=5))
    assert net.sizes == (4, *(5,) * layers, 2)
    params = networks.init(net, jax.random.key(0), 0.5)
    assert params.shape == (net.size,)
    assert float(jnp.abs(params).max()) <= 0.5
    assert networks.apply(net, params, jnp.ones(4)).shape == (2,)


def one_update(spec, hyper, td_sign=1.0, terminated=True):
    state = cacla.init(spec, jax.random.key(1), hyper)
    x, a = jnp.array([0.4]), jnp.array([0.8])
    return state, cacla.update(spec, state, x, a, jnp.array(td_sign * 2.0), x, jnp.array(terminated), hyper)


def test_terminal_bootstrap_is_a_choice():
    on, off = Hyper().traced(), Hyper(bootstrap_at_goal=False).traced()
    value = float(cacla.value(SMALL, one_update(SMALL, on)[0], jnp.array([0.4])))
    assert value != 0
    assert float(one_update(SMALL, on)[1][1].td_error) == pytest.approx(2.0 + 0.9 * value - value, rel=1e-5)
    assert float(one_update(SMALL, off)[1][1].td_error) == pytest.approx(2.0 - value, rel=1e-5)
    # A time-out always bootstraps.
    assert float(one_update(SMALL, off, terminated=False)[1][1].td_error) == pytest.approx(
        2.0 + 0.9 * value - value, rel=1e-5
    )


def test_variance_order_is_a_choice():
    hyper = Hyper(beta=0.5, variance_init=1.0).traced()
    _, (state, updated) = one_update(SMALL, hyper)
    _, (_, previous) = one_update(replace(SMALL, variance_order="previous"), hyper)
    delta = float(updated.td_error)
    assert float(state.variance) == pytest.approx(0.5 + 0.5 * delta**2, rel=1e-5)
    assert int(updated.actor_updates) == np.ceil(delta / np.sqrt(float(state.variance)))
    assert int(previous.actor_updates) == np.ceil(delta)


def test_previous_critic_is_one_update_old():
    spec = replace(SMALL, critic_target="previous")
    hyper = Hyper().traced()
    before, (after, _) = one_update(spec, hyper)
    np.testing.assert_array_equal(after.critic_previous, before.critic)
    assert np.any(np.asarray(after.critic) != np.asarray(before.critic))


def test_actor_does_not_move_when_td_error_is_not_positive():
    before, (after, info) = one_update(SMALL, Hyper().traced(), td_sign=-1.0)
    assert float(info.td_error) < 0
    np.testing.assert_array_equal(after.actor, before.actor)


def test_gaussian_exploration_has_the_asked_spread_and_bound():
    hyper = Hyper(sigma=0.2).traced()
    state = cacla.init(SMALL, jax.random.key(0), hyper)
    act = jax.vmap(cacla.act, (None, None, None, 0, None))
    keys = jax.random.split(jax.random.key(4), 20000)
    mean = float(networks.apply(cacla.actor_network(SMALL), state.actor, jnp.array([0.3]))[0])
    actions = np.asarray(act(SMALL, state, jnp.array([0.3]), keys, hyper))
    assert actions.mean() == pytest.approx(mean, abs=0.01)
    assert actions.std() == pytest.approx(0.2, abs=0.01)
    wide = Hyper(sigma=3.0).traced()
    clipped = np.asarray(act(SMALL, state, jnp.array([0.3]), keys, wide))
    assert np.abs(clipped).max() == 1.0
    both = replace(SMALL, action_clipping="both")
    high = state.replace(actor=state.actor.at[-1].set(100.0))  # an output far beyond the bound
    assert np.ptp(np.asarray(act(SMALL, high, jnp.array([0.3]), keys, hyper))) == 0
    assert 0.05 < np.asarray(act(both, high, jnp.array([0.3]), keys, hyper)).std() < 0.2
    free = replace(SMALL, action_clipping="output")
    assert np.abs(np.asarray(act(free, state, jnp.array([0.3]), keys, wide))).max() > 2.0


def test_epsilon_greedy_explores_as_often_as_asked():
    spec = replace(SMALL, exploration="epsilon_greedy")
    hyper = Hyper(exploration_epsilon=0.3).traced()
    state = cacla.init(spec, jax.random.key(0), hyper)
    keys = jax.random.split(jax.random.key(4), 20000)
    actions = np.asarray(jax.vmap(cacla.act, (None, None, None, 0, None))(spec, state, jnp.array([0.3]), keys, hyper))
    greedy = np.asarray(cacla.greedy_action(spec, state, jnp.array([0.3])))
    assert np.mean(actions != greedy) == pytest.approx(0.3, abs=0.01)
    assert actions[actions != greedy].min() < -0.99


@pytest.mark.parametrize("rule", ["sgd", "adam", "rmsprop"])
def test_optimizers_move_actor_and_critic(rule):
    spec = replace(SMALL, optimizer=rule)
    before, (after, _) = one_update(spec, Hyper().traced())
    assert np.any(np.asarray(before.actor) != np.asarray(after.actor))
    assert np.all(np.isfinite(after.critic))


def replays(algo):
    """Whether a learner has a replay buffer."""
    return "buffer_size" in {field.name for field in fields(registry.find(algo).static)}


def probe(algo, reward, steps, **hyper):
    """Trains 8 seeds on a bandit; returns the policies' raw outputs [8, 21] at x = -1 ... 1."""
    env = bandit(reward)
    common = {"bootstrap_at_goal": False, "weight_scale": 0.3, "sigma": 0.3, "actor_rate": 0.05, "critic_rate": 0.05}
    if replays(algo):  # Adam's rates are smaller, and a batch per step needs fewer steps
        small = {"hidden_units": 16, "batch_size": 32, "reward_scale": 1.0, "reward_bias": 0.0, "warm_up": 50}
        common |= small | {"actor_rate": 0.003, "critic_rate": 0.01}
        steps //= 8
    agent, numbers = learner(algo, env, map_capacity=16, **common, **hyper)
    traced = rollout.broadcast(numbers.traced(), 8)
    lanes = rollout.init_lanes(agent, env, jax.random.key(0), jnp.arange(8), traced, None)
    lanes, _ = rollout.run_chunk(agent, env, lanes, traced, None, jnp.full(8, steps), length=steps)
    return np.stack([raw_outputs(agent, jax.tree.map(lambda leaf, at=at: leaf[at], lanes.agent)) for at in range(8)])


def raw_outputs(agent, state):
    """Outputs [21] of a policy's network before they are clipped, where it is one."""
    xs = np.linspace(-1, 1, 21)[:, None]
    if agent.layers is None:
        return np.array([agent.greedy(state, jnp.asarray(x), None) for x in xs])[:, 0]
    *hidden, last = zip(*agent.layers(state)[:2], strict=True)
    activation = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0), "linear": lambda x: x}
    for weight, bias in hidden:
        xs = activation[agent.layers(state).hidden](xs @ np.asarray(weight).T + bias)
    return activation[agent.layers(state).output](xs @ np.asarray(last[0]).T + last[1])[:, 0]


def inner(x, a):
    """The best action is x / 2."""
    return -((a - 0.5 * x) ** 2)


def outer(x, a):
    """More is better: the best action is the bound."""
    return a


def finds_inner(algo):
    error = probe(algo, inner, 8000) - 0.5 * np.linspace(-1, 1, 21)
    return bool(np.sqrt(np.mean(error**2)) < 0.1)


def stays_at_bound(algo):
    outputs = probe(algo, outer, 8000)
    return bool(outputs.min() > 0.7 and outputs.max() < 1.05)


def single_updates_suffice(algo):
    """With a huge variance, delta / sqrt(var) is far below 1: rounding up is what makes the actor learn at all."""
    error = probe(algo, inner, 8000, variance_init=1e6, beta=1e-9) - 0.5 * np.linspace(-1, 1, 21)
    return bool(np.sqrt(np.mean(error**2)) < 0.1)


def each_learner():
    """All of them; DDPG, which is TD3 without its additions, and curiosity around another learner in the long tests."""
    long = [name for name in registry.learners() if name == "ddpg" or name.startswith("curious_")]
    return [pytest.param(algo, marks=[pytest.mark.slow] if algo in long else []) for algo in registry.learners()]


@pytest.mark.parametrize("algo", each_learner())
@pytest.mark.parametrize("claim", [finds_inner, stays_at_bound])
def test_probe_worlds(algo, claim):
    assert claim(algo)


@pytest.mark.parametrize("algo", [algo for algo in registry.learners() if not replays(algo)])
def test_probe_world_of_repeated_updates(algo):
    assert single_updates_suffice(algo)


def test_probe_world_catches_a_wrong_sign(monkeypatch):
    right = cacla.update_count
    monkeypatch.setattr(cacla, "update_count", lambda repeats, delta, *rest: right(repeats, -delta, *rest))
    assert not finds_inner("cacla")


def test_probe_world_catches_a_missing_clip(monkeypatch):
    def unclipped(spec, state, observation, key, hyper):
        mean = networks.apply(cacla.actor_network(spec), state.actor, observation)
        return mean + hyper.sigma * jax.random.normal(key, mean.shape)

    monkeypatch.setattr(cacla, "act", unclipped)
    assert not stays_at_bound("cacla")


def test_probe_world_catches_a_missing_ceil(monkeypatch):
    monkeypatch.setattr(cacla.jnp, "ceil", jnp.floor)
    assert not single_updates_suffice("cacla_var")
