"""What is plotted, read back from the axes and compared with hand-made tables."""

import subprocess
import sys

import numpy as np
import pytest

from icac_jax.paper import figures
from icac_jax.reports import curves, results, statistics
from icac_jax.reports.figures import save
from tests.tables_by_hand import result

EPISODES = 40  # blocks of four


def three(arm="planar2"):
    rng = np.random.default_rng(0)
    made = {}
    for name, rate in (("cacla", 0.3), ("cacla_var", 0.6), ("icac", 0.9)):
        reached = rng.random((6, EPISODES)) < rate
        steps = np.where(reached, rng.integers(3, 20, reached.shape), 50)
        progress, error = rng.random((2, *reached.shape))
        made[name] = result(
            *(name, reached, steps, arm),
            learning_progress=steps * 0.01 * progress,
            perception_error=steps * error,
            intrinsic_reward=steps * (0.01 * progress + error),
            live_nodes=2 + np.arange(EPISODES) // 3,
        )
    return made


def curve(axes, label):
    (line,) = [line for line in axes.lines if line.get_label() == label]
    return np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)


def by_hand(values):
    """[S, E] to means over blocks of four episodes, then over seeds."""
    return np.nanmean(np.nanmean(values.reshape(len(values), -1, 4), axis=2), axis=0)


DRAWN = [
    (figures.reward, "extrinsic_reward"),
    (figures.steps, "steps"),
    (figures.steps_when_reached, "steps_when_reached"),
    (figures.success, "reached"),
]


@pytest.mark.filterwarnings("ignore:Mean of empty slice")
@pytest.mark.parametrize(("draw", "column"), DRAWN, ids=[column for _, column in DRAWN])
def test_curves(draw, column):
    made = three()
    (axes,) = draw(list(made.values())).axes
    for name, title in (("cacla", "CACLA"), ("cacla_var", "CACLA+Var"), ("icac", "ICAC")):
        x, y = curve(axes, title)
        reached = results.by_seed(made[name], "reached")
        values = results.by_seed(made[name], column if column != "steps_when_reached" else "steps")
        if column == "steps_when_reached":
            values = np.where(reached == 1, values, np.nan)
        np.testing.assert_array_equal(x, np.arange(4, EPISODES + 1, 4))
        np.testing.assert_allclose(y, by_hand(values), rtol=1e-6)
    styles = {(line.get_color(), line.get_linestyle(), line.get_marker()) for line in axes.lines[:3]}
    assert len({colour for colour, _, _ in styles}) == len({marker for _, _, marker in styles}) == 3


def test_bands_are_the_bootstrap_intervals():
    made = three()["icac"]
    (axes,) = figures.success([made]).axes
    corners = axes.collections[0].get_paths()[0].vertices
    _, means = curves.blocks(made, results.by_seed(made, "reached"))
    band = statistics.band(means)
    for place, x in enumerate(np.arange(4, EPISODES + 1, 4)):
        there = corners[corners[:, 0] == x, 1]
        assert (there.min(), there.max()) == pytest.approx((band.low[place], band.high[place]))


def test_the_oracle_and_the_papers_values_are_marked():
    for arm, ends in (("planar2", {35, 20, 10}), ("nico4", {30, 20, 5})):
        for draw in (figures.steps, figures.steps_when_reached):
            (axes,) = draw(list(three(arm).values())).axes
            assert set(curve(axes, "oracle, 6.0")[1]) == {6.0}
            hollow = [line for line in axes.lines if line.get_markerfacecolor() == "white" and len(line.get_ydata())]
            assert {float(line.get_ydata()[0]) for line in hollow} == ends
            assert axes.get_ylim()[1] > max(ends)
    (axes,) = figures.reward(list(three("nico4").values())).axes
    hollow = [line for line in axes.lines if line.get_markerfacecolor() == "white" and len(line.get_ydata())]
    assert sorted(float(line.get_ydata()[0]) for line in hollow) == [60, 60, 90]


def test_every_seed_is_seen():
    made = three()
    panels = figures.seeds(list(made.values())).axes
    for axes, run in zip(panels, made.values(), strict=False):
        _, means = curves.blocks(run, results.by_seed(run, "reached"))
        for line, mean in zip(axes.lines[:6], means, strict=True):
            np.testing.assert_allclose(line.get_ydata(), mean)
    for number, run in enumerate(made.values()):
        dots = panels[-1].lines[2 * number].get_ydata()
        np.testing.assert_allclose(dots, results.last_tenth(run)["success_rate"])


def test_of_many_seeds_it_is_seen_where_half_and_nine_tenths_of_them_lie():
    reached = np.random.default_rng(0).random((60, EPISODES)) < 0.5
    panel = figures.seeds([result("icac", reached, np.where(reached, 7, 50))]).axes[0]
    assert len(panel.lines) == 1  # the mean
    broad, middle = (band.get_paths()[0].vertices[:, 1] for band in panel.collections)
    first = reached[:, :4].mean(axis=1)
    assert {np.percentile(first, 5), np.percentile(first, 95)} <= set(broad)
    assert {np.percentile(first, 25), np.percentile(first, 75)} <= set(middle)


def test_nodes_and_intrinsic_reward():
    run = three()["icac"]
    (axes,) = figures.nodes([run]).axes
    np.testing.assert_allclose(curve(axes, "ICAC")[1], by_hand(results.by_seed(run, "live_nodes")))
    (axes,) = figures.intrinsic(run).axes
    a_step = {name: results.by_seed(run, name) for name in ("learning_progress", "perception_error", "steps")}
    for name in ("learning_progress", "perception_error"):
        _, y = curve(axes, name.replace("_", " "))
        np.testing.assert_allclose(y, by_hand(a_step[name] / a_step["steps"]), rtol=1e-6)


def test_the_papers_block_lengths_and_shorter_ones():
    def length(arm, episodes):
        return curves.block_length(result("cacla", np.ones((1, episodes)), arm=arm))

    assert [length("planar2", 1000), length("nico4", 15000)] == [20, 300]
    assert [length("planar2", 100), length("planar2", 5)] == [10, 1]


def test_all_figures_are_written_twice_and_always_the_same(tmp_path):
    made = three() | {"icac-single_predictor": result("icac-single_predictor", np.ones((6, EPISODES)))}
    drawings = figures.all_of(made)
    names = ["reward", "steps", "steps_when_reached", "success", "seeds", "nodes", "intrinsic", "ablations"]
    assert [drawing.name for drawing in drawings] == names
    for drawing in (drawings[0], drawings[4]):
        for place in ("a", "b"):
            save(drawing.figure, tmp_path / place)
        assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
        for suffix in (".png", ".svg"):
            assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_seeds_without_a_figure_and_a_run_of_one_episode():
    """Nothing ever reached: no steps when reached anywhere. A warning would fail the test."""
    for episodes in (1, 12):
        none = result("icac", np.zeros((2, episodes)))
        for drawing in figures.all_of({"icac": none}):
            drawing.figure.canvas.draw()


def test_training_does_not_load_matplotlib():
    code = "import sys, icac_jax.runs.train; assert 'matplotlib' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
