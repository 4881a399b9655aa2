"""The README's programs run and print what it says; the public names are typed."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PROGRAMS = re.findall(r"```python\n(.*?)```", README, re.S)


def test_the_first_program_prints_what_the_readme_says(capsys):
    exec(compile(PROGRAMS[0], "README", "exec"), {})
    said, wanted = capsys.readouterr().out, re.search(r"```\n(Trained.*?)```", README, re.S)[1]
    numbers = [[float(text) for text in re.findall(r"-?\d+\.\d+", words)] for words in (said, wanted)]
    assert re.sub(r"-?\d+\.\d+", "N", said) == re.sub(r"-?\d+\.\d+", "N", wanted)
    # Other processors round differently, and learners are chaotic: shares and steps of 60 learners, not digits.
    for mine, theirs, off in zip(*numbers, (5.0, 3.0, 0.08, 0.08, 0.08), strict=False):
        assert abs(mine - theirs) < off


@pytest.mark.parametrize(("number", "said"), [(1, "nodes: "), (2, "success by seed: ")])
def test_the_other_programs(number, said, capsys):
    names: dict = {}
    exec(compile(PROGRAMS[number], f"README {number}", "exec"), names)
    assert capsys.readouterr().out.startswith(said)
    if number == 1:
        assert int(names["end"].map.live.sum()) > 10
    else:
        assert names["run"].success.min() > 0.9


def test_a_program_on_the_public_names_passes_mypy_strict():
    assert (ROOT / "icac_jax" / "py.typed").is_file()
    command = [sys.executable, "-m", "mypy", "--strict", "--no-incremental", "--follow-imports=silent"]
    done = subprocess.run(
        [*command, str(ROOT / "tests" / "public_api.py")], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
