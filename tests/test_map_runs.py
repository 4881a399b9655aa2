"""Runs with each map: exact in resume, drawn, swept; and the studies of maps say what was put into them."""

import importlib.util
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from icac_jax.curiosity import maps
from icac_jax.errors import ConfigError
from icac_jax.policies import map_picture, saved
from icac_jax.reports.statistics import Estimate
from icac_jax.sweeps import sweep_file
from tests.conftest import here

TINY = ["--physics", "kinematic", "--seeds", "2", "--horizon", "10", "--no-report", "--gamma", "0.8"]
MAPS = {
    "gng": ["--map", "gng", "--map-capacity", "16", "--gng-interval", "5"],
    "som": ["--map", "som", "--som-side", "3"],
    "grid": ["--map", "grid", "--grid-side", "3"],
}


@pytest.fixture(scope="module", params=MAPS)
def run(request, tmp_path_factory):
    """The kind of map, and a run of 6 episodes with it."""
    folder = tmp_path_factory.mktemp(request.param) / "run"
    done = here("train", *TINY, *MAPS[request.param], "--episodes", 6, "--out", folder)
    assert done.returncode == 0, done.stderr
    return request.param, folder


def test_resumed_and_made_longer_to_the_same_bits(run, tmp_path):
    kind, folder = run
    half = tmp_path / "half"
    assert here("train", *TINY, *MAPS[kind], "--episodes", 3, "--out", half).returncode == 0
    assert here("resume", half, "--episodes", 6).returncode == 0
    whole = pq.read_table(folder / "episodes.parquet")
    assert pq.read_table(half / "episodes.parquet").equals(whole)
    nodes = whole["live_nodes"].to_numpy()
    assert (nodes.min(), nodes.max()) == (9, 9) if kind == "som" else nodes.max() > nodes.min()


def test_drawn(run):
    kind, folder = run
    done = here("plot-map", folder, "--seed", 0)
    assert done.returncode == 0, done.stderr
    assert (folder / "map-seed-0.png").stat().st_size > 10_000
    found = map_picture.nodes(saved.pick(folder, "0"))
    assert len(found.joints) == {"som": 9}.get(kind, len(found.joints)) >= 3
    assert len(found.edges) >= 2
    assert found.queries.sum() > 20
    if kind == "grid":  # centres of cells between 0 and 180 degrees
        assert set(np.rint(np.asarray(found.joints)).ravel().tolist()) <= {30, 90, 150}


def test_a_sweep_may_vary_the_map_and_each_map_takes_its_own_options():
    text = '[base]\ne_max = 0.5\ngng_interval = 7\n[grid]\nmap = ["itm", "gng"]\n'
    itm, gas = (cell.settings for cell in sweep_file.parse(text).cells())
    assert (itm.spec.map, itm.flat()["e_max"]) == ("itm", 0.5)
    assert (gas.spec.map, gas.hyper.gng_interval) == ("gng", 7)
    assert "e_max" not in gas.flat()
    for wrong in ('[base]\nmap = "gng"\ne_max = 0.5\n', '[base]\nmap = "gng"\n[grid]\ne_max = [0.4, 0.5]\n'):
        with pytest.raises(ConfigError, match="e_max: no option of the map gng, only of itm"):
            sweep_file.parse(wrong)


def example(name):
    path = Path(__file__).resolve().parents[1] / "examples" / "maps" / f"{name}.py"
    found = importlib.util.spec_from_file_location(f"maps_{name}", path)
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def made_up(scaling, power, late=0.0, size=2):
    """Rows of maps whose nodes go with a power of the volume, of which a share came late."""
    return [
        {"map": name, "dimensions": size, "stimuli": kind, "volume": volume, "seed": 0, "overflow": 0}
        | {"nodes": 200 * volume**power, "nodes_half": 200 * volume**power * (1 - late), "error": 0.5}
        for name in maps.MAPS
        for kind in scaling.KINDS
        for volume in scaling.VOLUMES
    ]


def test_the_rule_on_volume_and_time():
    scaling = example("scaling")
    times = [
        {"map": name, "dimensions": size, "microseconds": cost}
        for name, cost in {"itm": 8.0, "gng": 10.0, "som": 8.5, "grid": 1.0}.items()
        for size in scaling.TIMED_DIMENSIONS
    ]
    for power, late, word in ((1.0, 0.0, "holds"), (0.6, 0.0, "does not hold"), (1.0, 0.3, "not decided")):
        said = scaling.verdicts(made_up(scaling, power, late), times)
        assert f"Linear in the volume, uniform stimuli: **{word}**" in said[0]
    assert scaling.exponent(made_up(scaling, 0.6), map="itm", dimensions=2, stimuli="walk") == pytest.approx(0.6)
    both = made_up(scaling, 1.0) + made_up(scaling, 0.6, size=3)
    assert "**holds in some dimensions** (2-D yes, 3-D no)" in scaling.verdicts(both, times)[0]
    assert "Cheaper than growing neural gas: **holds**" in said[2]
    assert "Cheaper than self-organising map: **does not hold**" in said[3]
    sizes = [{"dimensions": 2, "nodes": 6.0, "nodes_half": 5.0, "full": 0}]
    table = scaling.markdown(made_up(scaling, 1.0), times, sizes)
    assert "| itm | 2 | uniform | 200 | 1.00 | 0% | 0.50 | – | – |" in table
    assert "| 2 | 6 | 20% | 0 |" in table


def test_boxes_have_the_volume_that_they_say():
    scaling = example("scaling")
    for kind in scaling.KINDS:
        points = scaling.stimuli_of(kind, 3, 0.125, 4000, 0)
        assert points.min() >= -1
        assert points.max() <= 0  # half as wide as [-1, 1] in each of three dimensions
        assert (points.max(axis=0) - points.min(axis=0) > 0.95).all()


def test_the_rule_on_warm_maps():
    warm = example("warm")
    words = [
        warm.decided(Estimate(*saved)) for saved in ((4, 1, 7), (-4, -7, -1), (0.5, -1, 2), (2, -4, 8), (1, 0.5, 3))
    ]
    assert words == ["helps", "harms", "makes no difference", "undecided", "undecided"]
    rng = np.random.default_rng(0)
    slow, fast = (rng.normal(centre, 1, (20, 40)) for centre in (30, 20))
    page = warm.markdown({"half": {"cold": slow, "same": fast, "other": slow + 0.1}})
    assert "| [0, 180] | map of the same range | no map | +10." in page
    assert page.count("**helps**") == 2
    assert page.count("**makes no difference**") == 1
