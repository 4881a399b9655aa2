"""A run goes on with the random numbers it was begun with, or not at all."""

import json
import shutil

import jax
import pytest
import tomli_w

from icac_jax.cli import main
from icac_jax.runs import loop, randomness

TINY = ["--algo", "cacla", "--physics", "kinematic", "--seeds", "2", "--episodes", "4"]
OTHERS = {"jax_default_prng_impl": "rbg", "jax_threefry_partitionable": False, "jax_random_seed_offset": 1}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    place = tmp_path_factory.mktemp("random") / "run"
    assert main.main(["train", *TINY, "--out", str(place)]) == 0
    return place


@pytest.fixture
def run(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "run")
    return tmp_path / "run"


@pytest.fixture(params=OTHERS)
def other(request):
    former = jax.config.values[request.param]
    jax.config.update(request.param, OTHERS[request.param])
    yield request.param
    jax.config.update(request.param, former)


def refused(name, args, capsys):
    capsys.readouterr()
    assert main.main(list(map(str, args))) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    must = f"{name}: must be {randomness.DEFAULTS[name]!r} as when "
    assert must in said, said
    assert f"got {OTHERS[name]!r}" in said
    assert f"(set {name.upper()}={randomness.DEFAULTS[name]})" in said


def without_record(history):
    events = [json.loads(line) for line in history.read_text().splitlines()]
    for event in events:
        event.get("platform", {}).pop("random", None)
    history.write_text("".join(f"{json.dumps(event)}\n" for event in events))


@pytest.mark.parametrize("old", [False, True])
def test_another_setting_is_refused_and_nothing_is_touched(old, other, run, capsys):
    """A run of an earlier version, without the record, was begun with what JAX has by default."""
    if old:
        without_record(run / "history.jsonl")
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    refused(other, ["resume", run, "--episodes", 8], capsys)
    refused(other, ["evaluate", run, "--pairs", 2], capsys)
    refused(other, ["export", run, "--seed", 0, "--out", run / "policy.npz"], capsys)
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


def test_what_a_run_was_begun_with_is_recorded_and_gone_on_with(other, tmp_path, capsys):
    assert main.main(["train", *TINY, "--out", str(tmp_path / "run")]) == 0
    event = json.loads((tmp_path / "run" / "history.jsonl").read_text().splitlines()[0])
    assert event["platform"]["random"] == randomness.DEFAULTS | {other: OTHERS[other]}
    capsys.readouterr()
    assert main.main(["resume", str(tmp_path / "run"), "--episodes", "6"]) == 0
    assert "may differ" not in capsys.readouterr().err
    jax.config.update(other, randomness.DEFAULTS[other])
    assert main.main(["resume", str(tmp_path / "run")]) == 2
    assert f"{other}: must be {OTHERS[other]!r} as when" in capsys.readouterr().err


def test_a_run_of_an_earlier_version_goes_on_without_a_word(run, capsys):
    without_record(run / "history.jsonl")
    assert main.main(["resume", str(run), "--episodes", "6"]) == 0
    assert "random" not in capsys.readouterr().err


def test_a_sweep_goes_on_with_its_own_too(other, tmp_path, monkeypatch, capsys):
    class Killed(BaseException):
        """No handler of the program catches it."""

    def killed(*args):
        raise Killed

    base = {"algo": "cacla", "physics": "kinematic", "seeds": 2, "episodes": 4}
    (tmp_path / "s.toml").write_text(tomli_w.dumps({"base": base, "grid": {"gamma": [0.5, 0.9]}}))
    jax.config.update(other, randomness.DEFAULTS[other])
    with monkeypatch.context() as patch:
        patch.setattr(loop.Training, "chunks", killed)
        with pytest.raises(Killed):
            main.main(["sweep", str(tmp_path / "s.toml"), "--out", str(tmp_path / "sweep")])
    jax.config.update(other, OTHERS[other])
    refused(other, ["resume", tmp_path / "sweep"], capsys)
