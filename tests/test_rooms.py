"""Walls in joint space: what they stop, that nothing gets through, and how far it is round them."""

import collections
import dataclasses

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax.envs import arms, oracle, reach, rooms, walls
from icac_jax.fields import ConfigError

FULL_TURN = {"joint_low": (-180.0, -180.0), "joint_high": (180.0, 180.0), "start_range": 0.0}
# Thin walls with corners, a gap, and one that ends at a joint's limit.
MAZE = ((20, -40, 40, 180), (-60, -70, 60, -50), (-90, -20, -70, 60), (-40, 50, -10, 70), (60, -180, 80, -90))


def planar(boxes=MAZE, **changes):
    return reach.task(arms.PLANAR2, **FULL_TURN | {"walls": np.array(boxes, float)} | changes)


def is_blocked(start, end, box=(40, -180, 60, 100)):
    boxes = walls.in_rad(box, 2)
    host = bool(walls.blocked(np.radians(start), np.radians(end), boxes))
    traced = jax.jit(walls.blocked)(*(jnp.asarray(part, jnp.float32) for part in (*np.radians([start, end]), boxes)))
    assert host == bool(traced)
    return host


def test_what_a_wall_stops():
    assert is_blocked((35, 0), (45, 0))
    assert is_blocked((35, 0), (40, 0))  # its face is a part of it
    assert is_blocked((35, 0), (65, 0))  # over it in one step
    assert is_blocked((36, 96), (44, 103))  # across a corner
    assert is_blocked((35, -180), (45, -180))  # along the joint's limit, where its end is
    assert is_blocked((50, 105), (55, 95))
    assert not is_blocked((36, 100), (42, 108))  # past the corner
    assert not is_blocked((35, 0), (39, 10))
    assert not is_blocked((39, 0), (39, 10))  # beside it
    assert not is_blocked((39, 0), (39, 0))
    assert is_blocked((50, 0), (50, 0))


@pytest.mark.parametrize("physics", ["kinematic", "servo"])
def test_no_move_goes_through_a_wall(physics):
    """Random moves, most of them at full speed: on no line between two steps lies a point of a box."""
    params, lanes, steps = planar(), 64, 300
    env = reach.make(arms.PLANAR2, physics)
    rng = np.random.default_rng(0)
    actions = np.repeat(rng.uniform(-2, 2, (steps // 10, lanes, 2)), 10, axis=0).clip(-1, 1).astype(np.float32)

    def walk(key, actions):
        def body(state, action):
            state, _ = env.step(state, action, params.traced())
            return state, (state.joints, state.velocity)

        start, _ = env.init(key, params.traced())
        return start.joints, *jax.lax.scan(body, start, actions)[1]

    start, joints, velocity = jax.jit(jax.vmap(walk, (0, 1)))(jax.random.split(jax.random.key(0), lanes), actions)
    path = np.concatenate([np.asarray(start)[:, None], joints], axis=1).astype(float)
    share = np.linspace(0, 1, 41)[:, None, None, None]
    lines = path[:, :-1] + share * np.diff(path, axis=1)
    boxes = walls.in_rad(params.walls, 2)
    for low, high in boxes:
        assert not np.any(np.all((lines > low + 1e-5) & (lines < high - 1e-5), axis=-1))
    stood = np.all(np.diff(path, axis=1) == 0, axis=-1)
    assert 0.05 < stood.mean() < 0.8  # walls were run into, and left again
    at_limit = np.any(np.abs(path[:, 1:]) > np.radians(179.99), axis=-1)
    assert np.all(np.asarray(velocity)[stood & ~at_limit] == 0)
    assert np.ptp(path, axis=(0, 1)).min() > np.radians(250)  # and the arms got about


def test_gymnasium_has_the_same_walls():
    params = planar()
    env = reach.make(arms.PLANAR2, "kinematic")
    step = jax.jit(env.step)
    state, _ = env.init(jax.random.key(0), params.traced())
    world = gymnasium.make(
        "icac_jax.envs.gymnasium:icac_jax/Planar2Reach-v0", physics="kinematic", **FULL_TURN, walls=params.walls
    )
    world.reset(options={"joints": np.zeros(2), "goal": np.asarray(state.goal, float)})
    rng, stood = np.random.default_rng(1), 0
    for _ in range(200):
        action = rng.uniform(-2, 2, 2).clip(-1, 1)
        before = state.joints
        state, seen = step(state, jnp.asarray(action, jnp.float32), params.traced())
        stood += bool(jnp.all(state.joints == before))
        np.testing.assert_allclose(world.step(action)[0], seen.observation, atol=1e-4)
    assert stood > 5
    with pytest.raises(ConfigError, match="joints: must be outside the walls"):
        world.reset(options={"joints": np.radians([30.0, 0.0])})


def test_without_walls_they_are_not_in_the_program():
    plain = reach.default_params(arms.PLANAR2).traced()
    assert (plain.walls, plain.goal_joints) == (None, None)
    assert planar().traced().walls.shape == (20,)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"walls": (1.0, 2.0, 3.0)}, "walls: must be boxes of 4 numbers each, .* got 3 numbers"),
        ({"walls": (40.0, 0.0, 30.0, 10.0)}, "walls: the lowest angles of box 0 must be less .* 40 and 30 for joint 0"),
        ({"walls": (-10.0, -10.0, 10.0, 10.0)}, "walls: must leave out where episodes start"),
        ({"walls": (40.0, 0.0, 50.0, 10.0), "start_range": 0.5}, "walls: must leave out where episodes start"),
        ({"goal_joints": (1.0,)}, "goal_joints: must be 2 numbers for planar2, got 1"),
        ({"goal_joints": (1.0, 190.0)}, "goal_joints: must be within the joint limits, -180 to 180, got 190"),
    ],
)
def test_what_is_no_wall(changes, words):
    with pytest.raises(ConfigError, match=words):
        reach.task(arms.PLANAR2, **FULL_TURN | changes)


def by_hand(boxes, pitch=10):
    """Steps on a coarse grid by plain search, lines looked at point by point."""
    side = range(-180, 181, pitch)
    boxes = np.array(boxes, float).reshape(-1, 2, 2)

    def free(one, other):
        points = (np.array(one) + np.linspace(0, 1, 21)[:, None] * (np.array(other) - one))[:, None]
        return not np.any(np.all((points >= boxes[:, 0]) & (points <= boxes[:, 1]), axis=-1))

    found, queue = {(0, 0): 0}, collections.deque([(0, 0)])
    while queue:
        place = queue.popleft()
        for across in (-pitch, 0, pitch):
            for up in (-pitch, 0, pitch):
                there = (place[0] + across, place[1] + up)
                if there not in found and there[0] in side and there[1] in side and free(place, there):
                    found[there] = found[place] + 1
                    queue.append(there)
    return found


def test_the_search_against_plain_search_on_a_grid():
    space = oracle.space(arms.PLANAR2, planar())
    known = by_hand(MAZE)
    found = rooms.ways(space, per_step=1)
    places = map(tuple, np.degrees(found.joints).round().astype(int).tolist())
    assert dict(zip(places, found.steps.tolist(), strict=True)) == known
    finer = by_place(rooms.ways(space))
    assert all(finer[float(a), float(b)] <= steps for (a, b), steps in known.items())


def by_place(ways):
    return dict(zip(map(tuple, np.degrees(ways.joints).round(3).tolist()), ways.steps.tolist(), strict=True))


def test_a_finer_grid_saves_a_step_at_most():
    half = {"joint_low": (-90.0, -90.0), "joint_high": (90.0, 90.0)}
    space = oracle.space(arms.PLANAR2, planar(((20, -40, 40, 90), (-60, -70, 60, -50), (-75, -20, -35, 60)), **half))
    usual, finer = by_place(rooms.ways(space)), by_place(rooms.ways(space, per_step=9))
    saved = np.array([steps - finer[place] for place, steps in usual.items() if place in finer])
    assert len(saved) > 200
    assert set(saved) <= {0, 1}


def test_a_door_by_hand():
    """Up to the door, 10 steps, through it, 3.5, and down to (100, 10), 9: the tip is there where (110, -10) has it."""
    params = planar((45, -180, 80, 100), goal_radius=0.02)
    goal = oracle.tips(arms.PLANAR2, np.radians([[110.0, -10.0]]))
    assert oracle.distances(arms.PLANAR2, params, goal)[0] in (22, 23)
    start = np.zeros((1, 2))
    assert oracle.steps(arms.PLANAR2, params, start, goal)[0] == oracle.distances(arms.PLANAR2, params, goal)[0]
    assert oracle.steps(arms.PLANAR2, params.replace(walls=()), start, goal)[0] == 10
    shut = params.replace(walls=(45.0, -180.0, 80.0, 180.0))
    assert np.isinf(oracle.distances(arms.PLANAR2, shut, goal)[0])
    assert oracle.steps(arms.PLANAR2, shut, start, goal)[0] == 36  # the whole range


@pytest.mark.parametrize(("arm", "pairs", "most", "mean"), [("planar2", 300, 1, 0.1), ("nico4", 60, 2, 0.6)])
def test_where_no_wall_is_in_the_way_it_is_the_oracle_without(arm, pairs, most, mean):
    """A wall in a corner of the range, where no goal is near."""
    arm = arms.get(arm)
    low, high = np.array(arm.joint_low), np.array(arm.joint_high)
    box = (*low[:2], *low[2:], *(low + 1)[:2], *high[2:])
    params = reach.task(arm, start_range=0.0, reset_range=0.6, walls=box)
    start, goal = oracle.pairs(arm, params, pairs)
    more = oracle.steps(arm, params, start, goal) - oracle.steps(arm, params.replace(walls=()), start, goal)
    assert more.min() >= (0 if arm.name == "planar2" else -1)
    assert more.max() <= most
    assert more.mean() <= mean


def test_what_can_be_reached():
    shut = planar((45, -180, 80, 180))
    cells = oracle.reachable(arms.PLANAR2, shut, 36)
    assert cells.shape == (36, 36)
    assert cells[:22].all()  # the cell from 40 to 50 degrees holds the face
    assert not cells[23:].any()
    around = oracle.reachable(arms.PLANAR2, planar((45, -180, 80, 100)), 36)
    assert around[:22].all()
    assert around[26:].all()
    assert not around[23:26, :27].any()
    four = oracle.reachable(
        arms.NICO4, reach.task(arms.NICO4, start_range=0.0, walls=(50, -180, -140, -100, 60, 179, 75, 100)), 9
    )
    assert four.shape == (9,) * 4
    assert four[:6].all()
    assert not four[7:].any()
    assert oracle.reachable(arms.PLANAR2, planar(()), 8).all()


def test_an_arm_of_another_name_is_searched_too():
    other = dataclasses.replace(arms.PLANAR2, name="any")
    params, goal = planar((45, -180, 80, 100)), oracle.tips(arms.PLANAR2, np.radians([[120.0, 0.0]]))
    assert oracle.distances(other, params, goal)[0] == oracle.distances(arms.PLANAR2, params, goal)[0]
