"""Windows, averages and the learning progress by hand (Eq. 8-10); the reward's parts and gates."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax import curiosity, networks
from icac_jax.curiosity import CuriosityHyper, CuriositySpec, predictors
from icac_jax.curiosity.predictors import Query
from icac_jax.networks import Network

NET = Network((3, 4, 2), "tanh")


def window_of(errors, length):
    ring = np.zeros(length)
    for number, error in enumerate(errors):
        ring[number % length] = error
    return jnp.asarray(ring), jnp.asarray(len(errors))


@pytest.mark.parametrize(
    ("errors", "lag", "divide_by", "wanted"),
    [
        ([], 0, "available", 0.0),
        ([4.0], 0, "available", 4.0),
        ([4.0], 0, "mu", 4.0 / 3),
        ([4.0, 1.0], 0, "available", 2.5),
        ([9.0, 1.0, 2.0, 3.0], 0, "available", 2.0),
        ([9.0, 1.0, 2.0, 3.0], 1, "available", 4.0),
        ([9.0, 1.0, 2.0, 3.0], 2, "available", 5.0),
        (list(range(100)), 0, "available", 98.0),
        (list(range(100)), 2, "available", 96.0),
    ],
)
def test_average_of_recent_errors(errors, lag, divide_by, wanted):
    ring, queries = window_of(errors, 5)
    assert float(predictors.mean_error(ring, queries, 3, lag, divide_by)) == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("errors", "early", "wanted"),
    [
        ([], "zero", 0.0),
        ([5.0], "zero", 0.0),
        ([5.0, 1.0], "zero", 0.0),  # only two averages so far, T = 2 needs three
        ([5.0, 1.0, 3.0], "zero", 2.0),  # |3 - 5|
        ([5.0], "first", 0.0),
        ([5.0, 1.0], "first", 2.0),  # |3 - 5|
        ([5.0, 1.0, 3.0, 8.0], "zero", 1.0),  # |4 - 3|
        ([], "first", 0.0),
    ],
)
def test_learning_progress(errors, early, wanted):
    ring, queries = window_of(errors, 6)
    spec = CuriositySpec(early_learning_progress=early)
    hyper = CuriosityHyper(mu=3, T=2).traced()
    got = predictors.learning_progress(spec, ring, queries, hyper)
    assert float(got) == pytest.approx(wanted)
    # To the letter, the same one query later, whatever the latest error was.
    later, queries = window_of([*errors, 77.0], 6)
    got = predictors.learning_progress(replace(spec, learning_progress_time="previous"), later, queries, hyper)
    assert float(got) == pytest.approx(wanted)


def bank():
    return predictors.init(NET, jax.random.key(0), 4, 5, 0.5)


def ask(state, node, created=False, enabled=True, **choices):
    hyper = CuriosityHyper(predictor_rate=0.1, mu=3, T=2).traced()
    query = Query(jnp.array(node), jnp.array(created), jnp.array([0.1, -0.2, 0.3]), jnp.array([0.5, -0.5]))
    return predictors.update(NET, CuriositySpec(**choices), state, query, hyper, enabled)


def test_only_the_asked_node_changes():
    before = bank()
    after, info = ask(before, 2)
    for name in ("params", "errors", "queries"):
        changed = np.any(np.asarray(getattr(after, name) != getattr(before, name)).reshape(4, -1), axis=1)
        assert changed.tolist() == [False, False, True, False]
    guess = networks.apply(NET, before.params[2], jnp.array([0.1, -0.2, 0.3]))
    assert float(info.prediction_error) == pytest.approx(float(jnp.linalg.norm(guess - jnp.array([0.5, -0.5]))))
    assert float(after.errors[2, 0]) == float(info.prediction_error)


def test_error_after_training_is_smaller():
    state = bank()
    assert float(ask(state, 1, prediction_error_time="after")[1].prediction_error) < float(
        ask(state, 1)[1].prediction_error
    )


def test_training_learns_and_a_created_node_starts_fresh():
    state, first = ask(bank(), 1)
    for _ in range(200):
        state, info = ask(state, 1)
    assert float(info.prediction_error) < 0.2 * float(first.prediction_error)
    assert int(state.queries[1]) == 201
    state, again = ask(state, 1, created=True)
    assert float(again.prediction_error) == float(first.prediction_error)
    assert float(again.learning_progress) == 0.0
    assert int(state.queries[1]) == 1


def test_disabled_query_writes_nothing():
    before = bank()
    after, _ = ask(before, 1, created=True, enabled=False)
    jax.tree.map(np.testing.assert_array_equal, after, before)


SPEC = CuriositySpec(observation_size=2, state_size=2, action_size=1, map_capacity=16)


def wonder(spec=SPEC, steps=1, **hyper):
    numbers = CuriosityHyper(**hyper).traced()
    state = curiosity.init(spec, jax.random.key(0), numbers)
    points = np.random.default_rng(0).uniform(-1, 1, (steps, 2)).astype(np.float32)
    for point in points:
        state, info = curiosity.update(spec, state, jnp.asarray(point), jnp.array([0.1]), jnp.asarray(point), numbers)
    return state, info


def test_reward_is_the_sum_of_its_weighted_parts():
    _, plain = wonder(steps=60, e_max=5.0, T=1)
    _, weighted = wonder(steps=60, e_max=5.0, T=1, learning_progress_weight=3.0, perception_error_weight=0.5)
    assert float(plain.terms["learning_progress"]) > 0
    assert float(plain.reward) == pytest.approx(
        float(plain.terms["learning_progress"] + plain.terms["perception_error"])
    )
    assert float(weighted.reward) == pytest.approx(
        3 * float(plain.terms["learning_progress"]) + 0.5 * float(plain.terms["perception_error"]), rel=1e-5
    )


def test_perception_error_gates():
    _, always = wonder(steps=11, e_max=5.0)
    _, fading = wonder(steps=11, e_max=5.0, perception_half_life=10.0)
    _, patient = wonder(steps=11, e_max=5.0, perception_patience=10.0)
    _, impatient = wonder(steps=11, e_max=5.0, perception_patience=9.0)
    assert float(fading.terms["perception_error"]) == pytest.approx(
        0.5 * float(always.terms["perception_error"]), rel=1e-5
    )
    assert float(patient.terms["perception_error"]) == float(always.terms["perception_error"])
    assert float(impatient.terms["perception_error"]) == 0.0


def test_a_single_predictor_learns_from_every_transition():
    state, info = wonder(replace(SPEC, predictors="single"), steps=40, e_max=0.3)
    assert state.bank.params.shape[0] == 1
    assert state.bank.queries.tolist() == [40]
    assert int(state.map.live.sum()) > 2  # the map still grows and gives the perception error
    assert float(info.terms["perception_error"]) > 0


def test_created_node_choices():
    """The first stimulus of this map lies beyond its two nodes and far from both."""
    far = jnp.array([3.0, 3.0])
    numbers = CuriosityHyper(e_max=0.1).traced()
    start = curiosity.init(SPEC, jax.random.key(0), numbers)
    outcomes = {}
    for name, change in {
        "plain": {},
        "zero": {"creation_perception_error": "zero"},
        "nearest": {"prediction_node": "nearest"},
    }.items():
        spec = replace(SPEC, **change)
        outcomes[name] = curiosity.update(spec, start, far, jnp.array([0.1]), far, numbers)
    assert all(bool(info.created) for _, info in outcomes.values())
    assert float(outcomes["plain"][1].terms["perception_error"]) > 1
    assert float(outcomes["zero"][1].terms["perception_error"]) == 0
    assert np.asarray(outcomes["plain"][0].bank.queries)[:3].tolist().count(1) == 1
    assert int(outcomes["plain"][0].bank.queries[2]) == 1
    assert int(outcomes["nearest"][0].bank.queries[2]) == 0
    assert int(outcomes["nearest"][0].bank.queries[:2].sum()) == 1
