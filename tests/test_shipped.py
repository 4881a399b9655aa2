"""Trained policies of the package: small, acting as their cards say, a film without a run."""

import json
import re

import pytest
from PIL import Image

from icac_jax.cli import main
from icac_jax.policies import SHIPPED, film, shipped


@pytest.mark.parametrize("name", SHIPPED)
def test_it_is_small_and_its_card_says_what_it_does(name):
    place = shipped.folder_of(name)
    assert sum(path.stat().st_size for path in place.iterdir()) < 60_000
    text = " ".join((place / "card.md").read_text().split())
    share, steps = map(float, re.search(r"reached ([\d.]+)% of the goals, in ([\d.]+) steps", text).groups())
    played = film.play(shipped.load(name), 60, pair_seed=3)
    assert sum(one.reached for one in played) / 60 == pytest.approx(share / 100, abs=0.05)
    assert sum(len(one.joints) - 1 for one in played) / 60 == pytest.approx(steps, rel=0.3)
    assert "central" in text


def test_a_film_needs_no_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main.main(["render", "--policy", "best-planar2", "--format", "png", "--episodes", "1"]) == 0
    with Image.open("best-planar2.png") as page:
        assert page.width > 600


def test_it_is_evaluated_without_a_run_and_nothing_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main.main(["evaluate", "--policy", "best-planar2", "--pairs", "20", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["success_rate"]["value"] >= 0.95
    assert found["policy"] == "best-planar2"
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["render", "evaluate"])
def test_a_run_and_a_policy_of_the_package_exclude_each_other(command, tmp_path, capsys):
    assert main.main([command, str(tmp_path), "--policy", "best-nico4"]) == 2
    assert "run: must be left out with policy best-nico4" in capsys.readouterr().err
    assert main.main([command, "--policy", "best-nico5"]) == 2
    assert "run: must be the folder of a run, got nothing" in capsys.readouterr().err
