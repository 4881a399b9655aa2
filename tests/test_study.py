"""Sweep files: which cells they make, and one line about whatever is wrong with them."""

import math
from pathlib import Path

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from icac_jax.fields import ConfigError
from icac_jax.settings.options import all_options
from icac_jax.sweeps import study, sweep_file
from icac_jax.sweeps.distributions import Distribution

SHIPPED = sorted((Path(__file__).resolve().parents[1] / "sweeps").glob("*.toml"))
CLAIM = 'claim = "c"\n'
# Their questions are about many readings, each of three algorithms.
LARGE = {"readings": 3 * 1008, "readings_numbers": 3 * 1000, "readings_nico4": 3 * 120}


def varied(text):
    return [cell.varied for cell in sweep_file.parse(CLAIM + text).cells()]


def test_grid_is_crossed_in_the_order_of_the_file():
    text = '[base]\nseeds = 3\n[grid]\nalgo = ["cacla", "icac"]\ngamma = [0, 0.5]\n'
    chosen = sweep_file.parse(CLAIM + text)
    cells = chosen.cells()
    pairs = [("cacla", 0.0), ("cacla", 0.5), ("icac", 0.0), ("icac", 0.5)]
    assert [(cell.settings.algo, cell.settings.hyper.gamma) for cell in cells] == pairs
    assert [cell.number for cell in cells] == [0, 1, 2, 3]
    assert cells[1].name == "algo=cacla gamma=0.5"
    assert {cell.settings.run.seeds for cell in cells} == {3}


def test_zip_goes_side_by_side_and_is_crossed_with_the_grid():
    text = "[zip]\njoint_low = [[0, 0], [-90, -90]]\njoint_high = [[90, 90], [90, 90]]\n[grid]\nsigma = [0.1, 0.2]\n"
    cells = varied(text)
    assert cells == [
        {"sigma": sigma, "joint_low": low, "joint_high": (90.0, 90.0)}
        for sigma in (0.1, 0.2)
        for low in ((0.0, 0.0), (-90.0, -90.0))
    ]


def test_a_preset_names_the_learner():
    (cell,) = sweep_file.parse(CLAIM + '[base]\npreset = "best"\ntau = 0.02\n').cells()
    assert (cell.settings.algo, cell.settings.hyper.tau) == ("td3", 0.02)
    cells = sweep_file.parse(CLAIM + '[base]\nmu = 30\n[grid]\npreset = ["paper", "best"]\n').cells()
    assert [cell.settings.algo for cell in cells] == ["icac", "td3"]
    with pytest.raises(ConfigError, match=r"\[base\] e_max: no option of td3"):
        sweep_file.parse(CLAIM + '[base]\npreset = "best"\ne_max = 0.5\n')


def test_a_file_without_tables_is_one_cell():
    (cell,) = sweep_file.parse(CLAIM).cells()
    assert (cell.varied, cell.name) == ({}, "base")


def test_random_draws_are_within_bounds_and_always_the_same():
    text = """[random]
draws = 200
seed = 3
gamma = {low = 0.5, high = 0.9}
actor_rate = {low = 1e-4, high = 1.0, log = true}
hidden_units = {low = 2, high = 4}
mu = {low = 20, high = 40, log = true}
optimizer = {choices = ["sgd", "adam"]}
joint_low = {choices = [[0, 0], [-90, -90]]}
"""
    cells = varied(text)
    assert cells == varied(text)
    assert cells != varied(text.replace("seed = 3", "seed = 4"))
    assert len(cells) == 200
    assert all(0.5 <= cell["gamma"] <= 0.9 and 20 <= cell["mu"] <= 40 for cell in cells)
    assert {cell["hidden_units"] for cell in cells} == {2, 3, 4}
    assert {cell["optimizer"] for cell in cells} == {"sgd", "adam"}
    # Uniform in the logarithm: half of the draws are below 0.01, uniform draws would put one in a hundred there.
    assert 70 < sum(cell["actor_rate"] < 0.01 for cell in cells) < 130


def test_every_algorithm_sees_the_same_random_draws():
    cells = varied('[grid]\nalgo = ["cacla", "icac"]\n[random]\ndraws = 3\ngamma = {low = 0.1, high = 0.9}\n')
    assert [cell["gamma"] for cell in cells[:3]] == [cell["gamma"] for cell in cells[3:]]


def test_search():
    chosen = sweep_file.parse(CLAIM + '[search]\nmetric = "success_rate"\ntrials = 6\nsigma = {low = 0.1, high = 2}\n')
    search = chosen.search
    assert (search.trials, search.batch, search.seed, search.metric) == (6, 8, 0, "success_rate")
    assert search.distributions == (Distribution("sigma", 0.1, 2.0, False, None),)


def test_reference_and_expectation():
    text = 'expect = "no_gain"\n[zip]\nactor_rate = [0.1, 1]\ncritic_rate = [1, 2]\n'
    text += "[grid]\nT = [5]\n[reference]\nactor_rate = 1\ncritic_rate = 2\n"
    chosen = sweep_file.parse(CLAIM + text)
    assert (chosen.expect, chosen.reference) == ("no_gain", {"actor_rate": 1.0, "critic_rate": 2.0})


BAD = [
    ("claim = ''", "claim: must be the claim or question in words, got ''"),
    ("claim = 3", "claim: must be the claim or question in words, got 3"),
    ("claim = ", "not valid TOML: "),
    (CLAIM + "[gird]\ngamma = [0.9]", "gird: no such table, must be one of claim, expect, reference, base, grid, zip,"),
    (CLAIM + "[gird]", "; did you mean grid?"),
    (CLAIM + "grid = [1]", "grid: must be a table, got [1]"),
    (CLAIM + "[base]\ngama = 0.9", "[base] gama: no such option; did you mean gamma?"),
    (CLAIM + '[base]\nseeds = "many"', "[base] seeds: must be a whole number at least 1 and at most 10000000, got 'm"),
    (CLAIM + '[base]\narm = "elbow"', "[base] arm: must be "),
    (CLAIM + "[base]\nmu = 10", "[base] T: must be at most mu = 10"),
    (CLAIM + "[grid]\ngama = [0.9]", "[grid] gama: no such option; did you mean gamma?"),
    (CLAIM + "[grid]\ngamma = []", "[grid] gamma: must be a list of at least one value, got []"),
    (CLAIM + "[grid]\ngamma = 0.9", "[grid] gamma: must be a list of at least one value, got 0.9"),
    (CLAIM + "[grid.gamma]\nlow = 1", "[grid] gamma: must be a list of at least one value, got {'low': 1}"),
    (CLAIM + '[grid]\ngamma = [0.9, "high"]', "[grid] gamma: must be a number at least 0 and less than 1, got 'high'"),
    (CLAIM + "[grid]\ngamma = [0.9, 1.1]", "[grid] gamma: must be a number at least 0 and less than 1, got 1.1"),
    (CLAIM + "[grid]\ngamma = [nan]", "[grid] gamma: must be a number at least 0 and less than 1, got nan"),
    (
        CLAIM + '[grid]\nalgo = ["icax"]',
        "[grid] algo: must be one of cacla, cacla_var, icac, ddpg, td3, curious_ddpg, curious_td3, got 'icax'",
    ),
    (CLAIM + "[grid]\nhidden_units = [12, 12.0]", "[grid] hidden_units: must be a whole number at least 1 and at most"),
    (CLAIM + "[grid]\nsigma = [1, 0.9, 1.0]", "[grid] sigma: must not hold a value twice, got 1 again"),
    (CLAIM + f"[grid]\njoint_low = [[0, {10**400}]]", "[grid] joint_low: must be a list of numbers"),
    (CLAIM + f"[grid]\ngamma = [0x{'f' * 5000}]", "a number has too many digits"),
    (CLAIM + "[zip]\nmu = [1, 2]\nT = [1]", "[zip] T: must have 2 values as mu has, got 1"),
    (CLAIM + "[zip]\nmu = []", "[zip] mu: must be a list of at least one value, got []"),
    (CLAIM + "[zip]\nmu = [1, 2.5]", "[zip] mu: must be a whole number at least 1, got 2.5"),
    (CLAIM + "[zip]\nnu = [1]", "[zip] nu: no such option"),
    (CLAIM + "[zip]\nmu = [50]\n[grid]\nmu = [60]", "mu: must be varied in one place only"),
    (CLAIM + "[base]\nmu = 50\n[grid]\nmu = [60]", "[base] mu: must be in one place, it is varied too"),
    (CLAIM + "[grid]\nmu = [20, 5]", "cell 1 (mu=5): T: must be at most mu = 5 (Eq. 10), got 20"),
    (CLAIM + '[grid]\narm = ["elbow"]', "cell 0 (arm=elbow): arm: must be "),
    (CLAIM + "[random]", "[random]: must name at least one option to draw"),
    (CLAIM + "[random]\ndraws = 0\nmu = {low = 1, high = 2}", "[random] draws: must be a whole number at least 1"),
    (CLAIM + "[random]\ndraws = 20000\nmu = {low = 1, high = 2}", "at most 10000, got 20000"),
    (CLAIM + "[random]\ndrwas = 5", "[random] drwas: no such option; did you mean draws?"),
    (CLAIM + "[random]\ngamma = [0.1, 0.9]", "[random] gamma: must be {low = L, high = H}, perhaps with log = true"),
    (CLAIM + "[random]\ngamma = {low = 0.1}", "[random] gamma: must be {low = L, high = H}"),
    (
        CLAIM + "[random]\ngamma = {low = 0.9, high = 0.1}",
        "[random] gamma: low must be less than high, got 0.9 and 0.1",
    ),
    (
        CLAIM + "[random]\ngamma = {low = 0.5, high = 1.5}",
        "[random] gamma: must be a number at least 0 and less than 1",
    ),
    (CLAIM + "[random]\ngamma = {low = 0, high = 0.9, log = true}", "low must be greater than 0 and less than high"),
    (CLAIM + "[random]\ngamma = {low = 0.1, high = 0.9, log = 1}", "[random] gamma: must be {low = L, high = H}"),
    (CLAIM + "[random]\ngamma = {low = 0.1, high = 1, step = 0.1}", "[random] gamma: must be {low = L, high = H}"),
    (CLAIM + "[random]\ngamma = {low = 0.1, high = 1, choices = [0]}", "or {choices = [...]}, got both"),
    (CLAIM + "[random]\nalgo = {low = 0, high = 1}", "the option is one of cacla, cacla_var, icac, ddpg, td3"),
    (CLAIM + "[random]\nperception_half_life = {low = 5, high = inf}", "[random] perception_half_life: must be {low ="),
    (CLAIM + "[random]\nalgo = {choices = []}", "[random] algo: must be a list of at least one value, got []"),
    (CLAIM + "[search]", "[search]: must name at least one option to draw"),
    (
        CLAIM + '[search]\nmetric = "joy"\nmu = {low = 1, high = 2}',
        "[search] metric: must be one of success_rate, steps",
    ),
    (CLAIM + "[search]\nbatch = true\nmu = {low = 1, high = 2}", "[search] batch: must be a whole number at least 1"),
    (CLAIM + "[search]\nmu = {low = 20, high = 30}\n[grid]\nT = [5]", "[search]: must stand alone, without grid"),
    (CLAIM + 'expect = "joy"\n', "expect: must be one of no_difference, no_gain, got 'joy'"),
    (CLAIM + 'expect = "no_gain"\n[grid]\nT = [5]', "[reference]: must name the values that the others are compared"),
    (
        CLAIM + "[grid]\nT = [5]\n[reference]\nmu = 5",
        "[reference] mu: must be an option that grid, zip or random varies",
    ),
    (CLAIM + "[grid]\nT = [5]\n[reference]\nT = 6", "[reference] T: no cell has T=6"),
    (
        CLAIM + "[zip]\nmu = [50]\nT = [5]\n[reference]\nT = 5",
        "[reference] mu: must be given, it varies together with T",
    ),
    (CLAIM + "[grid]\nT = [5]\n[reference]\nT = [5]", "[reference] T: must be a whole number at least 1, got [5]"),
    (CLAIM + "[grid]\nT = [5]\n[reference]\nS = 6", "[reference] S: no such option"),
    (
        CLAIM + f"[grid]\ngamma = {[n / 200 for n in range(101)]}\nmu = {list(range(20, 120))}",
        "cells: must be at most 10,000, the tables make 10,100",
    ),
]


@pytest.mark.parametrize(("text", "said"), BAD, ids=[said[:50] for _, said in BAD])
def test_one_line_names_file_table_and_key(text, said, tmp_path):
    file = tmp_path / "study.toml"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        sweep_file.read(file).cells()
    message = str(caught.value)
    assert said in message
    assert "\n" not in message
    # The cells are found out only when they are asked for.
    assert message.startswith("cell ") or message.startswith(f"{file}: ")


def test_files_that_cannot_be_read(tmp_path):
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(ConfigError, match=f"file: cannot read {path}: "):
            sweep_file.read(path)
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="file: cannot read"):
        sweep_file.read(tmp_path / "bytes.toml")


def test_options_of_base_that_only_fit_together_with_the_varied_ones():
    """T = 50 does not go with the default mu, but it does with those of the cells."""
    chosen = sweep_file.parse(CLAIM + "[base]\nT = 50\nwindow = 200\n[grid]\nmu = [60, 80]\n")
    assert [cell.settings.hyper.mu for cell in chosen.cells()] == [60, 80]
    chosen = sweep_file.parse(CLAIM + "[base]\nT = 50\nwindow = 200\n[search]\nmu = {low = 60, high = 80}\n")
    assert chosen.cell(0, {"mu": 60}).settings.hyper.mu == 60


def test_what_the_command_line_says_instead(tmp_path):
    file = tmp_path / "study.toml"
    file.write_text(CLAIM + "[base]\nseeds = 20\nepisodes = 100\n[grid]\nphysics = ['servo', 'kinematic']\n")
    chosen = sweep_file.read(file, seeds=2)
    assert {(cell.settings.run.seeds, cell.settings.run.episodes) for cell in chosen.cells()} == {(2, 100)}
    with pytest.raises(ConfigError, match="physics: must not be given, the file varies it"):
        sweep_file.read(file, physics="servo")
    with pytest.raises(ConfigError, match="seeds: must be a whole number at least 1"):
        sweep_file.read(file, seeds=0)


def test_differences():
    one = sweep_file.parse(CLAIM + "[base]\nseeds = 2\n[grid]\ngamma = [0.5, 0.9]\n")
    other = sweep_file.parse('claim = "d"\n[base]\nseeds = 2\n[grid]\ngamma = [0.5, 0.9]\n')
    assert study.differences(one, other) == []
    text = CLAIM + 'expect = "no_gain"\n[base]\nepisodes = 3\n[grid]\ngamma = [0.5]\n[reference]\ngamma = 0.5\n'
    wanted = ["expect", "[reference] gamma", "[base] seeds", "[base] episodes", "[grid] gamma"]
    assert study.differences(one, sweep_file.parse(text)) == wanted


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_shipped_files(file):
    """They can be read, say what they are about first, and give the same study when written again."""
    chosen = sweep_file.read(file)
    cells = chosen.cells()
    assert len(cells) == LARGE[file.stem] if file.stem in LARGE else 4 <= len(cells) <= 100
    assert len({cell.name for cell in cells}) == len(cells)
    assert file.read_text().startswith('claim = "')
    again = sweep_file.parse(chosen.text)
    assert again.cells() == cells
    assert study.differences(chosen, again) == []
    assert file.name in (file.parent / "README.md").read_text()


def test_none_is_lost():
    assert len(SHIPPED) == 23


OPTIONS = all_options()
KEYS = ["low", "high", "log", "choices", "draws", "trials", "batch", "metric", "seed", *OPTIONS]
SCALARS = (
    st.integers()
    | st.sampled_from([0, 1, 2, 20, 10**400])
    | st.floats()
    | st.booleans()
    | st.text(max_size=5)
    | st.sampled_from(["icac", "cacla", "planar2", "servo", "steps", "no_gain"])
    | st.datetimes()
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(KEYS) | st.text(max_size=4), inner),
    max_leaves=6,
)
TABLES = st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=3)
TOPS = st.sampled_from(["claim", "expect", "reference", "base", "grid", "zip", "random", "search"]) | st.text(
    max_size=6
)
FILES = st.dictionaries(TOPS, TABLES | VALUES, max_size=4)


@given(FILES, st.booleans())
def test_any_table_is_read_or_refused_in_a_line(tables, with_claim):
    refused_or_read(tomli_w.dumps(tables | {"claim": "c"} if with_claim else tables))


@given(st.text())
def test_any_text_is_read_or_refused_in_a_line(text):
    refused_or_read(text)


@given(
    st.sampled_from([name for name, field in OPTIONS.items() if field.type in (int, float)]),
    st.floats(allow_nan=False) | st.integers(-10, 10**6),
    st.floats(allow_nan=False) | st.integers(-10, 10**6),
    st.booleans(),
)
def test_any_distribution_draws_what_the_option_takes(name, low, high, log):
    table = {name: {"low": low, "high": high, "log": log}, "draws": 3}
    chosen = refused_or_read(tomli_w.dumps({"claim": "c", "random": table}))
    for cell in chosen.cells() if chosen else []:
        value = cell.settings.flat()[name]
        assert low <= value <= high or math.isclose(value, low) or math.isclose(value, high)


def refused_or_read(text):
    try:
        chosen = sweep_file.parse(text)
        if chosen.search is None:
            chosen.cells()
        assert sweep_file.parse(chosen.text).text == chosen.text
    except ConfigError as error:
        assert "\n" not in str(error)
        return None
    return chosen
