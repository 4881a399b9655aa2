"""Results by seed, read from hand-made tables."""

import numpy as np
import pytest

from icac_jax.fields import ConfigError
from icac_jax.reports import results
from icac_jax.runs import summary
from tests.tables_by_hand import result, write


def test_by_seed_puts_each_episode_in_its_place(tmp_path):
    steps = np.arange(1, 13).reshape(3, 4)
    made = result("cacla", np.ones((3, 4)), steps, failed=[(1, 2)])
    write(made, tmp_path / "run")
    read = results.read(tmp_path / "run")
    assert read.name == "cacla"
    assert results.read(tmp_path / "run", "mine").name == "mine"
    expected = steps.astype(float)
    expected[1, 2:] = np.nan
    np.testing.assert_array_equal(results.by_seed(read, "steps"), expected)
    assert read.summary["failed_seeds"] == {"1": 2}


def test_last_tenth_by_hand():
    """30 episodes: the last three count. Seed 2 never reaches; seed 3 failed after 28, so two of its three are lost."""
    reached = np.zeros((4, 30), bool)
    steps = np.full((4, 30), 50)
    reached[0, 27:], steps[0, 27:] = [True, True, True], [4, 5, 9]
    reached[1, 27:], steps[1, 27:] = [True, False, False], [8, 50, 50]
    reached[:, :27], steps[:, :27] = True, 1  # does not count
    reached[3, 27], steps[3, 27] = True, 10
    made = result("cacla", reached, steps, failed=[(3, 28)])
    ends = results.last_tenth(made)
    np.testing.assert_allclose(ends["success_rate"], [1, 1 / 3, 0, 1 / 3])
    np.testing.assert_allclose(ends["steps"], [6, 36, 50, 110 / 3])
    np.testing.assert_allclose(ends["steps_when_reached"], [6, 8, np.nan, 10])
    np.testing.assert_allclose(ends["extrinsic_reward"], [50, 50 / 3, 0, 50 / 3])
    # The summary of the run says the same.
    for seed, part in made.summary["last_tenth_by_seed"].items():
        assert part["success_rate"] == pytest.approx(ends["success_rate"][int(seed)])
        assert part["steps"] == pytest.approx(ends["steps"][int(seed)])


def test_episodes_to_come_are_not_failures():
    made = result("cacla", np.ones((1, 20)), failed=[(0, 5)])
    stopped = made._replace(summary={})  # no summary yet: the run was stopped, nothing failed
    assert np.isnan(results.last_tenth(stopped)["success_rate"]).all()
    assert results.last_tenth(made)["success_rate"] == [0]


def test_a_run_that_is_not_over_is_named(tmp_path):
    write(result("cacla", np.ones((1, 2))), tmp_path / "run")
    (tmp_path / "run" / "episodes.parquet").unlink()
    with pytest.raises(ConfigError, match=r"run: .* has no episodes.parquet yet"):
        results.read(tmp_path / "run")
    with pytest.raises(ConfigError, match="holds no run"):
        results.read(tmp_path)


def test_the_summary_has_the_oracle():
    made = result("icac", np.ones((2, 10)), np.full((2, 10), 9), oracle_steps=6.0)
    assert made.summary["oracle_steps"] == 6.0
    assert made.summary["steps_over_oracle"] == pytest.approx(1.5)
    assert "steps / oracle 1.50" in summary.as_text(made.summary)
    unknown = result("icac", np.ones((2, 10)), oracle_steps=None).summary
    assert unknown["steps_over_oracle"] is None
    assert "oracle" not in summary.as_text(unknown)
