"""What is kept between starts: the same to the bit, never trusted when damaged, never needed."""

import copy
import json
import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest

from icac_jax.envs import arms
from icac_jax.envs.physics import step_function
from icac_jax.fast import arithmetic, scalars
from icac_jax.runs import cache
from icac_jax.runs.cache import Cache

TINY = ["--algo", "cacla", "--physics", "kinematic", "--seeds", "2", "--episodes", "1"]


def described():
    """A little of everything: a constant, a comparison, a conversion, a square root."""
    function = scalars.unrolled(lambda x, y: (jnp.where(x > 0.1, x / 3.0, y), jnp.sqrt(y[0]) ** 3), (2,), (2,))
    return function, function.as_json()


@pytest.mark.parametrize("arm", [arms.PLANAR2, arms.NICO4], ids=lambda arm: arm.name)
def test_a_kept_step_is_the_traced_one(arm):
    found = []

    class Kept:
        def arithmetic(self, facts, trace):
            found.append(trace())
            return found[0]

    step_function.__wrapped__(arm, cache=Kept())
    (traced,) = found
    again = arithmetic.from_json(json.loads(json.dumps(traced.as_json())))
    assert (again.shapes, again.operations, again.results) == (traced.shapes, traced.operations, traced.results)
    zeros = [jax.ShapeDtypeStruct((arm.joints,), jnp.float32)] * 3
    assert jax.jit(again).lower(*zeros).as_text() == jax.jit(traced).lower(*zeros).as_text()


def test_other_things_than_arithmetic_are_refused():
    _, good = described()
    assert arithmetic.from_json(good).as_json() == good
    wrong = [None, 3, [], {}, "text"]
    changes = {
        "another primitive": lambda d: d["operations"][0].__setitem__(0, "while"),
        "a place to come": lambda d: d["operations"][0].__setitem__(2, 999),
        "a negative place": lambda d: d["operations"][0].__setitem__(2, -1),
        "a constant of text": lambda d: d["operations"][0].__setitem__(2, ["float32", "1"]),
        "another type": lambda d: d["operations"][0].__setitem__(2, ["object", 1]),
        "no params": lambda d: d["operations"][0].__setitem__(1, 5),
        "a conversion": lambda d: d["operations"][0].__setitem__(1, {"new_dtype": "object"}),
        "a result too short": lambda d: d["results"][0][1].pop(),
        "a shape": lambda d: d["shapes"].__setitem__(0, [-2]),
    }
    for change in changes.values():
        wrong.append(copy.deepcopy(good))
        change(wrong[-1])
    for data in wrong:
        with pytest.raises(ValueError):  # noqa: PT011  (any line will do: nobody reads it)
            arithmetic.from_json(data)


def test_computed_once_and_anew_when_damaged(tmp_path):
    computed, keeper = [], Cache(tmp_path / "kept")

    def compute():
        computed.append(1)
        return {"mean": 9.25}

    def kept_once_more(facts=b"a task"):
        assert keeper.kept("oracle", facts, compute) == {"mean": 9.25}
        return len(computed)

    assert [kept_once_more(), kept_once_more()] == [1, 1]
    assert kept_once_more(b"another task") == 2
    path, _ = sorted(keeper.folder.iterdir(), key=lambda p: p.stat().st_mtime)
    whole = path.read_bytes()
    digit = whole.replace(b"9.25", b"9.75")
    for number, damaged in enumerate([b"", whole[:-3], digit, b"\xff\xfe" + whole, b"[" * 10000], start=3):
        path.write_bytes(damaged)
        assert [kept_once_more(), kept_once_more()] == [number, number]
        assert path.read_bytes() == whole


def test_without_a_folder_everything_is_computed():
    function, _ = described()
    assert Cache().folder is None
    for _ in range(2):
        assert Cache().arithmetic(b"model", lambda: function) is function
        assert Cache().kept("oracle", b"", lambda: 3) == 3


def test_a_folder_that_cannot_be_written_costs_only_time(tmp_path):
    (tmp_path / "kept").write_text("a file in the way")
    computed = []
    for _ in range(2):
        Cache(tmp_path / "kept").kept("oracle", b"", lambda: computed.append(1))
    assert len(computed) == 2


def test_arithmetic_that_was_kept_wrong_is_traced_anew(tmp_path):
    """A file may be whole and still be none of these: nothing of it is run."""
    function, written = described()
    traced, keeper = [], Cache(tmp_path)

    def trace():
        traced.append(1)
        return function

    assert keeper.arithmetic(b"model", trace).as_json() == written
    assert keeper.arithmetic(b"model", trace).as_json() == written
    assert len(traced) == 1
    (path,) = tmp_path.iterdir()
    cache._write(path, {"operations": [["exec", {}, "print(1)"]]})
    assert keeper.arithmetic(b"model", trace).as_json() == written
    assert len(traced) == 2


def test_a_second_start_loads_little(icac, tmp_path):
    """What takes long to load is not, once physics and oracle are kept; drawing is loaded for the report alone."""
    icac("train", *TINY, "--out", "first", check=0, env={})
    code = """
import sys
from icac_jax.cli import main
from icac_jax.runs import train

slow = {'mujoco.mjx', 'scipy', 'matplotlib', 'gymnasium', 'ray'}
whole = train.train

def trained(*args):
    result = whole(*args)
    loaded.append(slow & set(sys.modules))
    return result

loaded, train.train = [], trained
status = main.main(sys.argv[1:])
print([*loaded, slow & set(sys.modules)] if "--no-report" in sys.argv else loaded)
sys.exit(status)
"""

    def second(*more):
        place = tmp_path / f"second{len(more)}"
        command = [sys.executable, "-c", code, "train", *TINY, "--json", "--out", str(place), *more]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert (place / "report.html").exists() != bool(more)
        return done.stdout.splitlines()

    summary, loaded = second()
    assert loaded == "[set()]"  # when training was over
    assert second("--no-report")[1] == "[set(), set()]"  # and to the end
    assert (
        json.loads(summary)["oracle_steps"] == json.loads((tmp_path / "first/summary.json").read_text())["oracle_steps"]
    )


def test_without_cache_nothing_is_kept(icac, tmp_path):
    icac("train", *TINY, "--no-cache", "--out", "run", check=0, env={"XDG_CACHE_HOME": str(tmp_path / "cache")})
    assert not (tmp_path / "cache").exists()
