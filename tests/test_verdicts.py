"""Verdicts on made-up tables of cells: each outcome, both ways, and what is compared with what."""

import json

import numpy as np
import pytest

from icac_jax.sweeps import verdicts


def row(number, varied, steps, success=0.9, seeds=20):
    """A row whose figures spread evenly over seeds, so that equal spreads cancel in paired differences."""
    spread = np.linspace(-1, 1, seeds)
    by_seed = {"steps": list(steps + 5 * spread), "success_rate": list(success + 0.05 * spread)}
    name = " ".join(f"{key}={value}" for key, value in varied.items())
    return {"cell": number, "name": name, "varied": varied, "by_seed": by_seed}


def noisy(made, metric, width):
    """The row with noise of its own over seeds."""
    noise = np.random.default_rng(made["cell"]).normal(0, width, len(made["by_seed"][metric]))
    values = np.array(made["by_seed"][metric]) + noise - noise.mean()
    return made | {"by_seed": made["by_seed"] | {metric: list(values)}}


REFERENCE = row(0, {"gamma": 0.9}, 20.0)


@pytest.mark.parametrize(
    ("steps", "success", "no_difference", "no_gain"),
    [
        (21.0, 0.88, "reproduced", "reproduced"),
        (17.0, 0.9, "not reproduced", "not reproduced"),
        (23.0, 0.9, "not reproduced", "reproduced"),
        (20.0, 0.96, "not reproduced", "not reproduced"),
        (20.0, 0.84, "not reproduced", "reproduced"),
    ],
)
def test_clear_differences(steps, success, no_difference, no_gain):
    rows = [REFERENCE, row(1, {"gamma": 0.8}, steps, success)]
    for expect, outcome in (("no_difference", no_difference), ("no_gain", no_gain)):
        verdict = verdicts.judge(rows, expect, {"gamma": 0.9})
        assert verdict.outcome == outcome
        assert [one.metric for one in verdict.comparisons] == ["success_rate", "steps"]
        assert verdict.comparisons[1].difference.value == pytest.approx(steps - 20)


def test_noise_makes_it_undecided():
    """The interval reaches over the tolerance on the side that counts."""
    for steps, outcomes in ((17.6, ("undecided", "undecided")), (22.4, ("undecided", "reproduced"))):
        rows = [REFERENCE, noisy(row(1, {"gamma": 0.8}, steps), "steps", 3.0)]
        for expect, outcome in zip(("no_difference", "no_gain"), outcomes, strict=True):
            assert verdicts.judge(rows, expect, {"gamma": 0.9}).outcome == outcome


def test_one_cell_that_contradicts_is_enough_and_one_undecided_too():
    clear, unclear, against = (
        row(1, {"gamma": 0.8}, 20.5),
        noisy(row(2, {"gamma": 0.85}, 17.6), "steps", 3.0),
        row(3, {"gamma": 0.99}, 30.0),
    )
    for rows, outcome in (
        ([clear], "reproduced"),
        ([clear, unclear], "undecided"),
        ([clear, unclear, against], "not reproduced"),
    ):
        assert verdicts.judge([REFERENCE, *rows], "no_difference", {"gamma": 0.9}).outcome == outcome


def test_other_options_are_held_equal():
    """ICAC is far better than CACLA, which is no difference between discount factors."""
    rows = [
        row(place, {"algo": algo, "gamma": gamma}, steps)
        for place, (algo, gamma, steps) in enumerate(
            [("cacla", 0.8, 30.0), ("cacla", 0.9, 30.5), ("icac", 0.8, 8.0), ("icac", 0.9, 8.5)]
        )
    ]
    verdict = verdicts.judge(rows, "no_difference", {"gamma": 0.9})
    assert verdict.outcome == "reproduced"
    assert {(one.cell, one.reference) for one in verdict.comparisons} == {(0, 1), (2, 3)}


def test_few_seeds_lost_seeds_and_no_pairs():
    few = [row(0, {"gamma": 0.9}, 20.0, seeds=4), row(1, {"gamma": 0.8}, 40.0, seeds=4)]
    lost = row(1, {"gamma": 0.8}, 40.0)
    lost = lost | {"by_seed": {name: [None] * 16 + values[16:] for name, values in lost["by_seed"].items()}}
    for rows in (few, [REFERENCE, lost], [REFERENCE, row(1, {"gamma": 0.8}, 40.0, seeds=19)], [REFERENCE]):
        verdict = verdicts.judge(rows, "no_difference", {"gamma": 0.9})
        assert verdict.outcome == "undecided"
        json.dumps(verdicts.as_json(verdict), allow_nan=False)


def test_lists_are_the_same_before_and_after_they_were_written():
    rows = [row(0, {"joint_low": (0.0, 1.0)}, 20.0), row(1, {"joint_low": (0.0, 2.0)}, 20.1)]
    for some in (rows, json.loads(json.dumps(rows))):
        verdict = verdicts.judge(some, "no_difference", {"joint_low": (0.0, 1.0)})
        assert (verdict.outcome, len(verdict.comparisons)) == ("reproduced", 2)


def test_in_words():
    rows = [REFERENCE, row(1, {"gamma": 0.8}, 20.1), row(2, {"gamma": 0.99}, 27.0)]
    said = verdicts.as_text(verdicts.judge(rows, "no_difference", {"gamma": 0.9}))
    assert said.splitlines() == [
        "verdict: NOT REPRODUCED (no difference expected against gamma 0.9): of 2 cells 1 agree, 0 undecided, 1 not",
        "  contradicts: gamma=0.99, steps +7.00 [+7.00, +7.00]",
    ]
