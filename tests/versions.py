"""Installs the package with the oldest and the newest versions that it allows and runs a canary of the tests with each.

`python -m tests.versions` (needs uv and the Pythons) prints the table of docs/robustness.md, a row per environment;
`python -m tests.versions 3.12 oldest` prints one of them.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
RESOLUTIONS = ("oldest", "newest")
# What the tests need beside the package.
TOOLS = ("pytest", "hypothesis", "pandas<3", "polars")
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


def made(place, python, resolution):
    """An environment with the package, the oldest or the newest that it allows; the path of its interpreter."""
    interpreter = place / "bin" / "python"
    subprocess.run(["uv", "venv", "--quiet", "--python", python, str(place)], check=True)
    install = ["uv", "pip", "install", "--quiet", "--python", str(interpreter)]
    lowest = ["--resolution", "lowest-direct"] if resolution == "oldest" else []
    wheels = [word for name in WHEELS for word in ("--only-binary", name)]
    subprocess.run([*install, *lowest, *wheels, EXTRAS], check=True)
    subprocess.run([*install, *wheels, *TOOLS], check=True)
    return interpreter


def row(python, resolution):
    """A line of the table: versions, and how the canary ended."""
    with tempfile.TemporaryDirectory() as name:
        interpreter = made(Path(name) / "environment", python, resolution)
        query = _QUERY.format(names=SHOWN)
        versions = subprocess.run([interpreter, "-c", query], capture_output=True, text=True, check=True).stdout.split()
        # Warnings of other versions are no failures here; one -q, so that the last line has the counts.
        arguments = ["-m", "pytest", "-o", "addopts=-q --strict-markers -m 'not slow'", "-W", "default"]
        arguments += ["-p", "no:cacheprovider", *CANARY]
        environment = os.environ | {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
        done = subprocess.run([interpreter, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True)
        said = done.stdout.strip().splitlines()
        for line in said:
            if line.startswith(("FAILED", "ERROR", "E  ")):
                print(line, file=sys.stderr)
        last = said[-1] if said else "nothing"
    return f"| {python} | {resolution} | {' | '.join(versions)} | {last.split(' in ')[0]} |"


def main(pythons=PYTHONS, resolutions=RESOLUTIONS):
    """Prints the table."""
    print(f"| Python | versions | {' | '.join(SHOWN)} | canary |")
    print("|---" * (len(SHOWN) + 3) + "|")
    for python in pythons:
        for resolution in resolutions:
            print(row(python, resolution), flush=True)


if __name__ == "__main__":
    main(*([word] for word in sys.argv[1:]))
