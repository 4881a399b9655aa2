"""The examples with somebody else's agents, in an environment that has what their requirements.txt asks for."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def run(example, *options):
    return subprocess.run(
        [sys.executable, str(ROOT / "examples" / example / "train.py"), *map(str, options)],
        check=True,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    ).stdout


def test_sac_with_her(tmp_path):
    pytest.importorskip("stable_baselines3")
    few = ("--steps", 40, "--evaluate-every", 20, "--evaluate-episodes", 2)
    said = run("sb3_her", *few, "--seeds", 2, "--out", tmp_path)
    assert said.count("success") == 6
    rows = (tmp_path / "sb3_her.csv").read_text().splitlines()
    assert rows[0] == "seed,steps,seconds,processor_seconds,success,mean_steps"
    assert [row.split(",")[:2] for row in rows[1:]] == [[seed, steps] for seed in "01" for steps in ("0", "20", "40")]
    assert (tmp_path / "sb3_her.png").stat().st_size > 10_000


def test_ppo_of_rejax():
    pytest.importorskip("rejax")
    said = run("gymnax_ppo", "--physics", "kinematic", "--steps", 120_000, "--evaluations", 3).splitlines()
    reached = [int(line.split("reached ")[1].split("%")[0]) for line in said[:-1]]
    assert len(reached) == 4
    assert reached[-1] > 80 > 45 > reached[0]


def test_ppo_of_brax():
    pytest.importorskip("brax")
    said = run("brax_ppo", "--steps", 120_000, "--evaluations", 2).splitlines()
    said = [line for line in said if " steps: reached " in line]  # brax prints what else it has not found
    reached = [int(line.split("reached ")[1].split("%")[0]) for line in said]
    assert len(reached) == 2
    assert reached[1] > 70 > 40 > reached[0]
