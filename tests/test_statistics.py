"""Statistics over seeds against hand-computed values and known answers."""

import numpy as np
import pytest

from icac_jax.experiment import statistics
from icac_jax.experiment.statistics import estimate, iqm, probability_of_improvement


def test_interquartile_mean_by_hand():
    assert iqm(np.array([100.0, 1, 2, 3, 4, 5, 6, -50])) == pytest.approx(3.5)  # the middle half is 2, 3, 4, 5
    np.testing.assert_allclose(iqm(np.arange(8.0).reshape(2, 4)), [1.5, 5.5])


def test_estimate_by_hand():
    assert estimate(np.array([3.0, 3.0, 3.0])) == (3.0, 3.0, 3.0)
    assert estimate(np.array([1.0, 2.0, 6.0, np.nan]), "mean").value == 3.0
    assert np.isnan(estimate(np.array([np.nan])).value)


def test_mean_interval_covers_as_often_as_it_says():
    """400 samples of 20 seeds from a known distribution: a percentile bootstrap covers a little under 95 %."""
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(400):
        _, low, high = estimate(rng.normal(10, 2, 20), "mean", seed=int(rng.integers(1000)))
        covered += low <= 10 <= high
    assert 0.88 <= covered / 400 <= 0.97


def test_mean_interval_is_the_textbook_one():
    values = np.random.default_rng(1).normal(0, 1, 200)
    _, low, high = estimate(values, "mean")
    error = values.std() / np.sqrt(200)
    np.testing.assert_allclose([low, high], values.mean() + np.array([-1.96, 1.96]) * error, atol=0.3 * error)


def test_probability_of_improvement_by_hand():
    # Pairs: 3 > 1, 3 > 2, 2 > 1, and 2 = 2 counts half: 3.5 of 4.
    assert probability_of_improvement(np.array([3.0, 2.0]), np.array([1.0, 2.0])).value == pytest.approx(0.875)
    same = np.arange(10.0)
    assert probability_of_improvement(same, same).value == pytest.approx(0.5)
    sure = probability_of_improvement(same + 100, same)
    assert sure == (1.0, 1.0, 1.0)
    _, low, high = probability_of_improvement(same, same)
    assert low < 0.5 < high


def test_an_estimate_prints_its_interval():
    assert str(statistics.Estimate(0.93612, 0.9, 0.95)) == "0.936 [0.9, 0.95]"
