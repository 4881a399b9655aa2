"""Whatever JAX has been told: training and the pure functions give the same as without, in the same float32."""

import json
import subprocess
import sys

import numpy as np
import pytest

FUNCTIONS = """
import sys
import jax
import jax.numpy as jnp
import numpy as np

for name, value in zip(sys.argv[1::2], sys.argv[2::2]):
    jax.config.update(name, {"True": True, "False": False}.get(value, value))
import icac_jax
from icac_jax import curiosity
from icac_jax.agents import cacla
from icac_jax.curiosity import itm


def show(*trees):
    for leaf in jax.tree.leaves(trees):
        assert leaf.dtype in (jnp.float32, jnp.int32, jnp.uint32, jnp.bool_), leaf.dtype
        print(leaf.dtype, np.round(np.atleast_1d(leaf).astype(float), 4).tolist())


at = np.linspace(-1, 1, 4).astype(np.float32)
choices = dict(action_size=2, state_size=4, observation_size=4, map_capacity=8)
for more in ({}, {"predictors": "single"}, {"prediction_node": "nearest"}):
    spec = curiosity.CuriositySpec(**choices, **more)
    hyper = curiosity.CuriosityHyper(e_max=0.5)
    for numbers in (hyper, hyper.traced()):
        state = curiosity.init(spec, jax.random.key(0), numbers)
        for step in range(4):
            seen = (jnp.asarray(at * step / 4), jnp.full(2, 0.5, jnp.float32), jnp.asarray(at * (step + 1) / 4))
            state, info = curiosity.update(spec, state, *seen, numbers)
            show(info)
        show(state)

for rate, e_max in ((0.1, 0.3), (jnp.float32(0.1), np.float32(0.3))):
    graph = itm.init(jax.random.key(0), 8, 2)
    for step in range(6):
        graph, info = itm.update(graph, jnp.full(2, 0.2 * step, jnp.float32), rate=rate, e_max=e_max)
        show(info)
    show(graph)

for more in ({}, {"optimizer": "adam"}, {"optimizer": "rmsprop"}, {"exploration": "epsilon_greedy"}):
    spec = cacla.CaclaSpec(observation_size=4, action_size=2, **more)
    hyper = cacla.CaclaHyper()
    for numbers in (hyper, hyper.traced()):
        for repeats in (cacla.once, cacla.by_variance):
            state = cacla.init(spec, jax.random.key(1), numbers)
            for step in range(3):
                action = cacla.act(spec, state, jnp.asarray(at), jax.random.key(step), numbers)
                moved = (jnp.asarray(at), action, jnp.float32(step), jnp.asarray(at / 2), jnp.bool_(step == 2))
                state, info = cacla.update(spec, state, *moved, numbers, repeats=repeats)
                show(action, info)
            show(state)
"""
TRAINING = """
import sys
import jax
import numpy as np

for name, value in zip(sys.argv[1::2], sys.argv[2::2]):
    jax.config.update(name, {"True": True, "False": False}.get(value, value))
import icac_jax
from icac_jax.runs import loop

tiny = "jax_disable_jit" in sys.argv or "jax_debug_infs" in sys.argv
short = {"horizon": 4} if tiny else {}
shared = {"seeds": 2, "episodes": 1 if tiny else 2, "physics": "kinematic"}
loop.CHUNK_STEPS = 4 if tiny else 50
for algo in ("cacla", "icac"):
    options = shared if algo == "cacla" else shared | {"map_capacity": 8}
    for given in ({}, {"sigma": np.array([[0.1], [0.2]])}):
        got = icac_jax.train("planar2", algo, **options, **short, **given)
        for name, values in {"success": got.success, **got.episodes}.items():
            print(name, values.dtype, np.round(values.astype(float), 3).tolist())
        if short:
            break
"""
SETTINGS = [
    ("jax_enable_x64", "True"),
    ("jax_numpy_dtype_promotion", "strict"),
    ("jax_numpy_rank_promotion", "raise"),
    ("jax_debug_nans", "True"),
]


def said(code, *args):
    command = [sys.executable, "-W", "error", "-c", code, *args]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return [line.partition("[") for line in done.stdout.splitlines()]


def same(one, other):
    """Whether two programs said the same types and the same numbers up to the rounding of another compilation."""
    numbers = [[np.array(json.loads(f"[{values}"), float) for _, _, values in each] for each in (one, other)]
    return [kind for kind, *_ in one] == [kind for kind, *_ in other] and all(
        np.allclose(a, b, atol=2e-3, equal_nan=True) for a, b in zip(*numbers, strict=True)
    )


@pytest.fixture(scope="module")
def plain():
    """What is said under JAX's defaults, by program."""
    default = ("jax_numpy_dtype_promotion", "standard")
    return said(FUNCTIONS, *default), said(TRAINING, *default)


@pytest.mark.slow
def test_the_pure_functions_work_under_all_of_them():
    """What they give is compared by the slow tests, setting by setting; here types are asserted."""
    assert said(FUNCTIONS, *(word for setting in SETTINGS for word in setting))


@pytest.mark.slow
@pytest.mark.parametrize("setting", [*SETTINGS, ("jax_disable_jit", "True")], ids=lambda setting: setting[0])
def test_the_pure_functions_are_the_same(setting, plain):
    assert same(said(FUNCTIONS, *setting), plain[0])


@pytest.mark.slow
@pytest.mark.parametrize("setting", SETTINGS, ids=lambda setting: setting[0])
def test_training_is_the_same(setting, plain):
    assert same(said(TRAINING, *setting), plain[1])


@pytest.mark.slow
def test_training_without_a_compiler():
    """Each operation by itself takes minutes for a run that is not tiny."""
    tiny = ("jax_debug_infs", "False")  # as short, and with a compiler
    assert same(said(TRAINING, "jax_disable_jit", "True"), said(TRAINING, *tiny))
