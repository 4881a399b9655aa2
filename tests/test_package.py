"""The package as others see it: imports, the README's examples, the wheel."""

import ast
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
from pathlib import Path

import pytest

import icac_jax
from icac_jax.agents import registry

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "icac_jax"

# Each folder or module may import itself and what stands before it; those on one line do not know each other.
LAYERS = [
    ("errors", "console", "reading"),
    ("shapes",),
    ("precision",),
    ("fields",),
    ("fast",),
    ("networks",),
    ("curiosity", "envs"),
    ("agents",),
    ("rollout", "greedy", "gymnasium_curiosity"),
    ("settings",),
    ("runs",),
    ("tracking",),
    ("reports",),
    ("sweeps", "policies"),
    ("analysis",),
    ("paper",),
    ("trained",),
    ("training",),
    ("cli",),
    ("__main__",),
]
# What `import icac_jax` itself loads; the rest comes when it is asked for.
LAST_LOADED = "rollout"
LONGEST = 350


def modules():
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        yield re.sub(r"\.?__init__$", "", name), path


def folder(name):
    return name.split(".")[0]


def level(name):
    return next(number for number, names in enumerate(LAYERS) if folder(name) in names)


def imported(path, eager=False):
    """Modules of this package and top-level names of others that a file imports: anywhere in it, or when loaded."""
    own, other = set(), set()
    tree = ast.parse(path.read_text())
    for node in tree.body if eager else ast.walk(tree):
        if isinstance(node, ast.Import):
            other |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            if (node.module or "").split(".")[0] != "icac_jax":
                other.add((node.module or "").split(".")[0])
                continue
            base = node.module.removeprefix("icac_jax").removeprefix(".")
            known = dict(modules())
            for alias in node.names:
                deeper = f"{base}.{alias.name}".removeprefix(".")
                own.add(deeper if deeper in known else base)
    return own, other


def test_every_folder_has_its_layer():
    there = {folder(name) for name, _ in modules()} - {""}
    assert there - {name for names in LAYERS for name in names} == set()


def test_imports_run_one_way():
    for name, path in modules():
        if name == "":
            continue
        for target in imported(path)[0]:
            if target == "":
                assert folder(name) in ("cli", "__main__"), f"{name} imports the package itself"
            elif folder(target) != folder(name):
                assert level(target) < level(name), f"{name} imports {target}"


def test_the_package_itself_loads_no_more_than_its_functions():
    own, other = imported(PACKAGE / "__init__.py", eager=True)
    assert {level(name) for name in own} <= set(range(level(LAST_LOADED) + 1))
    assert other <= {"typing", "importlib"}


def test_what_running_needs_is_locked_apart_and_at_the_same_versions():
    def pins(name):
        return {line.removesuffix(" \\") for line in (ROOT / name).read_text().splitlines() if "==" in line}

    needed = {
        re.split(r"[><=\[]", one)[0]
        for one in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    }
    running = pins("requirements-run.lock")
    assert needed <= {pin.partition("==")[0] for pin in running}
    assert not {"pytest", "mkdocs-material", "ray"} & {pin.partition("==")[0] for pin in running}
    assert {pin.partition(" ;")[0] for pin in running} <= {pin.partition(" ;")[0] for pin in pins("requirements.lock")}


def test_what_is_imported_from_elsewhere():
    with_mujoco = ("envs.model", "envs.pictures", "envs.gymnasium")
    # The functions: no files, no clock, no terminal. `registry` asks which packages are installed.
    pure = ("fields", "networks", "fast", "curiosity", "agents", "rollout", "greedy")
    for name, path in modules():
        _, other = imported(path)
        assert name in with_mujoco or "mujoco" not in other, f"{name} imports mujoco"
        with_gymnasium = ("envs.gymnasium", "gymnasium_curiosity", "runs.recorder")
        assert name in with_gymnasium or "gymnasium" not in other, f"{name} imports gymnasium"
        assert name in ("envs.gymnax", "envs.from_gymnax") or "gymnax" not in other, f"{name} imports gymnax"
        assert "brax" not in other, f"{name} imports brax"  # the adapter looks for it when one is made
        if folder(name) in pure:
            allowed = {"jax", "flax", "optax", "chex", "typing", "collections", "dataclasses", "functools", "math"}
            allowed |= {"importlib"} if name == "agents.registry" else set()
            allowed |= {"numpy", "numbers", "difflib", "itertools"} if folder(name) in ("fields", "fast") else set()
            allowed |= {"numpy"} if name == "curiosity.options" else set()
            assert other <= allowed, f"{name} imports {other - allowed}"


def compared(tree):
    """The parts of all comparisons and of all patterns of `match` in a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            yield from (node.left, *node.comparators)
        elif isinstance(node, ast.MatchValue):
            yield node.value


def names_of_learners_compared(source):
    texts = (part for side in compared(ast.parse(source)) for part in ast.walk(side) if isinstance(part, ast.Constant))
    return {text.value for text in texts} & set(registry.LEARNERS)


def test_a_learner_is_told_apart_by_name_in_the_registry_only():
    for name, path in modules():
        if name not in ("agents.registry", "paper.figures"):  # the second asks whether the paper's run `icac` is there
            assert not names_of_learners_compared(path.read_text()), name
    assert names_of_learners_compared('x = settings.algo == "icac"') == {"icac"}
    assert names_of_learners_compared('x = algo in ("cacla", "cacla_var")') == {"cacla", "cacla_var"}


def test_nobody_reaches_into_the_state_of_a_learner():
    """The actor-critic and the map are their owners'; the picture of the map is of a `CuriousState`."""
    for name, path in modules():
        if folder(name) not in ("agents", "curiosity") and name != "policies.map_picture":
            reached = [n.attr for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Attribute)]
            assert not {"cacla", "curiosity"} & set(reached), name


def test_no_file_is_long():
    lengths = {name: len(path.read_text().splitlines()) for name, path in modules()}
    assert {name: length for name, length in lengths.items() if length > LONGEST} == {}


def test_importing_the_package_loads_no_physics_and_prints_nothing():
    code = "import sys, icac_jax; assert not {'mujoco', 'pyarrow', 'tyro', 'matplotlib'} & set(sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    code = "import icac_jax.envs.reach"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_public_names_exist_and_are_documented():
    for name in icac_jax.__all__:
        thing = getattr(icac_jax, name)
        assert thing.__doc__, name


@pytest.mark.parametrize("dependencies", ["of here", pytest.param("locked", marks=pytest.mark.slow)])
def test_wheel_in_a_clean_environment(dependencies, tmp_path):
    """Builds the wheel, installs it into a new environment, trains from another folder.

    Its dependencies are those of the environment of the tests, which brings no `icac_jax` of its own along, or
    installed from the locked versions.
    """
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path / "dist")]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    venv.create(tmp_path / "clean")
    python = tmp_path / "clean" / "bin" / "python"
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--disable-pip-version-check"]
    if dependencies == "of here":
        subprocess.run([*pip, "--no-deps", "--no-index", str(wheel)], check=True, env=clean, cwd=tmp_path)
        (site,) = (tmp_path / "clean").glob("lib/python*/site-packages")
        # A folder named in a .pth file is searched, but its own .pth files, an editable install's among them, are not.
        (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    else:
        locked = tmp_path / "constraints.txt"
        lines = (ROOT / "requirements.lock").read_text().splitlines()
        locked.write_text("\n".join(line.removesuffix(" \\") for line in lines if re.match(r"[a-z0-9]", line)))
        subprocess.run([*pip, "-c", str(locked), str(wheel)], check=True, env=clean, cwd=tmp_path)
    found = [str(python), "-c", "import icac_jax; print(icac_jax.__file__)"]
    place = subprocess.run(found, check=True, capture_output=True, text=True, env=clean, cwd=tmp_path).stdout
    assert place.startswith(str(tmp_path / "clean"))
    icac = str(tmp_path / "clean" / "bin" / "icac")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    said = subprocess.run([icac, "--version"], check=True, capture_output=True, text=True, env=clean, cwd=elsewhere)
    assert said.stdout == f"icac_jax {icac_jax.__version__}\n"
    tiny = [
        "train",
        "--algo",
        "cacla",
        "--seeds",
        "2",
        "--episodes",
        "2",
        "--physics",
        "kinematic",
        "--no-cache",
        "--out",
        "run",
    ]
    subprocess.run([icac, *tiny], check=True, env=clean, cwd=elsewhere, capture_output=True)
    assert (elsewhere / "run" / "episodes.parquet").is_file()
    planned = subprocess.run(
        [icac, "sweep", "gamma", "--dry-run"], check=True, env=clean, cwd=elsewhere, capture_output=True, text=True
    )
    assert planned.stdout.startswith("C6: ")  # the shipped studies are in the wheel
