"""What the command line does for whoever does not know it: suggestions, completion, lists of runs in order."""

import json
import shutil
import subprocess

import pytest

from icac_jax.cli import completion, elsewhere, main
from icac_jax.cli.commands import train
from icac_jax.settings import options
from tests.conftest import here

TINY = ("--physics", "kinematic", "--seeds", 2, "--episodes", 5)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ("train --seed 3", "did you mean --seeds?"),
        ("evaluate x --pair 3", "did you mean --pairs?"),
        ("train --lr 3", "here it is --actor-rate and --critic-rate"),
        ("train --total-timesteps 3", "here it is --episodes"),
        ("train --env nico4", "here it is --arm and --task"),
        ("train --nonsense 3", "icac help train lists them"),
    ],
)
def test_a_name_that_is_no_option_says_which_one_is(args, words):
    done = here(*args.split())
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert words in done.stderr


def test_names_of_other_libraries_stand_for_options_that_there_are():
    known = {*options.all_options(), *train.Output.__dataclass_fields__}
    assert {name for names in elsewhere.NAMES.values() for name in names} <= known
    assert not set(elsewhere.NAMES) & known


def bash(words, script):
    """What bash would offer for the last of the words."""
    array = " ".join(f"'{word}'" for word in words)
    line = f'. {script}; COMP_WORDS=({array}); COMP_CWORD={len(words) - 1}; _icac; printf "%s\\n" "${{COMPREPLY[@]}}"'
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True).stdout.split()


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("completion") / "icac.bash"
    path.write_text(here("completion", "bash").stdout)
    return path


def test_bash_completes_commands_options_and_values(script):
    assert set(bash(["icac", ""], script)) == {*main.COMMANDS, "help"}
    assert bash(["icac", "comp"], script) == ["compare", "completion"]
    offered = bash(["icac", "train", "--"], script)
    assert {"--seeds", "--gamma", "--hindsight", "--out", "--no-cache", "--track"} <= set(offered)
    assert "--tensorboard" not in offered
    assert bash(["icac", "train", "--algo", "cacla"], script) == ["cacla", "cacla_var"]
    assert bash(["icac", "compare", "--metric", "steps_"], script) == ["steps_when_reached"]
    assert bash(["icac", "plot", "--no"], script) == ["--no-film", "--no-cache"]
    assert bash(["icac", "completion", "f"], script) == ["fish"]


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_the_other_shells_have_every_command_and_read_their_script(shell, tmp_path):
    text = here("completion", shell).stdout
    for command in main.COMMANDS:
        assert command in text
        for option in completion.options(command):
            assert option.name.removeprefix("--") in text
    if shutil.which(shell):
        (tmp_path / "script").write_text(text)
        subprocess.run([shell, "-n", tmp_path / "script"], check=True)


def test_completion_without_a_shell_says_how(capsys):
    done = here("completion")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "bash, zsh, fish" in done.stderr


@pytest.fixture(scope="module")
def several(tmp_path_factory):
    place = tmp_path_factory.mktemp("several")
    for name, more in (("b", ("--algo", "cacla")), ("a", ("--algo", "cacla_var")), ("c", ("--algo", "cacla"))):
        assert here("train", *TINY, *more, "--out", place / "runs" / name).returncode == 0
    history = place / "runs" / "c" / "history.jsonl"
    history.write_text(history.read_text().replace('"time": "20', '"time": "19'))
    return place


def listed(place, *args):
    done = here("runs", *args, "--json", cwd=place)
    assert done.returncode == 0, done.stderr
    return [run["folder"].removeprefix("runs/") for run in json.loads(done.stdout)]


def test_runs_are_sorted_and_filtered(several):
    assert listed(several) == ["a", "b", "c"]
    assert listed(several, "--sort", "date")[-1] == "c"
    assert listed(several, "--filter", "algo=cacla") == ["b", "c"]
    assert listed(several, "--filter", "algo=cacla*", "state=finished", "date=19*") == ["c"]
    assert listed(several, "--filter", "kind=sweep") == []
    rates = [run["success"] for run in json.loads(here("runs", "--sort", "success", "--json", cwd=several).stdout)]
    assert rates == sorted(rates, reverse=True)
    text = here("runs", cwd=several).stdout
    assert all(line.split()[1][:2] in ("20", "19") for line in text.splitlines())
    for wrong in (["--filter", "algo"], ["--filter", "colour=red"], ["--sort", "colour"]):
        done = here("runs", *wrong, cwd=several)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)


def test_a_training_says_that_it_is_compiling(tmp_path):
    done = here("train", *TINY, "--algo", "cacla", "--out", tmp_path / "x")
    assert done.stderr.startswith("cacla planar2: compiling\n")
