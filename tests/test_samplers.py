"""Even draws, and sweep files of Weights & Biases."""

import json
import math

import numpy as np
import pytest

from icac_jax.fields import ConfigError
from icac_jax.sweeps import distributions, sweep_file, wandb_file
from tests.conftest import here

RANDOM = """[random]
draws = {draws}
seed = 3
sampler = "{sampler}"
gamma = {{low = 0.5, high = 0.9}}
actor_rate = {{low = 1e-4, high = 1.0, log = true}}
hidden_units = {{low = 2, high = 5}}
optimizer = {{choices = ["sgd", "adam"]}}
"""


def drawn(sampler, draws=64):
    cells = sweep_file.parse(RANDOM.format(sampler=sampler, draws=draws)).cells()
    assert len(cells) == draws
    return [cell.varied for cell in cells]


@pytest.mark.parametrize("sampler", ["sobol", "latin_hypercube"])
def test_even_draws_fill_every_part_of_every_option(sampler):
    cells = drawn(sampler)
    assert cells == drawn(sampler)
    gamma = np.array([cell["gamma"] for cell in cells])
    assert np.histogram(gamma, bins=16, range=(0.5, 0.9))[0].tolist() == [4] * 16
    rate = np.log10([cell["actor_rate"] for cell in cells])
    assert np.histogram(rate, bins=16, range=(-4, 0))[0].tolist() == [4] * 16
    units = [cell["hidden_units"] for cell in cells]
    assert [units.count(number) for number in (2, 3, 4, 5)] == [16] * 4
    assert [cell["optimizer"] for cell in cells].count("adam") == 32


def test_random_draws_are_those_of_before_and_uneven():
    without = sweep_file.parse(RANDOM.format(sampler="random", draws=64).replace('sampler = "random"\n', ""))
    assert [cell.varied for cell in without.cells()] == drawn("random")
    counts = np.histogram([cell["gamma"] for cell in drawn("random")], bins=16, range=(0.5, 0.9))[0]
    assert counts.max() > 4


def test_any_number_of_draws_and_the_ends():
    assert len(drawn("sobol", 1)) == 1
    assert drawn("sobol", 20) == drawn("sobol", 32)[:20]
    one = distributions.Distribution("mu", 20, 40, True, None)
    assert (one.at(0.0), one.at(math.nextafter(1, 0))) == (20, 40)


def test_another_sampler_is_refused():
    with pytest.raises(ConfigError, match="sampler: must be one of random, sobol, latin_hypercube, got 'halton'"):
        drawn("halton")


GRID = """
program: train.py
method: grid
name: which discount
command: [python, train.py]
parameters:
  algo: {values: [cacla, icac]}
  gamma: {values: [0.8, 0.9]}
  seeds: {value: 3}
"""


def test_a_grid_of_wandb(tmp_path):
    (tmp_path / "sweep.yaml").write_text(GRID)
    said = []
    study = sweep_file.read(tmp_path / "sweep.yaml", said.append, episodes=7)
    assert [cell.varied for cell in study.cells()] == [
        {"algo": algo, "gamma": gamma} for algo in ("cacla", "icac") for gamma in (0.8, 0.9)
    ]
    assert (study.claim, study.base) == ("which discount", {"seeds": 3, "episodes": 7})
    assert said == [f"{tmp_path / 'sweep.yaml'}: not taken over: program, command"]


def test_random_and_bayes_of_wandb():
    text = """
method: random
run_cap: 5
metric: {name: eval/success, goal: maximize}
early_terminate: {type: hyperband}
parameters:
  actor-rate: {distribution: log_uniform_values, min: 0.001, max: 0.1}
  critic_rate: {distribution: log_uniform, min: -3, max: 0}
  hidden_units: {min: 2, max: 6}
  optimizer: {values: [sgd, adam], probabilities: [0.5, 0.5]}
"""
    made, notes = wandb_file.tables(text)
    assert made["random"]["draws"] == 5
    assert made["random"]["actor_rate"] == {"low": 0.001, "high": 0.1, "log": True}
    assert made["random"]["critic_rate"]["low"] == pytest.approx(math.exp(-3))
    assert made["random"]["hidden_units"] == {"low": 2, "high": 6}
    assert notes == "not taken over: early_terminate, parameters.optimizer.probabilities, metric"
    made, notes = wandb_file.tables(text.replace("random", "bayes"))
    assert (made["search"]["trials"], made["search"]["metric"]) == (5, "success_rate")
    assert notes.startswith("method bayes is a search by Optuna's TPE; not taken over: early_terminate")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: [", "not valid YAML"),
        ("- 1", "parameters: must be a mapping"),
        ("method: hyperband\nparameters: {gamma: {value: 1}}", "method: must be one of grid, random, bayes"),
        (
            "method: random\nparameters: {gamma: {distribution: normal}}",
            "gamma.distribution: must be one of",
        ),
        ("method: random\nparameters: {gamma: {min: 0.1}}", "parameters.gamma.max: must be a number, got None"),
        ("method: grid\nparameters: {gamma: {min: 0.1, max: 0.2}}", "parameters.gamma.values: must be given"),
        ("method: grid\nparameters: {net: {parameters: {}}}", "parameters.net.parameters: must not be nested"),
        ("method: grid\nparameters: {gama: {values: [0.1]}}", "[grid] gama: no such option; did you mean gamma?"),
        (
            "method: bayes\nmetric: {name: loss}\nparameters: {gamma: {min: 0.1, max: 0.2}}",
            "metric.name: must be",
        ),
        (
            "method: bayes\nmetric: {name: steps, goal: maximize}\nparameters: {gamma: {min: 0.1, max: 0.2}}",
            "metric.goal: must be minimize for steps, got 'maximize'",
        ),
    ],
)
def test_what_cannot_be_said_here_is_one_line_with_its_name(text, words, tmp_path):
    (tmp_path / "x.yml").write_text(text)
    done = here("sweep", "x.yml", "--dry-run", cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert words in done.stderr


def test_a_sweep_of_wandb_is_trained_and_resumed_from_its_folder(tmp_path):
    (tmp_path / "sweep.yaml").write_text(GRID.replace("[cacla, icac]", "[cacla, cacla_var]"))
    done = here("sweep", "sweep.yaml", "--out", "out", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "not taken over: program, command" in done.stderr
    assert len(json.loads(done.stdout)["cells"]) == 4
    assert here("resume", "out", cwd=tmp_path).returncode == 0
