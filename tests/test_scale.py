"""Large studies are put together and read some cells at a time: the same numbers, whatever fits into memory."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy import stats

from icac_jax.errors import DamagedError
from icac_jax.reports import statistics
from icac_jax.runs import store
from icac_jax.sweeps import collect, recorded, stages
from tests.scale import untrained

TWO_PROGRAMS = """claim = "Two programs whose cells take turns"
[base]
arm = "planar2"
seeds = 4
episodes = 30
[grid]
gamma = [0.5, 0.9, 0.95]
algo = ["cacla", "icac"]
"""


@pytest.fixture(scope="module", params=["all at once", "a few rows at a time"])
def gathered(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep") / "sweep"
    with pytest.MonkeyPatch.context() as patch:
        if request.param != "all at once":
            patch.setattr(collect, "_ROWS_AT_ONCE", 100)
            patch.setattr(collect, "_ROWS_WRITTEN", 150)
            patch.setattr(store, "_ROWS_AT_ONCE", 70)
        chosen, batch = untrained(folder, TWO_PROGRAMS)
        collect.gather(chosen, [batch], folder, 0.0)
    return chosen, batch, folder


def test_the_numbers_are_the_same_whatever_is_in_memory(gathered):
    _, batch, folder = gathered
    table = pq.read_table(folder / "episodes.parquet")
    assert table.num_rows == 6 * 4 * 30 - 2  # in each program one seed diverged before its last episode
    order = np.stack([table[name].to_numpy() for name in ("cell", "seed", "episode")], axis=1).tolist()
    assert order == sorted(order)
    for cell in batch.cells:
        (group,) = (one for one in batch.groups if cell in one.cells)
        first = 4 * group.cells.index(cell)
        theirs = pq.read_table(batch.place(group) / "episodes.parquet")
        mine = np.isin(theirs["seed"].to_numpy(), np.arange(first, first + 4))
        there = table.filter(np.equal(table["cell"].to_numpy(), cell.number))
        for name in theirs.column_names:
            expected = theirs[name].to_numpy()[mine] - (first if name == "seed" else 0)
            np.testing.assert_array_equal(there[name].to_numpy(), expected, err_msg=name)
        assert there["live_nodes"].null_count == (0 if cell.settings.algo == "icac" else there.num_rows)


def test_a_row_of_figures_is_that_of_its_episodes(gathered):
    _, _, folder = gathered
    rows = stages.trained(folder)["cells"]
    table = pq.read_table(folder / "episodes.parquet").to_pandas()
    assert [row["cell"] for row in rows] == list(range(6))
    for row in rows:
        last = table[(table["cell"] == row["cell"]) & (table["episode"] >= 27)]
        reached = last.groupby("seed")["reached"].sum() / 3  # who diverged did not reach what it did not get to
        assert row["by_seed"]["success_rate"] == pytest.approx(reached.tolist())
        assert row["success_rate_iqm"] == pytest.approx(stats.trim_mean(reached, 0.25))
        assert row["failed_lanes"] == (row["cell"] in (0, 1))
    assert (folder / "summary.json").read_text().count("\n    {") == 6  # a line per cell
    assert json.loads((folder / "summary.json").read_text())["lanes_trained"] == 24


def test_cells_are_read_in_any_order(gathered):
    chosen, batch, folder = gathered
    rows = stages.trained(folder)["cells"]
    found = recorded.of_table(chosen, rows, folder)
    table = pq.read_table(folder / "episodes.parquet")
    assert len(found) == 6
    for place in (5, 0, 3, -1):
        result = found[place]
        number = batch.cells[place].number
        there = table.filter(np.equal(table["cell"].to_numpy(), number))
        assert result.settings == batch.cells[place].settings
        np.testing.assert_array_equal(result.table["steps"].to_numpy(), there["steps"].to_numpy())
        assert ("live_nodes" in result.table.column_names) == (result.settings.algo == "icac")
        assert result.summary["failed_seeds"] == ({"0": 29} if number in (0, 1) else {})
    assert [one.name for one in found] == [one.name for one in found[:]]
    with pytest.raises(IndexError):
        found[6]
    with pytest.raises(DamagedError, match="other episodes than the summary says"):
        recorded.of_table(chosen, [*rows[1:], rows[0]], folder)[0]
    with pytest.raises(DamagedError, match="it has cells that the summary has not"):
        recorded.of_table(chosen, rows[:-1], folder)
    with pytest.raises(DamagedError, match="cell 4 has other episodes than the summary says"):
        recorded.of_table(chosen, [*rows[:4], rows[4] | {"episodes_done": 99}, rows[5]], folder)


@pytest.mark.parametrize("statistic", ["iqm", "mean"])
def test_an_interval_is_that_of_resamples(statistic):
    rng = np.random.default_rng(1)
    values = np.append(rng.normal(size=22), np.nan)
    found = statistics.estimate(values, statistic)
    known = np.sort(values[:-1])
    drawn = known[np.random.default_rng(0).integers(22, size=(statistics.RESAMPLES, 22))]
    expected = stats.trim_mean(drawn, 0.25, axis=1) if statistic == "iqm" else drawn.mean(axis=1)
    assert found.value == pytest.approx(stats.trim_mean(known, 0.25) if statistic == "iqm" else known.mean())
    if statistic == "iqm":
        assert found[1:] == pytest.approx(np.quantile(expected, [0.025, 0.975]))
    else:  # resamples of other places, so equal but for their noise
        assert found[1:] == pytest.approx(np.quantile(expected, [0.025, 0.975]), abs=0.02)
