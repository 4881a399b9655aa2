"""Statistics over seeds against hand-computed values and known answers."""

import numpy as np
import pytest

from icac_jax.reports import statistics
from icac_jax.reports.statistics import estimate, iqm, probability_of_improvement


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


def test_a_band_is_the_estimate_at_each_place():
    curves = np.random.default_rng(2).normal([0, 5, 10], 1, (20, 3))
    curves[:5, 1] = np.nan
    curves[:, 2] = np.nan
    band = statistics.band(curves)
    one = estimate(curves[:, 0], "mean")
    np.testing.assert_allclose([band.value[0], band.low[0], band.high[0]], one, atol=0.05)
    part = estimate(curves[:, 1], "mean")
    np.testing.assert_allclose([band.value[1], band.low[1], band.high[1]], part, atol=0.1)
    assert np.isnan([band.value[2], band.low[2], band.high[2]]).all()


def test_paired_difference_by_hand():
    found = statistics.paired_difference(np.array([3.0, 5.0, np.nan]), np.array([1.0, 2.0, 9.0]))
    assert found.value == 2.5
    assert (found.low, found.high) == (2.0, 3.0)


@pytest.mark.filterwarnings("ignore")
def test_against_rliable():
    """The reference implementation of Agarwal et al. 2021; scores are [runs, tasks], one task here."""
    pytest.importorskip("rliable")
    from rliable import library, metrics

    rng = np.random.default_rng(3)
    first, second = rng.normal(1, 1, (20, 1)), rng.normal(0.3, 1, (20, 1))
    assert iqm(first[:, 0]) == pytest.approx(metrics.aggregate_iqm(first))
    ours = probability_of_improvement(first[:, 0], second[:, 0])
    assert ours.value == pytest.approx(metrics.probability_of_improvement(first, second))
    points, intervals = library.get_interval_estimates(
        {"a": first},
        lambda scores: np.array([metrics.aggregate_iqm(scores), metrics.aggregate_mean(scores)]),
        reps=5000,
    )
    for place, name in enumerate(("iqm", "mean")):
        found = estimate(first[:, 0], name)
        assert found.value == pytest.approx(points["a"][place])
        np.testing.assert_allclose([found.low, found.high], intervals["a"][:, place], atol=0.05)
    _, both = library.get_interval_estimates(
        {"pair": (first, second)}, lambda x, y: np.array([metrics.probability_of_improvement(x, y)]), reps=3000
    )
    np.testing.assert_allclose([ours.low, ours.high], both["pair"][:, 0], atol=0.03)


def test_resamples_that_are_kept_give_what_fresh_ones_give():
    """Cells of a sweep share resamples: each figure is that of its own seeds, whatever was asked before."""
    rng = np.random.default_rng(3)
    ends = [(1 - statistics.CONFIDENCE) / 2, (1 + statistics.CONFIDENCE) / 2]
    for number in (20, 7, 20, 3):  # 20 comes back, once from what was kept
        values, curves = rng.normal(size=number), rng.normal(size=(number, 4))
        curves[0, 1] = np.nan
        drawn = values[np.random.default_rng(0).integers(number, size=(statistics.RESAMPLES, number))].mean(axis=1)
        found = statistics.estimate(values, "mean")
        # All resamples are one product, whose sums have another order.
        np.testing.assert_allclose([found.low, found.high], np.quantile(drawn, ends), rtol=1e-13, atol=1e-15)
        times = np.random.default_rng(0).multinomial(number, np.full(number, 1 / number), size=statistics.RESAMPLES)
        known = ~np.isnan(curves)
        with np.errstate(invalid="ignore"):
            means = (times @ np.where(known, curves, 0.0)) / (times @ known)
        band = statistics.band(curves)
        np.testing.assert_array_equal([band.low, band.high], np.nanquantile(means, ends, axis=0))
