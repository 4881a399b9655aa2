"""The arms: geometry, MJX against C MuJoCo, servo tracking, limits, the reaching task."""

import dataclasses
import functools
import operator

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from icac_jax.envs import arms, reach
from icac_jax.envs.model import load_model
from icac_jax.envs.physics import PHYSICS, SUB_STEPS
from icac_jax.fields import ConfigError
from icac_jax.rollout import broadcast
from tests.reference.physics import CArm
from tests.worlds import line

ARMS = list(arms.ARMS.values())
by_name = {"argvalues": ARMS, "ids": [arm.name for arm in ARMS]}


BATCH = 200  # one width for all tests, so that each arm's physics compiles once


@functools.cache
def batched(arm, physics):
    """The environment's two functions over BATCH lanes, params shared."""
    env = reach.make(arm, physics)
    return jax.jit(jax.vmap(env.init, (0, None))), jax.jit(jax.vmap(env.step, (0, 0, None)))


def states(arm, params, physics="servo", seed=3):
    everywhere = params.replace(reset_range=1.0)
    return batched(arm, physics)[0](jax.random.split(jax.random.key(seed), BATCH), everywhere.traced())


def tiled(array):
    return jnp.tile(jnp.asarray(array, jnp.float32), (BATCH, 1))


@pytest.mark.parametrize("arm", **by_name)
def test_model_has_what_the_task_needs(arm):
    model = load_model(arm)
    assert model.nu == model.nq == arm.joints
    assert [model.actuator(i).trnid[0] for i in range(model.nu)] == list(range(arm.joints))
    np.testing.assert_allclose(np.degrees(model.jnt_range.T), [arm.joint_low, arm.joint_high])
    np.testing.assert_allclose(model.site("goal").size[0], arm.goal_radius, atol=1e-4)
    assert model.ncam >= 1
    assert model.nlight >= 1


def test_planar2_forward_kinematics_by_hand():
    c = CArm(arms.PLANAR2, 1)
    np.testing.assert_allclose(c.tip([0, 0]), [2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(c.tip([np.pi / 2, np.pi / 2]), [-1, 1, 0], atol=1e-12)


def test_nico4_geometry():
    """Zero pose, reach and segment lengths of the published kinematic description."""
    c = CArm(arms.NICO4, 1)
    np.testing.assert_allclose(c.tip(np.zeros(4)), [0.05028, -0.16038, 0.46371], atol=1e-5)
    body_pos = c.model.body_pos
    lengths = [*np.linalg.norm(body_pos[2:], axis=1), np.linalg.norm(c.model.site("tip").pos)]
    np.testing.assert_allclose(lengths, [0.0488, 0.0809, 0.1764, 0.1265], atol=1e-4)
    np.testing.assert_allclose(sum(lengths[2:]), 0.3028, atol=1e-4)
    assert arms.NICO4.goal_radius == pytest.approx(0.0379, abs=1e-4)
    rng = np.random.default_rng(0)
    tips = np.array([c.tip(rng.uniform(c.low, c.high)) for _ in range(20000)])
    axis = body_pos[1]
    reach_from = np.linalg.norm(tips - axis, axis=1)
    assert reach_from.max() == pytest.approx(0.4166, abs=4e-3)
    assert reach_from.min() == pytest.approx(0.113, abs=1e-2)
    mass = c.model.body_mass[1:]
    np.testing.assert_allclose(mass, [0.084038, 0.024811, 0.189729, 0.110522])


@pytest.mark.parametrize("arm", **by_name)
def test_goal_box_holds_every_tip(arm):
    c, rng = CArm(arm, 1), np.random.default_rng(1)
    tips = np.array([c.tip(rng.uniform(c.low, c.high)) for _ in range(20000)])[:, list(arm.goal_axes)]
    assert np.all(tips >= np.array(arm.goal_low) - 1e-9)
    assert np.all(tips <= np.array(arm.goal_high) + 1e-9)


@pytest.mark.parametrize("arm", **by_name)
def test_servo_matches_c_mujoco(arm):
    """1,000 random states, one control step each from the same state: joints to 1e-5 rad, tip to 1e-5 m."""
    params, rng = reach.default_params(arm), np.random.default_rng(2)
    c = CArm(arm, SUB_STEPS)
    for seed in range(1000 // BATCH):
        state, _ = states(arm, params, seed=seed)
        velocity = (0.3 * rng.normal(size=state.velocity.shape)).astype(np.float32)
        actions = rng.uniform(-1, 1, (BATCH, arm.joints)).astype(np.float32)
        joints = np.asarray(state.joints, float)
        wanted = [c.move(*each) for each in zip(joints, velocity, actions, strict=True)]
        joints, speeds, tips = map(np.array, zip(*wanted, strict=True))
        # The tip shows in whether a goal is reached: one put 1e-5 m within the radius is, one 1e-5 m beyond is not.
        step = batched(arm, "servo")[1]
        for slack in (1e-5, -1e-5):
            off = np.array([0, 0, params.goal_radius - slack])
            there = state.replace(velocity=jnp.asarray(velocity), goal=jnp.asarray(tips + off, jnp.float32))
            after, seen = jax.device_get(step(there, actions, params.traced()))
            assert np.all(seen.terminated == (slack > 0))
        np.testing.assert_allclose(after.joints, joints, rtol=0, atol=1e-5)
        np.testing.assert_allclose(after.velocity, speeds, rtol=0, atol=1e-3)


@pytest.mark.parametrize("arm", **by_name)
def test_servo_tracks_random_targets_within_half_a_degree(arm):
    params = reach.default_params(arm)
    state, _ = states(arm, params)
    low, high = np.radians(params.joint_low), np.radians(params.joint_high)
    rng, errors, beyond = np.random.default_rng(0), [], []
    for _ in range(50):
        action = rng.uniform(-1, 1, (BATCH, arm.joints)).astype(np.float32)
        target = np.clip(np.asarray(state.joints) + np.radians(10.0) * action, low, high)
        state, _ = batched(arm, "servo")[1](state, action, params.traced())
        errors.append(np.degrees(state.joints - target))
        beyond.append(np.degrees(np.maximum(state.joints - high, low - state.joints)).max())
    rms = float(np.sqrt(np.mean(np.square(errors))))
    print(f"{arm.name}: servo tracking error {rms:.3f} deg RMS, {np.abs(errors).max():.3f} deg at most")
    assert rms < 0.5
    assert max(beyond) < 1e-4  # limits are kept, up to float32


@pytest.mark.parametrize("arm", **by_name)
@pytest.mark.parametrize("physics", ["servo", "kinematic"])
def test_task(arm, physics):
    params = reach.default_params(arm)
    traced = params.replace(horizon=3).traced()
    state, observation = states(arm, params, physics)
    step = batched(arm, physics)[1]
    assert observation.shape == (BATCH, arm.observation_size)
    assert np.all(np.abs(observation) <= 1)
    zero = jnp.zeros((BATCH, arm.joints))
    far = state.replace(goal=state.goal + 10.0)
    for number in (1, 2, 3):
        far, seen = step(far, zero, traced)
        assert not np.any(seen.reward)
        assert not np.any(seen.terminated)
        assert np.all(seen.truncated == (number == 3))
    # A servo's sag under gravity is far below a twentieth of the radius.
    c = CArm(arm, SUB_STEPS)
    tips = np.array([c.tip(joints) for joints in np.asarray(state.joints, float)])
    for share, reached in ((0.9, True), (1.1, False)):
        near = state.replace(goal=jnp.asarray(tips + np.array([0, 0, share * params.goal_radius]), jnp.float32))
        _, seen = step(near, zero, traced)
        assert np.all(seen.terminated == reached)
        assert np.all(seen.reward == reached * params.goal_reward)
        assert not np.any(seen.truncated)


@pytest.mark.parametrize("physics", ["servo", "kinematic"])
def test_action_is_ten_degrees(physics):
    arm, params = arms.PLANAR2, reach.default_params(arms.PLANAR2)
    state, _ = states(arm, params, physics)
    state = state.replace(joints=tiled(np.radians([90.0, 45.0])))
    after, seen = batched(arm, physics)[1](state, tiled([1.0, -0.5]), params.traced())
    np.testing.assert_allclose(np.degrees(after.joints[0]), [100.0, 40.0], atol=0.5)
    np.testing.assert_allclose(seen.observation[0, :2], [100 / 90 - 1, 40 / 90 - 1], atol=0.01)
    after, _ = batched(arm, physics)[1](state, tiled([3.0, 0.0]), params.replace(action_bound=5.0).traced())
    np.testing.assert_allclose(np.degrees(after.joints[0]), [105.0, 45.0], atol=1.0)


def test_reset_range_and_joint_limits_are_traced():
    arm = arms.PLANAR2
    env = reach.make(arm, "kinematic")
    base = reach.default_params(arm)
    many = [base.replace(reset_range=0.25), base.replace(joint_low=(-90.0, 0.0), joint_high=(0.0, 20.0))]
    init = jax.jit(jax.vmap(env.init, (0, None)))
    keys = jax.random.split(jax.random.key(0), 4000)
    first, second = (np.degrees(init(keys, params.traced())[0].joints) for params in many)
    assert init._cache_size() == 1
    assert first.min() == pytest.approx(67.5, abs=0.1)
    assert first.max() == pytest.approx(112.5, abs=0.1)
    np.testing.assert_allclose(second.min(0), [-90, 0], atol=0.1)
    np.testing.assert_allclose(second.max(0), [0, 20], atol=0.1)


def test_same_arguments_give_the_same_environment():
    one = reach.make(arms.PLANAR2, "servo", 3)
    assert reach.make(arms.PLANAR2) is reach.make(arms.PLANAR2, physics="servo", sub_steps=3, cache=Traced()) is one
    assert reach.make(arms.PLANAR2, "kinematic") is not one


class Traced:
    """A cache that keeps nothing, and counts."""

    def __init__(self):
        self.facts = []

    def arithmetic(self, facts, trace):
        self.facts.append(facts)
        return trace()


def test_the_cache_is_asked_once_for_each_part_of_an_arm():
    arm, cache = dataclasses.replace(arms.PLANAR2, name="mine"), Traced()
    for physics in ("servo", "kinematic", "servo"):
        reach.make(arm, physics, cache=cache)
    assert [facts.partition(b"\n")[0] for facts in cache.facts] == [b"step", b"tip"]


def test_a_kind_of_physics_is_a_line(monkeypatch):
    """Springs that go half of the way."""
    monkeypatch.setitem(PHYSICS, "half", lambda arm, sub_steps, cache: lambda q, v, target: ((q + target) / 2, v))
    arm, params = arms.PLANAR2, reach.default_params(arms.PLANAR2).traced()
    state, _ = states(arm, reach.default_params(arm), "kinematic")
    state = state.replace(joints=tiled(np.radians([90.0, 45.0])))
    after, _ = jax.vmap(reach.make(arm, "half").step, (0, 0, None))(state, tiled([1.0, -0.5]), params)
    np.testing.assert_allclose(np.degrees(after.joints[0]), [95.0, 42.5], atol=1e-4)
    assert reach.make(arm, "half") is reach.make(arm, "half") is not reach.make(arm, "kinematic")
    with pytest.raises(ConfigError, match=r"^physics: must be one of servo, kinematic, half, got 'warp'"):
        reach.make(arm, "warp")


@pytest.mark.parametrize("arm", **by_name)
def test_goals_can_be_replaced(arm):
    """What hindsight does: the observation with the achieved as the goal is that of the state with that goal."""
    env, params = reach.make(arm, "kinematic"), reach.default_params(arm).traced()
    assert (env.observation_size, env.action_size, env.state_size) == (arm.observation_size, arm.joints, arm.joints)
    assert env.params == reach.default_params(arm)
    state, _ = states(arm, reach.default_params(arm), "kinematic")
    actions = jax.random.uniform(jax.random.key(0), (BATCH, arm.joints), minval=-1.0)
    before, (state, seen) = state, batched(arm, "kinematic")[1](state, actions, params)
    tip = jax.vmap(env.goal.achieved)(state)
    np.testing.assert_array_equal(jax.vmap(env.goal.desired)(state), before.goal)
    ended = jax.vmap(env.goal.reached, (0, 0, None))(tip, state.goal, params)
    np.testing.assert_array_equal(ended, seen.terminated)
    assert np.all(jax.vmap(env.goal.reached, (0, 0, None))(tip, tip, params))
    relabelled = jax.vmap(env.goal.relabel)(seen.observation, tip)
    wanted = jax.vmap(lambda s: reach.observe(arm, s, params))(state.replace(goal=tip))
    np.testing.assert_allclose(relabelled, wanted, atol=1e-6)
    np.testing.assert_allclose(jax.vmap(env.goal.relabel)(relabelled, state.goal), seen.observation, atol=1e-6)


def test_an_environment_is_its_functions():
    """Params that have no hash do no harm; another pair of functions is another environment."""
    one = line()
    same, other = one._replace(params=np.ones(3), goal=None), line()
    assert one == same
    assert not operator.ne(one, same)
    assert hash(one) == hash(same)
    assert one != other
    assert not operator.eq(one, other)
    assert one != (one.init, one.step)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"joint_low": (0.0,)}, "joint_low"),
        ({"joint_low": (10.0, 200.0)}, "joint_low"),
        ({"horizon": 0}, "horizon"),
        ({"goal_radius": 0.0}, "goal_radius"),
        ({"reset_range": 1.5}, "reset_range"),
        ({"action_bound": float("nan")}, "action_bound"),
    ],
)
def test_wrong_task_numbers_are_named(change, named):
    with pytest.raises(ConfigError, match=f"^{named}: must be"):
        reach.validate(arms.PLANAR2, reach.default_params(arms.PLANAR2).replace(**change))


def test_params_broadcast_over_lanes():
    lanes = broadcast(reach.default_params(arms.NICO4).traced(), 3)
    assert lanes.joint_low.shape == (3, 4)
    assert lanes.horizon.dtype == jnp.int32


def test_models_render_an_arm_and_a_goal():
    """Every model loads in C MuJoCo's own viewer structures: geoms with size, a goal that can be moved."""
    for arm in ARMS:
        model = load_model(arm)
        data = mujoco.MjData(model)
        model.site_pos[model.site("goal").id] = [0.1, 0.2, 0.3]
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.site("goal").xpos, [0.1, 0.2, 0.3])
        assert model.ngeom >= 5
