"""The package as others see it: imports, the README's examples, the wheel."""

import ast
import os
import re
import subprocess
import sys
import venv
from pathlib import Path

import pytest

import icac_jax

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "icac_jax"

# Each layer may import those before it, and modules of its own line.
LAYERS = [
    ["config", "networks", "keys", "envs.arithmetic", "envs.scalars"],
    ["itm", "predictors", "cacla", "envs.base", "envs.arms", "envs.assets", "envs.rendering"],
    ["curiosity"],
    ["agent", "evaluation", "envs.reach"],
    ["rollout", "envs.oracle", "envs.gymnasium", "envs.gymnax"],
    ["", "envs"],
    ["experiment"],
    ["__main__"],
]


def modules():
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        yield re.sub(r"\.?__init__$", "", name), path


def level(name):
    if name.startswith("experiment"):
        name = "experiment"
    return next(number for number, names in enumerate(LAYERS) if name in names)


def imported(path):
    """Modules of this package and top-level names of others that a file imports anywhere in it."""
    own, other = set(), set()
    for node in ast.walk(ast.parse(path.read_text())):
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


def test_imports_run_one_way():
    for name, path in modules():
        own, other = imported(path)
        for target in own:
            if target == "" and name != "":
                assert name.startswith(("experiment", "__main__")), f"{name} imports the package itself"
                continue
            assert level(target) <= level(name), f"{name} imports {target}"
        with_mujoco = ("envs.reach", "envs.rendering", "envs.gymnasium")
        assert name in (*with_mujoco, "experiment.canvas") or "mujoco" not in other, f"{name} imports mujoco"
        assert name == "envs.gymnasium" or "gymnasium" not in other, f"{name} imports gymnasium"
        assert name == "envs.gymnax" or "gymnax" not in other, f"{name} imports gymnax"
        outside = (
            "experiment",
            "__main__",
            "envs.assets",
            "envs.oracle",
            "envs.gymnax",
            "envs.arithmetic",
            "envs.scalars",
            *with_mujoco,
        )
        if not name.startswith(outside):
            allowed = {"jax", "flax", "optax", "chex", "typing", "collections", "dataclasses", "functools", "math"}
            allowed |= {"numpy"} if name == "config" else set()
            assert other <= allowed, f"{name} imports {other - allowed}"


def test_agent_and_envs_do_not_know_each_other():
    for name, path in modules():
        own, _ = imported(path)
        if name.startswith("envs"):
            assert own <= {
                "config",
                "keys",
                *(f"envs.{file.stem}" for file in (PACKAGE / "envs").glob("[a-z]*.py")),
                "envs",
            }
        if name in ("agent", "cacla", "curiosity", "itm", "predictors", "networks"):
            assert not any(target.startswith("envs") for target in own)


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


@pytest.mark.parametrize("number", [0, 1, 2], ids=["curiosity alone", "a world of one's own", "seeds and sigma"])
def test_readme_examples(number, capsys):
    code = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)[number]
    names: dict = {}
    exec(compile(code, f"README example {number}", "exec"), names)
    said = capsys.readouterr().out
    assert said.startswith(("nodes:", "episodes:", "success by sigma:")[number])
    if number == 0:
        assert int(names["end"].map.live.sum()) > 10
    if number == 1:
        assert int(names["lanes"].episode[0]) == 100
        reached = names["log"].reached[names["log"].done]
        assert float(reached[-30:].mean()) > 0.9 > 0.5 > float(reached[:30].mean())
    if number == 2:
        assert names["success"].shape == (12,)


def test_wheel_in_a_clean_environment(tmp_path):
    """Builds the wheel, installs it and its locked dependencies into a new environment, trains from another folder."""
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path / "dist")]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    venv.create(tmp_path / "clean", with_pip=True)
    python = tmp_path / "clean" / "bin" / "python"
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    locked = tmp_path / "constraints.txt"
    lines = (ROOT / "requirements.lock").read_text().splitlines()
    locked.write_text("\n".join(line.removesuffix(" \\") for line in lines if re.match(r"[a-z0-9]", line)))
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    subprocess.run([*pip, "-c", str(locked), str(wheel)], check=True, env=clean, cwd=tmp_path)
    icac = str(tmp_path / "clean" / "bin" / "icac")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    said = subprocess.run([icac, "--version"], check=True, capture_output=True, text=True, env=clean, cwd=elsewhere)
    assert said.stdout == f"icac_jax {icac_jax.__version__}\n"
    tiny = ["train", "--seeds", "2", "--episodes", "2", "--physics", "kinematic", "--no-cache", "--out", "run"]
    subprocess.run([icac, *tiny], check=True, env=clean, cwd=elsewhere, capture_output=True)
    assert (elsewhere / "run" / "episodes.parquet").is_file()
    planned = subprocess.run(
        [icac, "sweep", "gamma", "--dry-run"], check=True, env=clean, cwd=elsewhere, capture_output=True, text=True
    )
    assert planned.stdout.startswith("C6: ")  # the shipped studies are in the wheel
