"""Installs the package with the oldest and the newest versions that it allows and runs a canary of the tests with each.

`python -m tests.versions` (needs uv and the Pythons) prints the table of docs/versions.md, a row per environment.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
EXTRAS = f"{ROOT}[gymnasium,gymnax,export,tensorboard]"
# Of these there are no old wheels for each Python, and who builds them needs a Fortran compiler.
WHEELS = ("numpy", "scipy", "matplotlib", "pillow", "pyarrow", "pandas")
# A minute or two, and every dependency takes part: physics, learners, networks, worlds, records, export, figures.
CANARY = (
    "tests/test_itm.py",
    "tests/test_predictors.py",
    "tests/test_keys.py",
    "tests/test_ddpg.py",
    "tests/test_evaluate.py",
    "tests/test_gymnasium.py",
    "tests/test_gymnax.py",
    "tests/test_training.py",
)
SHOWN = ("jax", "flax", "optax", "chex", "numpy", "scipy", "pyarrow", "matplotlib", "gymnasium", "gymnax")
_QUERY = "from importlib.metadata import version; print(*(version(name) for name in {names!r}))"


def made(place, python, oldest):
    """An environment with the package, the oldest or the newest that it allows; the path of its interpreter."""
    interpreter = place / "bin" / "python"
    subprocess.run(["uv", "venv", "--quiet", "--python", python, str(place)], check=True)
    install = ["uv", "pip", "install", "--quiet", "--python", str(interpreter)]
    resolution = ["--resolution", "lowest-direct"] if oldest else []
    wheels = [word for name in WHEELS for word in ("--only-binary", name)]
    subprocess.run([*install, *resolution, *wheels, EXTRAS], check=True)
    subprocess.run([*install, "pytest", "hypothesis"], check=True)
    return interpreter


def row(python, oldest):
    """A line of the table: versions, and how the canary ended."""
    with tempfile.TemporaryDirectory() as name:
        interpreter = made(Path(name) / "environment", python, oldest)
        query = _QUERY.format(names=SHOWN)
        versions = subprocess.run([interpreter, "-c", query], capture_output=True, text=True, check=True).stdout.split()
        # Warnings of other versions are no failures here.
        arguments = ["-m", "pytest", "-q", "-W", "default", "-p", "no:cacheprovider", "--durations=0", *CANARY]
        environment = os.environ | {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
        done = subprocess.run([interpreter, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True)
        said = done.stdout.strip().splitlines()
        for line in said:
            if line.startswith(("FAILED", "ERROR", "E  ")):
                print(line, file=sys.stderr)
        last = said[-1] if said else "nothing"
    return f"| {python} | {'oldest' if oldest else 'newest'} | {' | '.join(versions)} | {last.split(' in ')[0]} |"


def main(pythons):
    """Prints the table."""
    print(f"| Python | versions | {' | '.join(SHOWN)} | canary |")
    print("|---" * (len(SHOWN) + 3) + "|")
    for python in pythons:
        for oldest in (True, False):
            print(row(python, oldest), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:] or PYTHONS)
