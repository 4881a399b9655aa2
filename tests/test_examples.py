"""The files under examples/, as a user runs them, with small numbers."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from icac_jax.runs.records import SCHEMA

REPORTED = pa.schema([*SCHEMA, pa.field("live_nodes", pa.int32())])  # as a learner with a map has it
ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
ENV = os.environ | {"PYTHONPATH": str(ROOT)}


def example(name):
    found = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def test_curiosity(capsys):
    success, nodes = example("curiosity").main(steps=20_000, seeds=3)
    assert success.shape == (2, 3, 5)
    assert nodes[1].min() > nodes[0].max()  # with curiosity every seed knows more of the maze
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 3
    assert said[1].startswith("without curiosity")


@pytest.mark.slow
def test_curiosity_finds_what_a_random_walk_does_not():
    success, _ = example("curiosity").main()
    assert success[0].max() == 0.0
    assert success[1, :, -1].min() > 0.9


def test_seeds_sigma(capsys):
    success = example("seeds_sigma").main(episodes=8, seeds=3)
    assert success.shape == (4, 3)
    assert jnp.all((success >= 0) & (success <= 1))
    assert len(capsys.readouterr().out.splitlines()) == 6


def test_own_environment(capsys):
    result = example("own_environment").main(episodes=10, seeds=2)
    assert {name: success.shape for name, success in result.items()} == {"cacla_var": (2, 2), "icac": (2, 2)}
    assert len(capsys.readouterr().out.splitlines()) == 3


@pytest.mark.slow
def test_own_environment_is_learnt():
    result = example("own_environment").main()
    for success in result.values():
        assert success[1].mean() > success[0].mean() + 0.3


def test_read_records(tmp_path):
    """Of a file as a run writes it, with numbers whose means are known."""
    seeds, episodes = 3, 20
    rows = [
        {field.name: 0 for field in REPORTED}
        | {"seed": s, "episode": e, "steps": 10 * s + e, "reached": e >= 18 and s > 0, "live_nodes": s + e}
        for s in range(seeds)
        for e in range(episodes)
    ]
    (tmp_path / "run").mkdir()
    pq.write_table(pa.Table.from_pylist(rows, schema=REPORTED), tmp_path / "run" / "episodes.parquet")
    by_pandas, by_polars = example("read_records").main(str(tmp_path / "run"))
    assert list(by_pandas.index) == by_polars["seed"].to_list() == [0, 1, 2]
    for table in (by_pandas, by_polars):
        assert list(table["success"]) == [0.0, 1.0, 1.0]
        assert list(table["steps"]) == [18.5, 28.5, 38.5]
        assert list(table["live_nodes"]) == [19, 20, 21]
    command = [sys.executable, str(EXAMPLES / "read_records.py"), "run"]  # as a script, from anywhere
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("live_nodes") == 2


def test_learners_are_compared(tmp_path):
    place = EXAMPLES / "learners"
    few = [
        "--task",
        "planar2",
        "--only",
        "icac",
        "--seeds",
        "2",
        "--steps",
        "60",
        "--every",
        "30",
        "--physics",
        "kinematic",
        "--out",
    ]
    said = subprocess.run(
        [sys.executable, place / "compare.py", *few, tmp_path], check=True, capture_output=True, text=True, env=ENV
    ).stdout.splitlines()
    assert said[0].startswith("planar2 icac: 30 steps,")
    assert said[-2].startswith("| icac | 60 | ")
    rows = (tmp_path / "learners-planar2.csv").read_text().splitlines()
    assert len(rows) == 1 + 2 * 2
    subprocess.run([sys.executable, place / "figure.py", tmp_path / "learners-planar2.csv"], check=True, env=ENV)
    assert (tmp_path / "learners-planar2.png").stat().st_size > 10_000
