"""Lanes first and lanes last: the same learners to rounding, and what lanes last promises of its program."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax import rollout
from icac_jax import training as training_of_python
from icac_jax.fast import compiling, lanes_last, layouts, sums
from icac_jax.fast.lanes_last import NotFollowed
from icac_jax.runs import devices
from icac_jax.runs.loop import Training
from icac_jax.settings.options import resolve
from tests import operations

pytestmark = pytest.mark.skipif(jax.default_backend() != "cpu", reason="lanes last is for CPUs")

LEARNERS = {
    "nico4": {"arm": "nico4", "physics": "servo"},
    "walls, epsilon greedy, Adam": {"task": "two_walls", "exploration": "epsilon_greedy", "optimizer": "adam"},
    "cacla": {"algo": "cacla", "physics": "servo", "hidden_layers": 2},
    "gng, RND": {"map": "gng", "signal": "rnd"},
    "som, counts": {"map": "som", "signal": "counts"},
    "grid, single predictor": {"map": "grid", "predictors": "single"},
}
# Each of these alone, as a change of ICAC: all that the package's learners without replay can be.
CHOICES = [
    {"preset": "paper-literal"},
    {"map_input": "observation"},
    {"prediction_node": "nearest"},
    {"optimizer": "rmsprop"},
    {"critic_target": "previous"},
    {"spacing_removal": "none"},
    {"prediction_error_time": "after"},
    {"early_learning_progress": "first"},
    {"coverage_bins": 20},
    {"task": "door"},
    {"algo": "cacla_var"},
    *({"signal": name} for name in ("normalised_progress", "signed_progress", "icm", "none", "constant", "shuffled")),
    *({"signal": "learning_progress", "map": name} for name in ("gng", "grid")),
]
# They take `jax.vmap`: they draw by `jax.random`, or have layers wide enough for a library's products.
NOT_FOLLOWED = [{"hindsight": "future"}, {"hidden_units": 64}]


def training(lanes, every_device=False, **options):
    number = None if every_device else 1
    mesh = jax.sharding.Mesh(np.array(jax.local_devices()[:number]), ("lane",))
    chosen = {"arm": "planar2", "algo": "icac", "physics": "kinematic"} | options
    return Training.of_run(resolve(**chosen, seeds=lanes, episodes=10**6), mesh)


def ran(made, steps, last, chunks=1):
    """The lanes after some chunks of so many steps, and the records of the last."""
    lanes, args = made.start(), made.on_lanes(made.first().slots)
    program = made.program._replace(length=steps, lanes_last=last).compiled(lanes, args)
    for _ in range(chunks):
        lanes, log = program(lanes, *args)
    return lanes, log


def plain(tree):
    """Leaves as arrays of numbers."""
    for leaf in jax.tree.leaves(tree):
        yield np.asarray(jax.random.key_data(leaf) if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else leaf)


@pytest.mark.parametrize("name", LEARNERS)
def test_both_layouts_are_the_same_learners(name, monkeypatch):
    """Rounding grows with time, so that it is looked at early: every node, edge, draw and start of an episode."""
    made = training(16, horizon=10, **LEARNERS[name])
    first, log = ran(made, 25, False)
    monkeypatch.setattr(rollout, "LanesFirst", lambda *args: pytest.fail("it is not followed"))
    last, log_last = ran(made, 25, True)
    assert log.done.sum() >= 2 * 16
    for one, other in zip(plain((first, log)), plain((last, log_last)), strict=True):
        if np.issubdtype(one.dtype, np.floating):
            np.testing.assert_allclose(other, one, rtol=2e-3, atol=2e-5)
        else:
            np.testing.assert_array_equal(other, one)


def followed(options):
    made = training(2, **options)

    def step(lanes, *numbers):
        layout = layouts.LanesLast(
            lambda lane, numbers: rollout.step_lane(made.agent, made.env, lane, *numbers),
            lambda lane, numbers, done: rollout.begin_lane(made.env, lane, numbers[1], done),
            lanes,
            numbers,
        )
        return layout.step(layout.enter(lanes))

    jax.eval_shape(step, made.start(), *made.on_lanes(made.first().slots))


@pytest.mark.parametrize("options", CHOICES, ids=str)
def test_every_choice_is_followed(options):
    followed(options)


@pytest.mark.parametrize("options", NOT_FOLLOWED, ids=str)
def test_what_is_not_followed_is_vmapped(options):
    with pytest.raises(NotFollowed):
        followed(options)
    made = training(16, **options)
    for one, other in zip(plain(ran(made, 5, True)), plain(ran(made, 5, False)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-6)  # compiled for other vectors


@pytest.mark.parametrize("settings", [{}, {"arm": "nico4", "physics": "servo"}], ids=["planar2", "nico4 servo"])
def test_a_learner_is_the_same_to_the_bit_in_any_company(settings):
    """However many learners there are, on however many devices, in chunks of any length: all blocks are of one size."""
    few, _ = ran(training(3, **settings), 60, True, chunks=2)
    many, _ = ran(training(40, every_device=True, **settings), 120, True)
    assert few.episode.sum() > 0
    for one, other in zip(plain(few), plain(many), strict=True):
        np.testing.assert_array_equal(one[:3], other[:3])


@pytest.mark.parametrize("settings", [{}, {"arm": "nico4", "physics": "servo"}], ids=["planar2", "nico4 servo"])
def test_a_chunk_is_one_kernel(settings):
    """XLA starts a few operations per chunk, not some hundred per step."""
    made = training(16, **settings)
    lanes, args = made.start(), made.on_lanes(made.first().slots)
    program = made.program._replace(length=100).compiled(lanes, args)
    assert 0 < operations.started(lambda: program(lanes, *args)) < 100


def test_what_is_needed_twice_is_computed_once():
    """Without the calls that hold values, XLA computes the noise anew for every unit of the predictor behind it."""
    made = training(16, arm="nico4")
    lanes, args = made.start(), made.on_lanes(made.first().slots)
    text = made.program._replace(length=20).compiled(lanes, args).as_text()
    assert len(re.findall(r" call\(.*inlineable=.false", text)) > 200
    drawn = [line for line in text.splitlines() if re.search(r"op_name=\"[^\"]*erf_inv", line) and " log(" in line]
    assert len(drawn) <= 2, drawn


def test_no_step_copies_a_whole_map():
    """Adjacency, predictors and errors of all nodes are written in place, a row or column at a time."""
    made = training(16, map_capacity=96)
    lanes, args = made.start(), made.on_lanes(made.first().slots)
    text = made.program._replace(length=20).compiled(lanes, args).as_text()
    large = re.compile(r"^\s+(?:ROOT )?%?(\S+) = \w+\[16,96,(?:60|86|96)\]\S* (?:copy|select|fusion|transpose)\(")
    written = [match[1] for line in text.splitlines() if (match := large.match(line))]
    assert len(written) >= 4
    assert all("dynamic-update-slice" in name for name in written), written


def test_halves_are_combined_whatever_their_number():
    for number in (1, 2, 3, 7, 16, 109):
        values = jnp.arange(number * 2, dtype=jnp.float32).reshape(number, 2)
        np.testing.assert_array_equal(sums.halved(jnp.add, values), values.sum(0))


def test_a_scan_of_arrays_is_not_followed():
    closed = jax.make_jaxpr(lambda x: jax.lax.scan(lambda c, y: (c + y, c), x[0], x))(jnp.ones(3))
    with pytest.raises(NotFollowed):
        jax.eval_shape(
            lambda x: [v.array for v in lanes_last.follow(lanes_last.flat(closed), [lanes_last.Spread(x)], 4)],
            jnp.ones((3, 4)),
        )


def test_loops_are_kept_unless_the_user_says_otherwise(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_dump_hlo_as_text")
    devices.keep_loops()
    devices.keep_loops()
    kept = "--xla_backend_extra_options=xla_cpu_disable_loop_unrolling=true"
    assert devices.os.environ["XLA_FLAGS"] == f"--xla_dump_hlo_as_text {kept}"
    monkeypatch.setenv("XLA_FLAGS", "--xla_backend_extra_options=xla_cpu_optimize_for_size=true")
    devices.keep_loops()
    assert devices.os.environ["XLA_FLAGS"] == "--xla_backend_extra_options=xla_cpu_optimize_for_size=true"


def test_replaying_learners_and_other_machines_have_lanes_first():
    assert devices.lanes_last()
    assert not devices.lanes_last(large=True)
    assert compiling.WIDE.items() <= {"xla_cpu_prefer_vector_width": 512}.items()


@pytest.mark.parametrize(
    ("chosen", "kept"),
    [({}, True), ({"preset": "best"}, False), ({"agent": "td3"}, False), ({"agent": "cacla"}, True)],
    ids=str,
)
def test_loops_are_kept_for_learners_without_replay(chosen, kept, monkeypatch):
    """From Python too, where a preset may name the learner."""
    asked = []
    monkeypatch.setattr(devices, "keep_loops", lambda: asked.append(True))
    monkeypatch.setattr(training_of_python, "_train", lambda *_: None)
    training_of_python.train("nico4", seeds=1, episodes=1, **chosen)
    assert asked == [True] * kept
