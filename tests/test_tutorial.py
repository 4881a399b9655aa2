"""The pages for newcomers: the tutorial's commands run, names and rows of tables are true."""

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest

from icac_jax.cli import elsewhere, main
from icac_jax.cli.commands import train
from icac_jax.settings import options
from tests.conftest import here

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
FEWER = [(r"--seeds 20", "--seeds 2"), (r"--episodes 400", "--episodes 6"), ("seeds = 20", "seeds = 2"),
         ("episodes = 400", "episodes = 6"), (r"range\(20\)", "range(2)"), ("episodes=400", "episodes=6"),
         ("episodes=200", "episodes=6")]  # fmt: skip


def blocks(page, language):
    text = (DOCS / page).read_text()
    for old, new in FEWER:
        text = re.sub(old, new, text)
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.M | re.S)


def test_the_tutorial_from_its_first_training_to_its_figures(tmp_path):
    (study,) = blocks("tutorial.md", "toml")
    (tmp_path / "noise.toml").write_text(study)
    done = 0
    for block in blocks("tutorial.md", "sh"):
        for line in block.splitlines():
            if line.startswith("icac ") and "--version" not in line:
                command = shlex.split(line, comments=True)[1:]
                ended = here(*command, cwd=tmp_path)
                assert ended.returncode == 0, f"{line}: {ended.stderr}"
                done += 1
    assert done >= 6
    assert {"comparison.png", "noise.png", "noise.csv"} <= {path.name for path in tmp_path.iterdir()}
    assert (tmp_path / "runs" / "little" / "report.html").is_file()


@pytest.mark.parametrize("page", ["tutorial.md", "runs.md"])
def test_python_in_the_pages_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for block in blocks(page, "python"):
        with contextlib.redirect_stdout(io.StringIO()) as said:
            exec(compile(block, page, "exec"), {})
        assert said.getvalue()


def rows(page, title):
    section = (DOCS / page).read_text().partition(f"## {title}\n")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[1:]]


def test_names_of_others_are_what_the_command_line_answers():
    known = {*options.all_options(), *train.Output.__dataclass_fields__}
    named = {}
    for there, target, _ in (row + [""] * (3 - len(row)) for row in rows("coming_from.md", "Names")):
        answers = {name.replace("-", "_") for name in re.findall(r"--([a-z-]+)", target)}
        if "sh" not in target and "icac " not in target:
            assert answers <= known, target
        named |= {name: answers for name in re.findall(r"`(\w+)`", there)}
    for name, targets in elsewhere.NAMES.items():
        assert named.get(name) is not None, f"{name} is not on the page"
        assert set(targets) <= named[name], name


def test_every_row_of_what_users_expect_is_a_yes_or_a_reason():
    found = rows("coming_from.md", "What users expect")
    assert len(found) >= 30
    text = (DOCS / "coming_from.md").read_text()
    assert re.search(r"checked on \d+ \w+ 20\d\d", text)  # a claim about others has a date and versions
    for package in ("stable-baselines3", "rl_zoo3", "rejax", "playground", "brax"):
        assert re.search(rf"\b{package}\b[^.|]*? \d+\.\d+\.\d+", text), package
    for row in found:
        assert len(row) == 5, row
        assert row[4].startswith("yes") or re.match(r"no: .{15,}", row[4]), row
    commands = [command for row in found for command in re.findall(r"`icac ([a-z-]+)", row[4])]
    assert commands
    assert set(commands) <= set(main.COMMANDS)


def test_every_extra_is_in_all_and_every_one_that_a_message_names_exists():
    import tomllib

    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    (everything,) = extras["all"]
    # gpu is a choice of machine
    assert set(re.findall(r"\w+", everything.partition("[")[2])) == set(extras) - {"all", "gpu"}
    for path in (ROOT / "icac_jax").rglob("*.py"):
        for name in re.findall(r"icac_jax\[(\w+)\]", path.read_text()):
            assert name in extras, f"{path.name}: {name}"
