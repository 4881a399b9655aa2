"""Growing neural gas, self-organising map and grid: against their references, and what holds for any stimuli."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icac_jax import CuriosityHyper, CuriositySpec, curiosity
from icac_jax.curiosity import gng, grid, lattice, maps, som
from icac_jax.errors import ConfigError
from icac_jax.precision import as_given
from tests.reference.maps import Cells, Gas, Lattice

CAPACITY = 24


def spec_of(kind, size, **choices):
    return CuriositySpec(observation_size=size, state_size=size, action_size=1, map=kind, **choices)


def stimuli_of(seed, number, size, walk=True):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (number, size))
    if walk:
        trail = np.sin(np.cumsum(0.1 * rng.normal(size=(number, size)), axis=0))
        points = np.where(rng.uniform(size=(number, 1)) < 0.3, points, trail)
    return points


class Slots:
    """Which slot each node of the reference has: a new one takes the first free slot."""

    def __init__(self):
        self.of = {0: 0, 1: 1}

    def follow(self, gas, born):
        self.of = {name: slot for name, slot in self.of.items() if name in gas.places}
        if born is not None:
            self.of[born] = min(set(range(CAPACITY)) - set(self.of.values()))

    def arrays(self, gas, size):
        state = gng.GngState(
            weights=np.zeros((CAPACITY, size)),
            live=np.zeros(CAPACITY, bool),
            ages=np.full((CAPACITY, CAPACITY), gng.NONE, np.int32),
            degree=np.zeros(CAPACITY, np.int32),
            errors=np.zeros(CAPACITY),
            steps=np.int32(gas.seen),
            overflow=np.int32(gas.overflow),
        )
        for name, slot in self.of.items():
            state.weights[slot], state.live[slot], state.errors[slot] = gas.places[name], True, gas.errors[name]
        for (one, other), age in ((tuple(pair), age) for pair, age in gas.ages.items()):
            state.ages[self.of[one], self.of[other]] = state.ages[self.of[other], self.of[one]] = age
        state.degree[:] = (state.ages >= 0).sum(1)
        return state


def stack(states):
    return jax.tree.map(lambda *leaves: np.stack(leaves), *states)


@pytest.mark.parametrize(("size", "lam", "a_max"), [(2, 20, 4), (4, 50, 20)])
def test_gas_agrees_with_its_reference_at_every_step(size, lam, a_max):
    """From the reference's state each step, in float64, to 1e-9."""
    rng = np.random.default_rng(size)
    gas = Gas(rng.uniform(-1, 1, size), rng.uniform(-1, 1, size), lam, a_max, 0.2, 0.006, 0.5, 0.995)
    slots = Slots()
    states, said = [slots.arrays(gas, size)], []
    points = stimuli_of(size, 2000, size)
    for point in points:
        before = slots.of
        winner, distance, born = gas.adapt(point, CAPACITY)
        slots.follow(gas, born)
        said.append((before[winner], distance, CAPACITY if born is None else slots.of[born]))
        states.append(slots.arrays(gas, size))
    assert gas.events["cut"] > 20
    assert gas.events["born"] > 20
    assert gas.events["dropped"] > 5 or a_max > 10
    assert gas.overflow > 5 or gas.events["dropped"]
    numbers = CuriosityHyper(gng_interval=lam, gng_max_age=a_max)
    with jax.enable_x64(True), as_given():
        step = jax.jit(jax.vmap(functools.partial(gng.update, hyper=numbers)))
        got, info = jax.device_get(step(stack(states[:-1]), points))
    wanted = stack(states[1:])
    for name in ("live", "ages", "degree", "steps", "overflow"):
        np.testing.assert_array_equal(getattr(got, name), getattr(wanted, name), name)
    np.testing.assert_allclose(got.weights[got.live], wanted.weights[wanted.live], rtol=0, atol=1e-9)
    np.testing.assert_allclose(got.errors, wanted.errors, rtol=1e-9, atol=1e-9)
    winners, distances, started = zip(*said, strict=True)
    np.testing.assert_array_equal(info.node, winners)
    np.testing.assert_array_equal(info.started, started)
    np.testing.assert_array_equal(info.created, np.array(started) < CAPACITY)
    np.testing.assert_allclose(info.distance, distances, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("side", "dimensions", "size"), [(4, 2, 2), (3, 3, 3), (9, 1, 2)])
def test_som_agrees_with_its_reference_all_the_way(side, dimensions, size):
    """Free-running in float64, to 1e-9."""
    points = stimuli_of(side, 600, size)
    numbers = CuriosityHyper(som_decay_steps=400, som_radius=2.0)
    with jax.enable_x64(True), as_given():
        used = som.self_organising_map(side, dimensions, size)
        start = jax.tree.map(lambda leaf: jnp.asarray(leaf, float) if leaf.ndim else leaf, som_start(used, numbers))

        def body(state, point):
            state, info = used.update(state, point, numbers, True)
            return state, (state.weights, info.node, info.distance)

        weights, nodes, distances = jax.device_get(jax.jit(lambda s, p: jax.lax.scan(body, s, p)[1])(start, points))
    places = list(itertools.product(range(side), repeat=dimensions))
    reference = Lattice(dict(zip(places, np.asarray(start.weights), strict=True)), (0.5, 0.01), (2.0, 0.5), 400)
    for step, point in enumerate(points):
        winner, distance = reference.adapt(point)
        assert places[nodes[step]] == winner
        assert distances[step] == pytest.approx(distance, abs=1e-9)
    np.testing.assert_allclose(weights[-1], list(reference.weights.values()), rtol=0, atol=1e-9)


def som_start(used, numbers):
    return jax.device_get(used.init(jax.random.key(0), numbers))


@pytest.mark.parametrize(("side", "size"), [(4, 2), (3, 4), (1, 2)])
def test_grid_agrees_with_its_reference_all_the_way(side, size):
    """Free-running in float32, cells to the bit, distances to 1e-6; beyond the border too."""
    points = (1.3 * stimuli_of(side, 300, size)).astype(np.float32)
    used = grid.grid_map(side, size)

    def body(state, point):
        state, info = used.update(state, point, CuriosityHyper(), True)
        return state, info

    last, info = jax.device_get(jax.lax.scan(body, used.init(jax.random.key(0), CuriosityHyper()), points))
    reference = Cells(side)
    for step, point in enumerate(points.astype(float)):
        cell, distance, new = reference.adapt(point)
        assert lattice.places(side, size)[info.node[step]] == cell
        assert info.distance[step] == pytest.approx(distance, abs=1e-6)
        assert info.created[step] == new
    assert last.live.sum() == len(reference.visited)
    nodes = used.nodes(jax.tree.map(jnp.asarray, last))
    np.testing.assert_array_equal(nodes.edges, np.asarray(nodes.edges).T)
    assert not np.asarray(nodes.edges)[~last.live].any()


KINDS = {
    "gng": {"map_capacity": CAPACITY},
    "som": {"som_side": 3},
    "grid": {"grid_side": 3},
    "itm": {"map_capacity": CAPACITY},
}


@functools.cache
def runner(kind, size=2):
    """A map; a program that feeds stimuli [n, D] to a fresh one where `enabled` [n] says so, with all maps and infos
    along the way; and one that asks a map who wins stimuli [n, D]."""
    used = maps.build(spec_of(kind, size, **KINDS[kind]))

    @jax.jit
    def run(key, points, enabled, numbers):
        def body(state, now):
            state, info = used.update(state, now[0], numbers, now[1])
            return state, (state, info)

        return jax.lax.scan(body, used.init(key, numbers), (points, enabled))[1]

    @jax.jit
    def asked(state, points, numbers):
        return jax.vmap(lambda point: used.update(state, point, numbers, False)[1])(points)

    return used, run, asked


worlds = st.tuples(
    st.integers(0, 2**31 - 1), st.booleans(), st.sampled_from([1, 3, 10, 40]), st.sampled_from([1, 3, 20])
)


def numbers_of(world):
    return CuriosityHyper(gng_interval=world[2], gng_max_age=world[3], e_max=0.4, som_decay_steps=100).traced()


@given(worlds)
@settings(max_examples=40)
def test_structure_of_the_gas_holds_after_every_stimulus(world):
    seed, walk, interval, oldest = world
    points = stimuli_of(seed, 200, 2, walk).astype(np.float32)
    _, run, _ = runner("gng")
    states, info = jax.device_get(run(jax.random.key(seed), points, np.ones(200, bool), numbers_of(world)))
    linked = states.ages >= 0
    np.testing.assert_array_equal(states.ages, states.ages.transpose(0, 2, 1))
    assert not linked[:, np.arange(CAPACITY), np.arange(CAPACITY)].any()
    assert not (linked & ~(states.live[:, :, None] & states.live[:, None, :])).any()
    np.testing.assert_array_equal(states.degree, linked.sum(2))
    assert (states.degree[states.live] > 0).all()
    assert states.ages.max() <= oldest
    assert (states.errors[~states.live] == 0).all()
    assert np.isfinite(states.weights[states.live]).all()
    assert np.abs(states.weights[states.live]).max() <= 1  # none leaves what surrounds the stimuli
    steps = np.arange(200)
    assert states.live[steps, info.node].all()
    # A node is due once in `interval`; it is created or, the map being full, counted.
    due = (steps + 1) % interval == 0
    np.testing.assert_array_equal(due, info.created | (np.diff(states.overflow, prepend=0) > 0))
    np.testing.assert_array_equal(info.started < CAPACITY, info.created)
    assert states.live[steps[info.created], info.started[info.created]].all()
    assert set(np.unique(states.live.sum(1))) <= set(range(2, CAPACITY + 1))


@pytest.mark.parametrize("kind", KINDS)
@given(world=worlds)
@settings(max_examples=10)
def test_a_stimulus_at_a_node_wins_it(kind, world):
    used, run, asked = runner(kind)
    points = stimuli_of(world[0], 200, 2, world[1]).astype(np.float32)
    numbers = numbers_of(world)
    states, _ = run(jax.random.key(world[0]), points, np.ones(200, bool), numbers)
    last = jax.tree.map(lambda leaf: leaf[-1], states)
    nodes = used.nodes(last)
    every = asked(last, nodes.weights, numbers)
    places, live = np.asarray(nodes.weights), np.asarray(nodes.live)
    np.testing.assert_allclose(np.asarray(every.distance)[live], 0, atol=1e-6)
    np.testing.assert_allclose(places[np.asarray(every.node)][live], places[live], atol=1e-6)
    edges = np.asarray(nodes.edges)
    assert not (edges & ~(live[:, None] & live)).any()
    np.testing.assert_array_equal(edges, edges.T)


@pytest.mark.parametrize("kind", KINDS)
def test_where_it_is_not_enabled_nothing_is_written(kind):
    _, run, _ = runner(kind)
    enabled = np.arange(200) % 3 > 0
    points = np.where(enabled[:, None], stimuli_of(5, 200, 2), np.nan).astype(np.float32)
    numbers = CuriosityHyper(gng_interval=2, e_max=0.4).traced()
    states, info = jax.device_get(run(jax.random.key(0), points, enabled, numbers))
    off = ~enabled[1:]
    jax.tree.map(lambda leaf: np.testing.assert_array_equal(leaf[:-1][off], leaf[1:][off]), states)
    assert not info.created[~enabled].any()
    jax.tree.map(lambda leaf: np.testing.assert_array_equal(np.isfinite(leaf), True), states)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_number_stays_in_its_lane(kind):
    _, run, _ = runner(kind)
    points = stimuli_of(6, 2 * 200, 2).astype(np.float32).reshape(2, 200, 2)
    points[1, 50] = np.nan
    enabled = np.ones((2, 200), bool)
    numbers = CuriosityHyper(gng_interval=10, e_max=0.4).traced()
    keys = jax.random.split(jax.random.key(1), 2)
    both = jax.jit(jax.vmap(run, (0, 0, 0, None)))
    spoilt, info = jax.device_get(both(keys, points, enabled, numbers))
    points[1, 50] = 0.0
    sound, _ = jax.device_get(both(keys, points, enabled, numbers))
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[0], b[0]), spoilt, sound)
    assert np.isnan(info.distance[1, 50]) or np.isinf(info.distance[1, 50])  # which freezes the lane


def test_a_slot_that_is_used_again_starts_with_a_fresh_predictor():
    spec = spec_of("gng", 2, map_capacity=8)
    numbers = CuriosityHyper(gng_interval=5, mu=4, T=2).traced()
    update = jax.jit(functools.partial(curiosity.update, spec, hyper=numbers))
    state = curiosity.init(spec, jax.random.key(0), numbers)
    used_before = state.bank.replace(params=state.bank.params + 1.0, queries=state.bank.queries + 7)
    state = state.replace(bank=used_before)
    for step, point in enumerate(stimuli_of(0, 5, 2, walk=False).astype(np.float32)):
        state, info = update(state, point, jnp.zeros(1), point)
        assert bool(info.created) == (step == 4)
    np.testing.assert_array_equal(state.bank.params[2], state.bank.fresh[2])
    assert int(state.bank.queries[2]) == 0
    assert int(state.bank.queries[info.node]) > 7  # the winner was asked, not the new node
    assert int(state.last_created) == 4
    np.testing.assert_array_equal(state.bank.queries[3:], 7)


def test_a_lattice_may_not_have_more_nodes_than_a_map():
    with pytest.raises(ConfigError, match=r"^grid_side: must be at most 25 in 3 dimensions, got 26"):
        maps.build(spec_of("grid", 3, grid_side=26))
    with pytest.raises(ConfigError, match=r"^som_side: must be at most 4 in 7 dimensions, got 5"):
        maps.build(spec_of("som", 3, som_side=5, som_dimensions=7))
    assert maps.build(spec_of("grid", 3, grid_side=25)).capacity == 25**3
    assert maps.build(spec_of("som", 3)) is maps.build(spec_of("som", 3))
