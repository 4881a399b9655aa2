"""The verdict rule on synthetic seeds whose answer is known: both ways, and where nothing can be said."""

import dataclasses
import json

import numpy as np
import pytest

from icac_jax.paper import claims, power, verdicts
from icac_jax.paper.claims import CLAIMS, Order, Value
from icac_jax.paper.verdicts import judge, judge_order, judge_value
from icac_jax.reports import results, titles
from tests.tables_by_hand import result

RNG = np.random.default_rng(0)


def around(centre, spread=1.0, seeds=20):
    """Seeds with exactly this mean."""
    draws = np.random.default_rng(seeds).normal(0, 1, seeds)
    return centre + spread * (draws - draws.mean())


def claim(id, arm):
    (found,) = [claim for claim in CLAIMS if (claim.id, claim.arm) == (id, arm)]
    return found


def ends(**by_run):
    """The same figures for every metric that is not given."""
    return {
        name.replace("__", "-"): {metric: np.asarray(given.get(metric, given.get("all"))) for metric in titles.JUDGED}
        for name, given in by_run.items()
    }


ABOUT = Value("cacla", "steps", 35)
AT_MOST = Value("icac", "steps", 10, "at most")
AT_LEAST = Value("icac", "success_rate", 0.9, "at least")
AROUND = Value("cacla", "success_rate", 0.6, "at most", around=True)

VALUES = [
    (ABOUT, around(35), 2.5, "reproduced"),
    (ABOUT, around(37), 2.5, "reproduced"),  # within the tolerance
    (ABOUT, around(20), 2.5, "not reproduced"),
    (ABOUT, around(45), 2.5, "not reproduced"),
    (ABOUT, around(35, 25), 2.5, "undecided"),  # holds the value, too wide to tell
    (ABOUT, around(20, 40), 2.5, "undecided"),
    (AT_MOST, around(9), 2.5, "reproduced"),
    (AT_MOST, around(12), 2.5, "not reproduced"),  # a plain bound has no tolerance
    (AT_MOST, around(10, 3), 2.5, "undecided"),
    (AT_LEAST, around(0.95, 0.02), 0.05, "reproduced"),
    (AT_LEAST, around(0.87, 0.02), 0.05, "not reproduced"),
    (AT_LEAST, np.array([0.99] * 18 + [0.1] * 2), 0.05, "undecided"),  # two failed seeds of twenty
    (AROUND, around(0.62, 0.02), 0.05, "reproduced"),
    (AROUND, around(0.7, 0.02), 0.05, "not reproduced"),
    (AROUND, around(0.65, 0.05), 0.05, "undecided"),
    (ABOUT, around(35, seeds=4), 2.5, "undecided"),  # too few seeds
    (ABOUT, np.array([35.0] * 4 + [np.nan] * 16), 2.5, "undecided"),
]


@pytest.mark.parametrize(("part", "figures", "allowance", "outcome"), VALUES)
def test_values(part, figures, allowance, outcome):
    found = judge_value(part, figures, allowance)
    assert found.outcome == outcome
    assert found.mean.value == pytest.approx(np.nanmean(figures))


FEWER = Order("icac", "cacla", "steps")
MORE = Order("icac", "cacla", "success_rate")

ORDERS = [
    (FEWER, around(10), around(20), 2.5, "reproduced"),
    (FEWER, around(20), around(10), 2.5, "not reproduced"),
    (FEWER, around(10, 0.5), around(10, 0.5)[::-1], 2.5, "not reproduced"),  # surely no difference that would show
    (FEWER, around(20, 15), around(20, 15)[::-1], 2.5, "undecided"),
    (FEWER, around(12, 15), around(20, 15)[::-1], 2.5, "reproduced"),  # the interval begins at 0.52
    (FEWER, around(14, 15), around(20, 15)[::-1], 2.5, "undecided"),  # and here at 0.48
    (MORE, around(0.9, 0.02), around(0.6, 0.02), 0.05, "reproduced"),
    (MORE, around(0.6, 0.02), around(0.9, 0.02), 0.05, "not reproduced"),
    (MORE, around(0.9, 0.02, 4), around(0.6, 0.02, 4), 0.05, "undecided"),
]


@pytest.mark.parametrize(("part", "better", "worse", "allowance", "outcome"), ORDERS)
def test_orders(part, better, worse, allowance, outcome):
    assert judge_order(part, better, worse, allowance).outcome == outcome


def test_the_difference_is_paired_by_seed_and_positive_where_the_claim_is_right():
    """Seeds differ a lot, the algorithms by one step in each seed: only pairs see that it is exactly one."""
    hard = np.linspace(5, 45, 20)
    found = judge_order(FEWER, hard - 1, hard, 2.5)
    assert found.difference == pytest.approx((1, 1, 1))
    assert found.outcome == "not reproduced"  # less than a figure would show


def test_every_part_must_hold():
    order = claim("C1", "planar2")
    good = ends(icac={"all": around(40)}, cacla_var={"all": around(30)}, cacla={"all": around(20)})
    assert judge(order, good, 50).outcome == "reproduced"
    swapped = good | {"cacla": good["cacla_var"], "cacla_var": good["cacla"]}
    assert judge(order, swapped, 50).outcome == "not reproduced"
    vague = good | {"cacla_var": {metric: around(39.5, 12) for metric in results.METRICS}}
    assert judge(order, vague, 50).outcome == "undecided"


def test_steps_may_be_read_in_two_ways():
    steps = claim("C2", "planar2")
    assert len(steps.readings) == 2
    over_all = {
        name: {"all": around(60), "steps": around(v)} for name, v in (("cacla", 35), ("cacla_var", 20), ("icac", 9))
    }
    assert judge(steps, ends(**over_all), 50).outcome == "reproduced"
    reached = {
        name: {"all": around(60), "steps_when_reached": around(v)}
        for name, v in (("cacla", 35), ("cacla_var", 20), ("icac", 9))
    }
    verdict = judge(steps, ends(**reached), 50)
    assert verdict.outcome == "reproduced"
    assert [part.outcome for part in verdict.readings[0]] == ["not reproduced"] * 3
    # Half in one reading, half in the other is neither.
    mixed = over_all | {"icac": {"all": around(60), "steps_when_reached": around(9)}}
    assert judge(steps, ends(**mixed), 50).outcome == "not reproduced"


def test_success_on_nico4():
    success = claim("C3", "nico4")

    def verdict(cacla, cacla_var, icac):
        rates = {"cacla": cacla, "cacla_var": cacla_var, "icac": icac}
        return judge(success, ends(**{n: {"all": around(rate, 0.01)} for n, rate in rates.items()}), 100).outcome

    assert verdict(0.55, 0.6, 0.95) == "reproduced"
    assert verdict(0.55, 0.88, 0.95) == "not reproduced"
    assert verdict(0.55, 0.6, 0.85) == "not reproduced"


def test_the_papers_numbers():
    """Sec. IV.A and IV.B, word for word in the claims."""
    assert claims.paper_marks("planar2", "steps") == {"cacla": 35, "cacla_var": 20, "icac": 10}
    assert claims.paper_marks("nico4", "steps") == {"cacla": 30, "cacla_var": 20, "icac": 5}
    assert claims.paper_marks("nico4", "success_rate") == {"cacla": 0.6, "cacla_var": 0.6, "icac": 0.9}
    assert claims.paper_marks("planar2", "extrinsic_reward") == {}
    assert [(c.id, c.arm) for c in CLAIMS] == [
        *[("C1", "planar2"), ("C2", "planar2"), ("C9", "planar2"), ("C9a", "planar2"), ("C9b", "planar2")],
        *[("C10", "planar2"), ("C11", "planar2")],
        *[("C3", "nico4"), ("C4", "nico4"), ("C9", "nico4"), ("C9a", "nico4"), ("C9b", "nico4")],
        *[("C10", "nico4"), ("C11", "nico4")],
    ]
    with pytest.raises(dataclasses.FrozenInstanceError):
        CLAIMS[0].text = "something easier"


def test_the_speed_of_learning():
    """Quick at first and slow at the end is faster over all episodes, and the other way round."""
    early, late = np.zeros((20, 100)), np.zeros((20, 100))
    early[:, 5:60], late[:, 60:] = 1, 1
    made = {"icac": result("icac", late), "cacla_var": result("cacla_var", early), "cacla": result("cacla", 0 * early)}
    figures = {name: results.judged(run) for name, run in made.items()}
    horizon = made["icac"].settings.params.horizon
    assert np.all(figures["cacla"]["steps_all_episodes"] == horizon)
    assert figures["icac"]["steps_first_tenth"].mean() == horizon > figures["cacla_var"]["steps_first_tenth"].mean()
    assert figures["icac"]["steps"].mean() < horizon == figures["cacla_var"]["steps"].mean()
    assert judge(claim("C10", "planar2"), figures, 50).outcome == "not reproduced"
    assert judge(claim("C11", "nico4"), figures, 100).outcome == "reproduced"
    swapped = figures | {"icac": figures["cacla_var"], "cacla_var": figures["icac"]}
    assert judge(claim("C10", "nico4"), swapped, 100).outcome == "reproduced"


@pytest.mark.parametrize(
    ("part", "spread", "allowance"),
    [(AT_MOST, 6, 2.5), (AT_LEAST, 2.5, 0.05), (ABOUT, 60, 2.5)],
)
def test_as_many_seeds_as_it_takes(part, spread, allowance):
    """With the mean and the spread of the seeds as they are, that many decide, and a third of that many do not."""
    centre = part.value if part.bound == "about" else part.value * 0.9

    def judged(seeds):
        draws = around(0, seeds=seeds)
        return judge_value(part, centre + spread * draws / draws.std(), allowance)

    found = judged(20)
    assert found.outcome == "undecided"
    needed = power.seeds_needed(found, 20, allowance)
    assert needed > 40
    assert judged(round(1.3 * needed)).outcome != "undecided"
    assert judged(needed // 3).outcome == "undecided"


def test_what_it_would_take_is_said_of_the_undecided_alone():
    speed = claim("C11", "planar2")

    def said(icac, seeds=20):
        figures = ends(cacla_var={"all": around(30, 6, seeds)}, icac={"all": np.roll(around(icac, 6, seeds), 3)})
        return power.sentences(judge(speed, figures, 50), seeds, 50)

    assert said(60) == []
    (line,) = said(32)
    assert line.startswith("C11 planar2, CACLA+Var better than ICAC: 20 seeds do not decide; about ")
    (line,) = said(32.5)  # as far apart as the tolerance, and no more
    assert "would, if the means stay" in line
    assert said(32, seeds=4) == []


def test_from_episodes_to_a_verdict_as_json():
    rng = np.random.default_rng(1)
    made = {n: result(n, rng.random((8, 100)) < rate) for n, rate in (("icac", 0.9), ("icac-single_predictor", 0.2))}
    verdict = judge(claim("C9", "planar2"), {n: results.last_tenth(run) for n, run in made.items()}, 50, 6.5)
    assert verdict.outcome == "reproduced"
    facts = json.loads(json.dumps(verdicts.as_json(verdict), allow_nan=False))
    assert facts["verdict"] == "reproduced"
    assert facts["oracle_steps"] == 6.5
    (part,) = facts["readings"][0]
    assert part["improvement"]["low"] > 0.5
    assert part["difference"]["value"] > 10
    never = {n: {m: np.full(8, np.nan) for m in results.METRICS} for n in made}
    empty = verdicts.as_json(judge(claim("C9", "planar2"), never, 50))
    assert empty["verdict"] == "undecided"
    json.dumps(empty, allow_nan=False)
