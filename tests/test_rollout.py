"""Lanes: exact episode counts, independence, freezing, failure, one compile, the device mesh."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax import rollout
from icac_jax.agents import icac, registry
from icac_jax.agents.icac import Hyper, Spec
from icac_jax.envs import arms, reach
from icac_jax.fields import ConfigError
from icac_jax.runs import devices, loop
from icac_jax.settings.options import resolve
from tests.worlds import learner, line

AGENT = icac.agent(Spec(observation_size=2, state_size=2, action_size=1, map_capacity=32))
WORLD = line()
PLANAR = icac.agent(Spec(map_capacity=32))


def same(first, second):
    def check(a, b):
        if jnp.issubdtype(a.dtype, jax.dtypes.prng_key):
            a, b = jax.random.key_data(a), jax.random.key_data(b)
        np.testing.assert_array_equal(a, b)

    jax.tree.map(check, first, second)


def start(agent, env, seeds, hyper, params, root=0):
    return rollout.init_lanes(agent, env, jax.random.key(root), jnp.asarray(seeds), hyper, params)


def line_run(seeds=range(5), episodes=10, length=300, agent=AGENT, hyper=None, chunks=1):
    width = len(seeds)
    hyper = hyper if hyper is not None else rollout.broadcast(Hyper(sigma=0.5).traced(), width)
    params = jnp.full(width, 2.0)
    lanes = start(agent, WORLD, list(seeds), hyper, params)
    logs = []
    for _ in range(chunks):
        lanes, log = rollout.run_chunk(agent, WORLD, lanes, hyper, params, jnp.full(width, episodes), length=length)
        logs.append(log)
    return lanes, jax.tree.map(lambda *parts: np.concatenate(parts), *logs)


def test_every_lane_runs_exactly_its_episodes():
    lanes, log = line_run()
    assert lanes.episode.tolist() == [10] * 5
    for lane in range(5):
        mine = log.done[:, lane]
        assert log.episode[mine, lane].tolist() == list(range(10))
        steps = log.totals["steps"][mine, lane]
        reached = log.reached[mine, lane]
        assert steps.max() <= 20
        assert (steps[~reached] == 20).all()
        np.testing.assert_array_equal(log.totals["extrinsic_reward"][mine, lane], 10.0 * reached)
        np.testing.assert_allclose(
            log.totals["intrinsic_reward"][mine, lane],
            log.totals["learning_progress"][mine, lane] + log.totals["perception_error"][mine, lane],
            rtol=1e-4,
        )
        assert int(lanes.step[lane]) == steps.sum()


def test_finished_lanes_do_not_change():
    lanes, _ = line_run(length=250)
    kept = jax.tree.map(jnp.copy, lanes)
    hyper = rollout.broadcast(Hyper(sigma=0.5).traced(), 5)
    after, log = rollout.run_chunk(AGENT, WORLD, lanes, hyper, jnp.full(5, 2.0), jnp.full(5, 10), length=300)
    assert not log.done.any()
    same(after, kept)


def test_chunk_length_does_not_matter():
    one, log = line_run(length=300)
    many, logs = line_run(length=50, chunks=6)
    same(one, many)
    jax.tree.map(np.testing.assert_array_equal, log, logs)


def test_lanes_do_not_influence_each_other():
    plain = rollout.broadcast(Hyper(sigma=0.5).traced(), 5)
    changed = plain.replace(gamma=plain.gamma.at[3].set(0.1), e_max=plain.e_max.at[3].set(0.2))
    (first, _), (second, _) = line_run(hyper=plain), line_run(hyper=changed)
    equal = jax.tree.map(
        lambda a, b: np.asarray([np.array_equal(x, y) for x, y in zip(a, b, strict=True)]),
        jax.device_get(first.agent),
        jax.device_get(second.agent),
    )
    equal = np.all(np.array(jax.tree.leaves(equal)), axis=0)
    assert equal.tolist() == [True, True, True, False, True]


def test_a_seed_is_the_same_learner_in_any_batch():
    """Seed 7 alone and among 20, on the arm, over its first episode."""
    env = reach.make(arms.PLANAR2, "kinematic")
    logs = {}
    for seeds in ([7], list(range(20))):
        hyper = rollout.broadcast(Hyper(sigma=0.57).traced(), len(seeds))
        params = rollout.broadcast(reach.default_params(arms.PLANAR2).traced(), len(seeds))
        lanes = start(PLANAR, env, seeds, hyper, params)
        lanes, log = rollout.run_chunk(PLANAR, env, lanes, hyper, params, jnp.full(len(seeds), 1), length=50)
        where = seeds.index(7)
        logs[len(seeds)] = (
            jax.tree.map(lambda leaf, at=where: np.asarray(leaf[:, at]), log),
            jax.tree.map(lambda leaf, at=where: np.asarray(leaf[at]), lanes.agent),
        )
    (alone, one), (among, second) = logs[1], logs[20]
    assert alone.done.sum() == 1
    np.testing.assert_array_equal(alone.done, among.done)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5), alone, among)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4), one.agent, second.agent)


def test_algorithms_meet_the_same_starts_and_goals():
    begun = []
    for algo in registry.learners():
        agent, numbers = learner(algo, WORLD)
        hyper = rollout.broadcast(numbers.traced(), 2)
        begun.append(np.asarray(start(agent, WORLD, [0, 1], hyper, jnp.ones(2)).observation))
    assert len(begun) >= 3
    for other in begun[1:]:
        np.testing.assert_array_equal(begun[0], other)
    assert (begun[0][0] != begun[0][1]).any()


def test_a_diverging_lane_is_frozen_and_the_others_finish():
    plain = rollout.broadcast(Hyper(sigma=0.5).traced(), 5)
    wild = plain.replace(critic_rate=plain.critic_rate.at[2].set(1e30))
    (calm, _), (lanes, log) = line_run(hyper=plain), line_run(hyper=wild)
    assert lanes.failed.tolist() == [False, False, True, False, False]
    assert lanes.episode.tolist()[:2] == [10, 10]
    assert int(lanes.episode[2]) < 10
    for keep in (0, 1, 3, 4):
        jax.tree.map(
            lambda a, b, at=keep: np.testing.assert_array_equal(a[at], b[at]),
            jax.device_get(lanes.agent),
            jax.device_get(calm.agent),
        )
    assert np.isfinite(log.totals["intrinsic_reward"][log.done]).all()
    assert np.isfinite(log.totals["extrinsic_reward"][log.done]).all()


@pytest.mark.parametrize("bad", ["observation", "reward"])
def test_a_world_that_breaks_freezes_its_lane(bad):
    world = line()

    def step(state, action, params):
        state, seen = world.step(state, action, params)
        broken = jnp.where(state[1] > 5, jnp.nan, 0.0)
        return state, seen._replace(**{bad: getattr(seen, bad) + broken})

    env = world._replace(step=step)
    hyper = rollout.broadcast(Hyper().traced(), 2)
    lanes = start(AGENT, env, [0, 1], hyper, jnp.full(2, 0.01))
    lanes, log = rollout.run_chunk(AGENT, env, lanes, hyper, jnp.full(2, 0.01), jnp.full(2, 3), length=30)
    assert lanes.failed.all()
    assert lanes.step.tolist() == [6, 6]
    assert not log.done.any()


def test_what_a_learner_reports_is_what_is_recorded():
    hyper = rollout.broadcast(Hyper().traced(), 2)
    _, log = rollout.run_chunk(
        AGENT, WORLD, start(AGENT, WORLD, [0, 1], hyper, jnp.ones(2)), hyper, jnp.ones(2), jnp.full(2, 1), length=5
    )
    reported = ["intrinsic_reward", "learning_progress", "perception_error"]
    assert sorted(log.totals) == sorted(["steps", "extrinsic_reward", *reported])
    assert sorted(log.last) == ["live_nodes", "overflow"]


@pytest.mark.parametrize("name", ["seed", "extrinsic_reward", "live_nodes"])
def test_a_column_of_another_is_refused(name):
    def update(*args):
        state, report = AGENT.update(*args)
        return state, report._replace(sums=report.sums | {name: jnp.zeros(())})

    agent = AGENT._replace(update=update)
    hyper = rollout.broadcast(Hyper().traced(), 1)
    with pytest.raises(ConfigError, match=f"report: {name} must be the name of one column only"):
        start(agent, WORLD, [0], hyper, jnp.ones(1))


def test_one_compile_for_chunks_and_grids_of_one_shape():
    env = reach.make(arms.PLANAR2, "kinematic")
    before = rollout.run_chunk._cache_size()
    for grid in (jnp.linspace(0.1, 0.9, 4), jnp.linspace(0.5, 0.99, 4)):
        hyper = rollout.broadcast(Hyper().traced(), 4).replace(gamma=grid, sigma=grid / 2)
        params = rollout.broadcast(reach.default_params(arms.PLANAR2).traced(), 4)
        params = params.replace(reset_range=grid, horizon=jnp.arange(5, 9))
        lanes = start(PLANAR, env, [0, 0, 1, 1], hyper, params)
        for _ in range(2):
            lanes, _ = rollout.run_chunk(PLANAR, env, lanes, hyper, params, jnp.full(4, 9), length=20)
    assert rollout.run_chunk._cache_size() - before == 1


def compiled_text(mesh=None, width=4, capacity=96):
    agent = icac.agent(Spec(map_capacity=capacity))
    env = reach.make(arms.PLANAR2, "kinematic")
    hyper = rollout.broadcast(Hyper().traced(), width)
    params = rollout.broadcast(reach.default_params(arms.PLANAR2).traced(), width)
    lanes = start(agent, env, range(width), hyper, params)
    args = (agent, env, lanes, hyper, params, jnp.full(width, 9))
    return rollout.run_chunk.lower(*args, length=20, mesh=mesh).compile().as_text()


def test_step_copies_no_whole_map():
    """Copies of [lanes, N, N] and [lanes, N, ...] arrays may stand before and after the loop over steps, not in it."""
    text = compiled_text()
    bodies = re.split(r"\n(?=%|ENTRY)", text)
    looped = [body for body in bodies if not body.startswith("ENTRY")]
    large = re.compile(r"= \w+\[4,96(?:,\d+)+\]\S* (?:copy|select)\(")
    assert not [line for body in looped for line in body.splitlines() if large.search(line)]


@pytest.mark.skipif(jax.device_count() < 2, reason="needs two devices")
def test_lanes_spread_over_devices_without_collectives():
    mesh = devices.lane_mesh(4)
    assert mesh.size == 2
    text = compiled_text(mesh)
    assert not re.search(r"all-reduce|all-gather|all-to-all|collective-permute|reduce-scatter", text)


@pytest.mark.skipif(jax.device_count() < 2, reason="needs two devices")
def test_a_mesh_gives_the_same_episodes():
    hyper = rollout.broadcast(Hyper(sigma=0.5).traced(), 4)
    params = jnp.full(4, 2.0)
    _, plain = line_run(seeds=range(4), length=200)
    mesh = devices.lane_mesh(4)
    lanes = start(AGENT, WORLD, range(4), hyper, params)
    placed = jax.device_put((lanes, hyper, params, jnp.full(4, 10)), devices.over_lanes(mesh))
    _, spread = rollout.run_chunk(AGENT, WORLD, *placed, length=200, mesh=mesh)
    np.testing.assert_array_equal(plain.done, spread.done)
    np.testing.assert_allclose(
        plain.totals["intrinsic_reward"], spread.totals["intrinsic_reward"], rtol=1e-4, atol=1e-5
    )


@pytest.mark.parametrize("blocks", [2, 3])
def test_blocks_run_one_after_the_other_and_keep_their_order(blocks):
    hyper = rollout.broadcast(Hyper(sigma=0.5).traced(), 6)
    params = jnp.full(6, 2.0)
    plain, log = line_run(seeds=range(6), length=200)
    lanes = start(AGENT, WORLD, range(6), hyper, params)
    ran, parted = rollout.run_chunk(AGENT, WORLD, lanes, hyper, params, jnp.full(6, 10), length=200, blocks=blocks)
    np.testing.assert_array_equal(ran.step, plain.step)
    np.testing.assert_array_equal(jax.random.key_data(ran.noise_key), jax.random.key_data(plain.noise_key))
    np.testing.assert_allclose(ran.agent.agent.actor, plain.agent.agent.actor, rtol=1e-4, atol=1e-5)
    for one, other in zip(jax.tree.leaves(parted), jax.tree.leaves(log), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("lanes", "number", "padded"), [(1, 1, 32), (20, 1, 32), (33, 2, 64), (65, 3, 96), (640, 20, 640)]
)
def test_every_block_has_the_lanes_of_a_vector(lanes, number, padded):
    """Two devices of as many lanes, in blocks of sixteen; learners with replay run together, without padding."""

    class Mesh:
        size = 2

    assert devices.blocks(lanes, Mesh) == (number, padded)
    assert devices.blocks(lanes, Mesh, large=True) == (1, 2 * -(-lanes // 2))


def test_a_run_of_several_blocks_trains_every_seed(monkeypatch):
    monkeypatch.setattr(devices, "LANES_PER_BLOCK", 2)
    training = loop.Training.of_run(resolve(algo="cacla", physics="kinematic", seeds=7, episodes=3))
    assert training.program.blocks > 1
    assert training.padded > 7
    tables = [chunk.table for chunk in training.chunks(training.start())]
    seeds = np.concatenate([table["seed"].to_numpy() for table in tables])
    assert np.bincount(seeds).tolist() == [3] * 7
