"""What pays for exploration: each rival of Eq. 10 against NumPy, what each control leaves alone, and cells visited."""

import dataclasses
import functools
import typing

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest

from icac_jax import networks
from icac_jax.agents import coverage
from icac_jax.agents.base import Transition
from icac_jax.curiosity import CuriosityHyper, CuriositySpec, predictors, rivals, rnd, signals
from icac_jax.curiosity.base import MapInfo, Step
from icac_jax.curiosity.mapped import REMEMBERED
from icac_jax.curiosity.options import SignalName
from icac_jax.curiosity.predictors import BankInfo
from icac_jax.curiosity.reward import Seen
from icac_jax.fields import ConfigError
from icac_jax.precision import as_given
from tests import worlds
from tests.reference import signals as reference

SPEC = CuriositySpec(observation_size=4, state_size=2, action_size=2, map_capacity=32)
MAPPED = [name for name in signals.SIGNALS if name != "rnd"]


def walk(number, seed=0, size=2):
    """Steps of a random walk in the square."""
    rng = np.random.default_rng(seed)
    places = np.clip(np.cumsum(rng.uniform(-0.3, 0.3, (number + 1, size)), axis=0), -1, 1)
    actions = rng.uniform(-1, 1, (number, 2))
    return Step(*(jnp.asarray(part, jnp.float32) for part in (places[:-1], actions, places[1:])))


@functools.cache
def paid(name, number=300, seed=0, **numbers):
    """What a signal pays along a walk, [number], and its state at the end."""
    spec = dataclasses.replace(SPEC, signal=name)
    hyper = CuriosityHyper(e_max=0.3, mu=10, T=5, **numbers).traced()
    signal = signals.build(spec)
    steps, keys = walk(number, seed), jax.random.split(jax.random.key(3), number)

    def one(state, given):
        step, key = given
        state, payment = signal.update(state, step, key, hyper, True)
        return state, payment.bonus

    state, bonuses = jax.jit(lambda: jax.lax.scan(one, signal.init(jax.random.key(1), hyper), (steps, keys)))()
    return np.asarray(bonuses), state


def test_the_table_and_the_option_name_the_same_signals():
    assert list(signals.SIGNALS) == list(typing.get_args(SignalName))
    assert set(signals.CONTROLS) < set(signals.SIGNALS)


def seen(errors, mu, lag, window=40):
    """What a term is shown of a node with these errors so far."""
    ring = np.zeros(window)
    for number, error in enumerate(errors):
        ring[number % window] = error
    queries, hyper = jnp.asarray(len(errors)), CuriosityHyper(mu=mu, T=lag).traced()
    now, before, known = predictors.averages(SPEC, jnp.asarray(ring), queries, hyper)
    info = BankInfo(jnp.asarray(errors[-1]), jnp.abs(now - before), now, jnp.where(known, before, now), queries)
    mapped = MapInfo(jnp.array(0), jnp.array(0), jnp.zeros(()), jnp.array(False))
    return Seen(mapped, info, jnp.array(0), jnp.array(0))


def test_terms_agree_with_the_reference():
    rng = np.random.default_rng(0)
    errors, mu, lag = list(rng.uniform(0.1, 1.0, 60) * np.linspace(2, 0.2, 60)), 20, 10
    with jax.enable_x64(True), as_given():
        for number in range(1, 61):
            shown = seen(errors[:number], mu, lag)
            for name, wanted in (
                ("normalised_progress", reference.normalised_progress(errors[:number], mu, lag)),
                ("signed_progress", reference.signed_progress(errors[:number], mu, lag)),
                ("counts", reference.visits(number)),
                ("forward_error", 0.5 * errors[number - 1] ** 2),
            ):
                got = getattr(rivals, name)(SPEC, shown, None)
                np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-9, err_msg=f"{name}, {number} errors")


def test_progress_that_is_none_pays_nothing():
    shown = seen([0.0, 0.0, 0.0], 2, 1)
    assert float(rivals.normalised_progress(SPEC, shown, None)) == 0.0


def test_random_network_distillation_agrees_with_the_reference():
    with jax.enable_x64(True), as_given():
        hyper = CuriosityHyper(predictor_rate=0.05).traced()
        state = rnd.init(SPEC, jax.random.key(0), hyper)
        net = rnd.network(SPEC)
        plain = reference.Rnd(*(networks.layers(net, params) for params in (state.target, state.predictor)), 0.05)
        update = jax.jit(functools.partial(rnd.update, SPEC))
        rng = np.random.default_rng(2)
        for _ in range(300):
            place = rng.uniform(-1, 1, 2)
            state, payment = update(state, Step(place, np.zeros(2), place), hyper)
            np.testing.assert_allclose(payment.bonus, plain.pay(place), rtol=0, atol=1e-9)


def test_random_network_distillation_pays_for_what_is_new():
    hyper = CuriosityHyper(predictor_rate=0.05).traced()
    state = rnd.init(SPEC, jax.random.key(0), hyper)
    update = jax.jit(functools.partial(rnd.update, SPEC))
    known, new = (Step(*(jnp.asarray(place),) * 3) for place in ([0.5, 0.5], [-0.8, -0.6]))
    first = float(update(state, new, hyper)[1].bonus * jnp.sqrt(update(state, new, hyper)[0].square))
    for _ in range(300):
        state, payment = update(state, known, hyper)
    after, late = update(state, new, hyper)
    assert float(payment.bonus) < 0.01
    assert float(late.bonus * jnp.sqrt(after.square)) > 0.3 * first


def test_counts_fall_with_visits():
    bonuses, state = paid("counts")
    assert bonuses[0] == 1.0
    assert bonuses[-100:].mean() < 0.6 * bonuses[:100].mean()
    assert (bonuses > 0).all()
    # What a node's last visit was paid says how often it had been visited.
    np.testing.assert_allclose(bonuses.min() ** -2, np.asarray(state.bank.queries).max(), rtol=1e-5)


def test_the_parts_of_the_papers_reward_make_the_whole():
    whole, parts = paid("icac")[0], [paid(name)[0] for name in ("learning_progress", "perception_error")]
    np.testing.assert_allclose(whole, sum(parts), rtol=1e-5, atol=1e-7)
    assert all(part.max() > 0.01 for part in parts)


def test_shuffled_bonuses_are_the_signals_own_in_disorder():
    earned, got = paid("icac", 2500)[0], paid("shuffled", 2500)[0]
    for number in (50, 1500, 2400):
        assert got[number] in earned[max(0, number + 1 - REMEMBERED) : number + 1]
    np.testing.assert_allclose(got[500:].mean(), earned[500:].mean(), rtol=0.15)
    assert abs(np.corrcoef(earned[500:], got[500:])[0, 1]) < 0.1


def test_constant_and_none_pay_always_the_same():
    assert (paid("constant")[0] == 1.0).all()
    assert (paid("none")[0] == 0.0).all()


@pytest.mark.parametrize("name", MAPPED)
def test_the_map_does_not_depend_on_what_is_paid(name):
    np.testing.assert_array_equal(paid(name)[1].map.weights, paid("icac")[1].map.weights)


def test_the_forward_error_is_that_of_one_model():
    assert paid("icm")[1].bank.queries.shape == (1,)


@pytest.mark.parametrize("name", ["rnd", "shuffled", "counts"])
def test_a_frozen_lane_keeps_its_signal(name):
    spec, hyper = dataclasses.replace(SPEC, signal=name), CuriosityHyper().traced()
    signal = signals.build(spec)
    state = signal.init(jax.random.key(0), hyper)
    step = jax.tree.map(lambda leaf: leaf[0], walk(1))
    after, _ = signal.update(state, step, jax.random.key(1), hyper, jnp.array(False))
    jax.tree.map(np.testing.assert_array_equal, state, after)


def test_counts_need_nodes_to_count():
    with pytest.raises(ConfigError, match="signal: must not be counts with predictors single"):
        CuriositySpec(signal="counts", predictors="single")


def records(icac, folder, *options):
    """The episodes of a small run."""
    small = ["--physics", "kinematic", "--seeds", 2, "--episodes", 12]
    icac("train", *small, *options, "--out", folder, check=0)
    return pq.read_table(folder / "episodes.parquet")


def test_without_a_bonus_icac_learns_what_cacla_var_learns(icac, tmp_path):
    """Map and predictors learn beside it, and it sees the same goals, noise and rewards."""
    curious = records(icac, tmp_path / "curious", "--signal", "none")
    plain = records(icac, tmp_path / "plain", "--algo", "cacla_var")
    for name in ("steps", "reached", "extrinsic_reward"):
        np.testing.assert_array_equal(curious[name], plain[name])
    assert not curious["intrinsic_reward"].to_numpy().any()
    assert curious["live_nodes"].to_numpy().min() >= 2


def test_the_weight_is_that_of_what_is_paid(icac, tmp_path):
    once, twice = (
        records(icac, tmp_path / str(weight), "--signal", "constant", "--curiosity", weight)["intrinsic_reward"]
        for weight in (1, 2)
    )
    assert once[0].as_py() > 0
    assert twice[0].as_py() == 2 * once[0].as_py()  # of the first episode, whose actions no bonus has changed


def test_a_signal_without_a_map_is_a_run_like_others(icac, tmp_path):
    options = ["--algo", "curious_td3", "--signal", "rnd", "--warm-up", 20, "--buffer-size", 64, "--batch-size", 8]
    small = ["--physics", "kinematic", "--seeds", 2, "--checkpoint-every", 0, "--hidden-units", 8, *options]
    icac("train", *small, "--episodes", 6, "--out", "whole", check=0)
    icac("train", *small, "--episodes", 3, "--out", "parts", check=0)
    icac("resume", "parts", "--episodes", 6, check=0)
    whole, parts = (pq.read_table(tmp_path / run / "episodes.parquet") for run in ("whole", "parts"))
    assert whole.equals(parts)
    assert "live_nodes" not in whole.column_names
    said = icac("plot-map", "whole", check=2).stderr
    assert said == "icac plot-map: run: the signal rnd has no map, which only a learner with curiosity has\n"


def test_cells_visited_are_those_of_the_path():
    agent, hyper = worlds.learner("cacla", worlds.line())
    counted = coverage.counted(agent, 10, 1)
    state = counted.init(jax.random.key(0), hyper)
    update = jax.jit(counted.update)
    places = np.random.default_rng(0).uniform(-1, 1, 30)
    for number, place in enumerate(places):
        there = jnp.array([place, 0.0])
        transition = Transition(jnp.zeros(2), jnp.zeros(1), jnp.array(0.0), there, jnp.array(False), jnp.array(False))
        state, report = update(state, transition, jax.random.key(1), hyper, jnp.array(True))
        cells = {min(int((x + 1) / 2 * 10), 9) for x in places[: number + 1]}
        assert int(report.last["cells_visited"]) == len(cells)
        assert set(np.flatnonzero(state.visited)) == cells


def test_coverage_is_an_option_of_every_run(icac, tmp_path):
    counted = records(icac, tmp_path / "counted", "--coverage-bins", 8)
    plain = records(icac, tmp_path / "plain")
    assert counted.drop_columns("cells_visited").equals(plain)
    visited = counted["cells_visited"].to_numpy()
    assert visited.min() > 0
    assert visited.max() <= 64
    said = icac("train", "--arm", "nico4", "--coverage-bins", 20, "--out", "x", check=2).stderr
    assert "coverage_bins: must be at most 17 for a state of 4 entries, got 20" in said
    assert icac("plot-map", "counted", "--out", "m.png", check=0).returncode == 0
