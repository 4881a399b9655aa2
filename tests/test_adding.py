"""What another learner, map, physics and term of the reward cost: one file and one line, here each as a toy."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest

from icac_jax import rollout
from icac_jax.agents import cacla, icac
from icac_jax.agents.curious import curious
from icac_jax.curiosity import TERMS, Map, MapInfo, Nodes
from icac_jax.envs import arms, physics, reach
from tests.conftest import also_on_path, installed
from tests.worlds import line

SPEC = icac.Spec(observation_size=2, state_size=2, action_size=1, map_capacity=16)
INSIDE = cacla.agent(SPEC, cacla.by_variance)

# A whole learner of another package: it pushes all joints by one number, which it changes at random where that pays.
TOY = '''
"""A toy."""

import dataclasses
import functools

import jax
import jax.numpy as jnp

from icac_jax.agents.base import Agent, Report
from icac_jax.agents.registry import Learner
from icac_jax.fields import Numbers, check_record, param


@dataclasses.dataclass(frozen=True)
class Choices:
    """What is fixed when the program is compiled."""

    action_size: int = param(2, "entries of an action", source="own", low=1, derived=True)
    restless: bool = param(True, "change the push now and then", source="own")

    def __post_init__(self):
        check_record(self)


class Amounts(Numbers):
    """The toy's numbers."""

    push: float = param(0.5, "how far the joints are pushed", unit="action bound", source="own", low=0.0, high=1.0)


@functools.cache
def agent(spec):
    def pushed(state):
        return jnp.full(spec.action_size, state)

    def update(state, transition, key, hyper, enabled):
        other = hyper.push * jax.random.uniform(key, minval=-1.0)
        changed = enabled & spec.restless & (transition.reward <= 0)
        report = Report({"changes": changed.astype(float)}, {"last_push": state}, jnp.array(True))
        return jnp.where(changed, other, state), report

    return Agent(
        init=lambda key, hyper: jnp.asarray(hyper.push, float),
        act=lambda state, observation, key, hyper: pushed(state),
        update=update,
        greedy=lambda state, observation, hyper: pushed(state),
    )


LEARNER = Learner("a toy", Choices, Amounts, lambda spec, env: agent(spec))
'''


@pytest.fixture
def packages(tmp_path):
    """The folder of the toy as an installed package: a module and what an installer writes beside it."""
    place = tmp_path / "packages"
    facts = place / "toy_learner-1.0.dist-info"
    facts.mkdir(parents=True)
    (place / "toy_learner.py").write_text(TOY)
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: toy_learner\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text("[icac_jax.learners]\ntoy = toy_learner:LEARNER\n")
    return place


def test_a_learner_of_another_package(icac, packages, tmp_path):
    """Trained in a process of its own; the rest in this one."""
    tiny = ["--algo", "toy", "--physics", "kinematic", "--seeds", "2", "--episodes", "3"]
    done = icac("train", *tiny, "--push", "0.25", "--out", "run", "--json", check=0, env=also_on_path(packages))
    assert json.loads(done.stdout)["failed_seeds"] == {}
    assert "push = 0.25" in (tmp_path / "run" / "config.toml").read_text()
    table = pq.read_table(tmp_path / "run" / "episodes.parquet")
    assert table.column_names[-2:] == ["changes", "last_push"]
    changes, steps, reached, last = (table[name].to_numpy() for name in ("changes", "steps", "reached", "last_push"))
    np.testing.assert_array_equal(changes, steps - reached)
    assert 0 < np.abs(last).max() <= 0.25

    with installed(packages):
        every = "cacla, cacla_var, icac, ddpg, td3, curious_ddpg, curious_td3, toy"
        assert f"--algo decides the options, one of {every}" in icac("train", "--help", check=0).stdout
        page = icac("train", *tiny, "--help", check=0).stdout
        assert "--push" in page
        assert "--sigma" not in page
        assert "--restless" in icac("train", *tiny, "--help-choices", check=0).stdout
        icac("evaluate", "run", "--pairs", "5", check=0)
        refused = icac("train", *tiny, "--e-max", "0.5", check=2).stderr
        assert refused == "icac train: e_max: no option of toy, only of icac, curious_ddpg, curious_td3\n"
        out_of_bounds = icac("train", *tiny, "--push", "2", check=2).stderr
        assert out_of_bounds == "icac train: push: must be a number at least 0 and at most 1, got 2.0\n"
    missing = icac("evaluate", "run", check=2).stderr  # where the package is not installed
    assert "algo: must be one of cacla, cacla_var, icac, ddpg, td3, curious_ddpg, curious_td3, got 'toy'" in missing


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("toy = toy_learner:nothing", "algo: the learner toy of toy_learner:nothing cannot be loaded"),
        ("toy = toy_learner:Amounts", "algo: the learner toy must be a Learner, toy_learner:Amounts is none"),
        ("icac = toy_learner:LEARNER", "algo: the learner icac of toy_learner:LEARNER must have another name"),
    ],
)
def test_a_package_that_is_no_learner_is_named(entry, words, icac, packages):
    (packages / "toy_learner-1.0.dist-info" / "entry_points.txt").write_text(f"[icac_jax.learners]\n{entry}\n")
    with installed(packages):
        said = icac("train", "--seeds", "1", check=2).stderr
    assert words in said
    assert said.count("\n") == 1


def quarters():
    """A map of four fixed nodes, the middles of the quarters of the square; its state is how often each was seen."""
    places = jnp.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]])

    def update(seen, stimulus, hyper, enabled):
        node = (2 * (stimulus[0] > 0) + (stimulus[1] > 0)).astype(jnp.int32)
        distance = jnp.linalg.norm(stimulus - places[node])
        return seen.at[node].add(enabled), MapInfo(node, node, distance, jnp.array(False))

    return Map(
        capacity=4,
        init=lambda key, hyper: jnp.zeros(4, jnp.int32),
        update=update,
        nodes=lambda seen: Nodes(seen > 0, places, None),
        counts=lambda seen: {"quarters_seen": jnp.sum(seen > 0, dtype=jnp.int32)},
    )


def trained(agent, seeds=3, steps=120):
    """Lanes and records of some steps along the line."""
    world, hyper = line(), rollout.broadcast(icac.Hyper(sigma=0.5).traced(), seeds)
    params = jnp.full(seeds, 2.0)
    lanes = rollout.init_lanes(agent, world, jax.random.key(0), jnp.arange(seeds), hyper, params)
    return rollout.run_chunk(agent, world, lanes, hyper, params, jnp.full(seeds, 4), length=steps)


def test_a_map_is_an_argument():
    agent = curious(INSIDE, SPEC, map=quarters())
    lanes, log = trained(agent)
    assert set(log.last) == {"quarters_seen"}
    assert log.last["quarters_seen"][log.done].max() == 2  # the line runs through two of them
    seen = lanes.agent.curiosity.map
    np.testing.assert_array_equal(seen.sum(1), lanes.step)
    np.testing.assert_array_equal(seen, lanes.agent.curiosity.bank.queries)  # a predictor a node
    assert (log.totals["intrinsic_reward"][log.done] > 0).all()
    shown = agent.map.nodes(jax.tree.map(lambda leaf: leaf[0], seen))
    assert shown.weights.shape == (4, 2)


def test_a_term_of_the_reward_is_an_argument():
    def surprise(spec, seen, hyper):
        return 0.25 * seen.predicted.prediction_error

    plain, more = curious(INSIDE, SPEC), curious(INSIDE, SPEC, terms=TERMS | {"surprise": surprise})
    (before, _), (after, log) = trained(plain), trained(more)
    parts = [log.totals[name][log.done] for name in ("learning_progress", "perception_error", "surprise")]
    assert (parts[2] > 0).all()
    np.testing.assert_allclose(log.totals["intrinsic_reward"][log.done], sum(parts), rtol=1e-4)
    assert np.any(np.asarray(before.agent.agent.critic) != np.asarray(after.agent.agent.critic))


def test_a_kind_of_physics_is_a_line_of_the_table(monkeypatch):
    def halfway(arm, sub_steps, cache):
        """Arms that get half as far as they are told."""
        return lambda joints, velocity, target: ((joints + target) / 2, velocity)

    monkeypatch.setitem(physics.PHYSICS, "halfway", halfway)
    params = reach.default_params(arms.PLANAR2).traced()
    moved = {}
    for kind in ("kinematic", "halfway"):
        world = reach.make(arms.PLANAR2, kind)
        state, _ = world.init(jax.random.key(0), params)
        state = state.replace(joints=jnp.radians(jnp.array([80.0, 90.0])))
        moved[kind] = np.degrees(world.step(state, jnp.array([1.0, -0.5]), params)[0].joints) - [80.0, 90.0]
    np.testing.assert_allclose(moved["kinematic"], [10.0, -5.0], rtol=1e-4)
    np.testing.assert_allclose(moved["halfway"], [5.0, -2.5], rtol=1e-4)
