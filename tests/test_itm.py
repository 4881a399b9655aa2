"""Properties of the map (Algorithm 1) that hold for any stimuli, and its known sizes."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from icac_jax.curiosity import itm


@functools.cache
def runner(capacity, size):
    """Feeds stimuli [n, D] to a fresh map; returns all maps and infos along the way."""

    @jax.jit
    def run(key, stimuli, rate, e_max):
        def body(state, stimulus):
            state, info = itm.update(state, stimulus, rate=rate, e_max=e_max)
            return state, (state, info)

        start = itm.init(key, capacity, size)
        return jax.lax.scan(body, start, stimuli)[1]

    return run


def uniform(seed, number, size):
    return np.random.default_rng(seed).uniform(-1, 1, (number, size)).astype(np.float32)


worlds = st.tuples(
    st.integers(0, 2**31 - 1),
    st.sampled_from([2, 4]),
    st.floats(0.2, 1.5),
    st.sampled_from([1e-4, 0.05, 0.3, 1.0]),
    st.booleans(),
)


def stimuli_of(world):
    seed, size, e_max, rate, walk = world
    points = uniform(seed, 300, size)
    if walk:
        points = np.sin(np.cumsum(0.2 * points, axis=0)).astype(np.float32)
    return jax.device_get(runner(32, size)(jax.random.key(seed), points, rate, e_max)), points


@given(worlds)
def test_structure_holds_after_every_stimulus(world):
    (maps, info), _ = stimuli_of(world)
    adjacency, live = maps.adjacency, maps.live
    np.testing.assert_array_equal(adjacency, adjacency.transpose(0, 2, 1))
    assert not adjacency[:, np.arange(32), np.arange(32)].any()
    assert not (adjacency & ~(live[:, :, None] & live[:, None, :])).any()
    np.testing.assert_array_equal(maps.degree, adjacency.sum(2))
    assert live.sum(1).min() >= 2
    assert np.isfinite(maps.weights[live]).all()
    # The winner lives; so does the node that answers for the stimulus.
    steps = np.arange(len(live))
    assert live[steps, info.nearest].all()
    assert live[steps, info.node].all()
    # A step that could create a node and did not for want of room is counted.
    grown = np.diff(maps.overflow, prepend=0)
    assert set(np.unique(grown)) <= {0, 1}
    assert not (grown & info.created).any()


@given(worlds)
def test_winner_pair_keeps_its_distance(world):
    (maps, info), _ = stimuli_of(world)
    e_max = np.float32(world[2])
    steps = np.arange(len(maps.live))
    pair = maps.live[steps, info.second] & (maps.live.sum(1) > 2)
    apart = np.linalg.norm(maps.weights[steps, info.nearest] - maps.weights[steps, info.second], axis=1)
    assert (apart[pair] >= 0.5 * e_max * (1 - 1e-5)).all()


@given(worlds)
def test_no_live_node_lost_its_last_edge_to_line_6(world):
    (maps, _), _ = stimuli_of(world)
    # Line 8 deletes a node that line 6 left without an edge; only line 20 (which deletes n') can leave one bare.
    before, after = maps.degree[:-1], maps.degree[1:]
    bare = maps.live[1:] & maps.live[:-1] & (after == 0) & (before > 0)
    for step in np.flatnonzero(bare.any(1)):
        removed = maps.live[step] & ~maps.live[step + 1]
        assert removed.any()
        for slot in np.flatnonzero(bare[step]):
            assert (maps.adjacency[step, slot] & removed).any()


@given(worlds, st.randoms(use_true_random=False))
def test_permuting_slots_changes_nothing_but_the_slots(world, random):
    (maps, _), points = stimuli_of(world)
    _, _, e_max, rate, _ = world
    order = list(range(32))
    random.shuffle(order)
    order = np.array(order)
    step = functools.partial(itm.update, rate=np.float32(rate), e_max=np.float32(e_max))
    place = random.randrange(len(points) - 1)
    state = jax.tree.map(lambda leaf: jnp.asarray(leaf[place]), maps)
    shuffled = state.replace(
        weights=state.weights[order],
        live=state.live[order],
        adjacency=state.adjacency[order][:, order],
        degree=state.degree[order],
    )
    (plain, said), (mixed, told) = step(state, points[place + 1]), step(shuffled, points[place + 1])
    assert order[told.nearest] == said.nearest
    assert bool(told.created) == bool(said.created)
    known = jnp.sort(jnp.where(plain.live, plain.weights[:, 0], jnp.inf))
    np.testing.assert_allclose(jnp.sort(jnp.where(mixed.live, mixed.weights[:, 0], jnp.inf)), known, rtol=1e-6)
    np.testing.assert_array_equal(np.sort(mixed.degree), np.sort(plain.degree))


@pytest.mark.parametrize(("size", "e_max"), [(2, 0.2), (4, 0.6)])
def test_new_edges_are_delaunay(size, e_max):
    points = uniform(7, 600, size)
    maps, info = jax.device_get(runner(160, size)(jax.random.key(1), points, 0.0, e_max))
    checked = 0
    for step in range(40, 600):
        n, second, live = info.nearest[step], info.second[step], maps.live[step - 1]
        if maps.adjacency[step - 1, n, second]:
            continue
        slots = list(np.flatnonzero(live))
        ends, starts = Delaunay(maps.weights[step - 1][live], qhull_options="QJ").vertex_neighbor_vertices
        place = slots.index(n)
        assert slots.index(second) in starts[ends[place] : ends[place + 1]]
        checked += 1
    assert checked > 5


@pytest.mark.parametrize(
    ("size", "e_max", "number", "low", "high"),
    [
        (2, 0.9, 20_000, 4, 7),
        (2, 0.45, 20_000, 12, 22),
        (2, 0.225, 20_000, 48, 68),
        (4, 0.9, 5_000, 24, 37),
        (4, 0.9, 50_000, 39, 52),
    ],
)
def test_node_counts_are_the_known_ones(size, e_max, number, low, high):
    def last(seed):
        state = itm.init(jax.random.key(seed), 96, size)

        def body(state, stimulus):
            return itm.update(state, stimulus, rate=1e-4, e_max=e_max)[0], None

        points = jax.random.uniform(jax.random.key(100 + seed), (number, size), minval=-1.0, maxval=1.0)
        state, _ = jax.lax.scan(body, state, points)
        return jnp.sum(state.live), state.overflow

    counts, overflow = jax.jit(jax.vmap(last))(jnp.arange(6))
    print(f"{size}-D, e_max {e_max}, {number:,} stimuli: {np.mean(counts):.1f} nodes ({min(counts)}-{max(counts)})")
    assert not overflow.any()
    assert low <= np.mean(counts) <= high


def test_a_full_map_says_so():
    maps, _ = runner(4, 4)(jax.random.key(0), uniform(0, 500, 4), 1e-4, 0.9)
    assert int(maps.live[-1].sum()) == 4
    assert int(maps.overflow[-1]) > 10


def test_a_node_by_hand():
    """Nodes at 0 and 1 on the x-axis: (-1, 0) is beyond 0 and far, (0.5, 0) is between, (0.2, 0.1) is near."""
    start = itm.init(jax.random.key(0), 8, 2)
    start = start.replace(weights=start.weights.at[0].set(jnp.zeros(2)).at[1].set(jnp.array([1.0, 0.0])))
    step = functools.partial(itm.update, start, rate=0.5, e_max=0.3)
    state, info = step(jnp.array([-1.0, 0.0]))
    assert bool(info.created)
    assert int(info.node) == 2
    assert float(info.distance) == 1.0  # before the winner moved half-way
    np.testing.assert_allclose(state.weights[:3], [[-0.5, 0], [1, 0], [-1, 0]])
    assert np.argwhere(np.asarray(state.adjacency)).tolist() == [[0, 1], [0, 2], [1, 0], [2, 0]]
    for between in ([0.5, 0.0], [0.2, 0.1]):
        state, info = step(jnp.array(between))
        assert not bool(info.created)
        assert int(info.node) == int(info.nearest)


def test_line_20_removes_the_second_or_nothing():
    start = itm.init(jax.random.key(0), 8, 2)
    start = start.replace(
        weights=start.weights.at[:3].set(jnp.array([[0.0, 0.0], [0.1, 0.0], [1.0, 0.0]])),
        live=jnp.arange(8) < 3,
        adjacency=start.adjacency.at[1, 2].set(True).at[2, 1].set(True),
        degree=jnp.array([1, 2, 1, 0, 0, 0, 0, 0]),
    )
    state, info = itm.update(start, jnp.array([-0.01, 0.0]), rate=0.0, e_max=0.5)
    assert int(info.second) == 1
    assert np.asarray(state.live).tolist() == [True, False, True] + [False] * 5
    assert not np.asarray(state.adjacency).any()
    assert not np.asarray(state.degree).any()
    kept, _ = itm.update(start, jnp.array([-0.01, 0.0]), rate=0.0, e_max=0.5, spacing_removal="none")
    assert int(kept.live.sum()) == 3


def test_disabled_update_writes_nothing():
    start = itm.init(jax.random.key(0), 8, 2)
    for point in uniform(3, 20, 2) * 3:
        state, _ = itm.update(start, point, rate=0.5, e_max=0.3, enabled=False)
        jax.tree.map(np.testing.assert_array_equal, state, start)
