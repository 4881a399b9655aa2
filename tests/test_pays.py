"""The rule of whether curiosity pays: what it decides on made-up outcomes, and how often it errs without an effect."""

import numpy as np
import pytest

from icac_jax.sweeps import pays

SEEDS, EPISODES = 200, 1200


def drawn(rng, share, rate=300.0, seeds=SEEDS):
    """First episodes of seeds a share of which find their goal."""
    first = 1 + rng.geometric(1 / rate, seeds).astype(float)
    return np.where((rng.random(seeds) < share) & (first <= EPISODES), first, np.inf)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def test_p_earlier_and_the_share_found_by_hand():
    first, control = np.array([1.0, 5.0, np.inf, np.inf]), np.array([2.0, 5.0, 9.0, np.inf])
    assert pays.found(first) == 0.5
    one = pays.earlier(first, control)
    assert one.value == (1 + 0.5 + 0 + 0.5) / 4
    assert one.low < one.value < one.high
    assert pays.earlier(first, control, 10).low < one.low
    np.testing.assert_allclose(one.value + pays.earlier(control, first).value, 1.0)


def test_nobody_finds_anything_is_no_lead():
    never = np.full(SEEDS, np.inf)
    said = pays.judge(never, {"none": never}, 1)
    assert (said.outcome, said.lead, said.earlier) == ("does not pay", 0.0, (0.5, 0.5, 0.5))


def test_a_signal_must_beat_every_control(rng):
    good, weak, strong = drawn(rng, 0.8), drawn(rng, 0.3), drawn(rng, 0.85)
    assert pays.judge(good, {"none": weak, "step cost": drawn(rng, 0.35)}, 21).outcome == "pays"
    said = pays.judge(good, {"none": weak, "step cost": strong}, 21)
    assert (said.outcome, said.control) == ("does not pay", "step cost")
    assert said.lead == pays.found(good) - pays.found(strong)


def test_a_small_lead_is_undecided(rng):
    control = drawn(rng, 0.5)
    slightly = control.copy()
    late = np.flatnonzero(np.isinf(control))[:4]  # 2 points more, under the tolerance
    slightly[late] = 1000.0
    assert pays.judge(slightly, {"none": control}, 1).outcome == "undecided"
    assert pays.judge(drawn(rng, 0.9, seeds=19), {"none": np.full(19, np.inf)}, 1).outcome == "undecided"


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_no_effect_is_seldom_called_one(share):
    """Seven signals on three tasks against five controls, none of which does anything: at most 5 % of 1,000 studies."""
    rng = np.random.default_rng(int(100 * share))
    signals, tasks, studies = 7, 3, 1000
    wrong = 0
    for _ in range(studies):
        called = False
        for _ in range(tasks):
            # One control, where the rule errs most: against five, all five would have to be unlucky.
            control = {"none": drawn(rng, share)}
            outcomes = [pays.judge(drawn(rng, share), control, signals * tasks).outcome for _ in range(signals)]
            called |= "pays" in outcomes
        wrong += called
    assert wrong / studies <= 0.05, f"{wrong} of {studies}"


def test_an_effect_of_the_size_that_was_seen_is_found(rng):
    """Two walls: 29 and 48 % by controls, 63 and 73 % by curiosity, 200 seeds (the trials that the study repeats)."""
    decided = [
        pays.judge(drawn(rng, 0.75), {"none": drawn(rng, 0.3), "step cost": drawn(rng, 0.49)}, 21).outcome == "pays"
        for _ in range(50)
    ]
    assert np.mean(decided) > 0.8
