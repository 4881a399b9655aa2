"""The Gymnasium environments: what Gymnasium asks for, the same transitions as on MJX, goals, pictures, errors."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

import icac_jax.envs.gymnasium as ours
from icac_jax.envs import arms, pictures, reach
from icac_jax.envs.model import no_opengl
from icac_jax.envs.physics import tip_function
from icac_jax.fields import ConfigError
from icac_jax.settings import presets
from icac_jax.settings.options import resolve
from tests.test_reach import BATCH, batched

FLAT = ["icac_jax/Planar2Reach-v0", "icac_jax/Nico4Reach-v0"]
GOAL = ["icac_jax/Planar2ReachGoal-v0", "icac_jax/Nico4ReachGoal-v0"]
EPISODES = 20
WIDE = {"planar2": 0.3, "nico4": 0.18}  # goal radius, so that random actions reach some goals


@pytest.mark.parametrize("name", FLAT + GOAL)
def test_check_env(name):
    """Warnings are errors here. Without pictures: they need OpenGL, and a window."""
    check_env(gymnasium.make(name).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("arm", arms.ARMS)
def test_the_task_is_that_of_preset_paper(arm):
    world = gymnasium.make(f"icac_jax/{arm.capitalize()}Reach-v0").unwrapped
    settings = resolve(arm=arm, preset="paper")
    assert world.params == settings.params
    assert (world.physics, world.sub_steps) == (settings.run.physics, settings.run.sub_steps)
    assert "reset_range" not in presets.of_arm(arm)["paper"]  # one place for it, the arm


@pytest.mark.parametrize("physics", ["servo", "kinematic"])
@pytest.mark.parametrize("arm", arms.ARMS)
def test_transitions_are_those_of_mjx(arm, physics):
    """Whole episodes from the same starts and goals with the same actions, beyond the bound too: all of it to 1e-4."""
    task = {"reset_range": 0.9, "goal_radius": WIDE[arm]}
    params = reach.task(arms.get(arm), **task).traced()
    init, step = batched(arms.get(arm), physics)  # as wide as in the tests of the arms, so that it compiles once
    state, first = init(jax.random.split(jax.random.key(5), BATCH), params)
    actions = np.random.default_rng(0).uniform(-1, 1, (50, BATCH, arms.get(arm).joints)).astype(np.float32)
    actions[5:, ::2] = np.sign(actions[5:6, ::2])  # half of the episodes run into the limits
    worlds = [gymnasium.make(ours_name(arm), physics=physics, **task) for _ in range(EPISODES)]
    for lane, world in enumerate(worlds):
        given = {"joints": np.asarray(state.joints[lane], float), "goal": np.asarray(state.goal[lane], float)}
        seen, _ = world.reset(options=given)
        np.testing.assert_allclose(seen, first[lane], rtol=0, atol=1e-4)
    over, ends = np.zeros(EPISODES, bool), {"terminated": 0, "truncated": 0, "at a limit": 0}
    for action in actions:
        state, wanted = jax.device_get(step(state, jnp.asarray(action), params))
        for lane in np.flatnonzero(~over):
            seen, reward, terminated, truncated, info = worlds[lane].step(action[lane])
            np.testing.assert_allclose(seen, wanted.observation[lane], rtol=0, atol=1e-4)
            np.testing.assert_allclose(worlds[lane].unwrapped._velocity, state.velocity[lane], rtol=0, atol=2e-3)
            assert (reward, terminated, truncated) == (
                wanted.reward[lane],
                wanted.terminated[lane],
                wanted.truncated[lane],
            )
            assert info["is_success"] == terminated
            over[lane] = terminated or truncated
            ends["terminated"] += terminated
            ends["truncated"] += truncated
            ends["at a limit"] += np.any(np.abs(seen[: arms.get(arm).joints]) == 1.0)
    assert over.all()
    assert min(ends.values()) >= 3, ends


def ours_name(arm, variant="Reach"):
    return f"icac_jax/{arm.capitalize()}{variant}-v0"


def test_actions_beyond_the_bound_move_as_far_as_the_bound():
    world = gymnasium.make(FLAT[0], physics="kinematic").unwrapped
    start = {"joints": np.radians([90.0, 90.0]), "goal": [2.0, 0.0, 0.0]}
    world.reset(options=start)
    seen = world.step(np.array([7.0, -7.0]))[0]
    np.testing.assert_allclose(seen[:2], [100 / 90 - 1, 80 / 90 - 1], atol=1e-6)
    for wrong in (np.array([np.nan, 0.0]), np.zeros(3)):
        with pytest.raises(ValueError, match="action: must be 2 finite numbers"):
            world.step(wrong)


def test_seeds_give_starts_and_goals():
    first, again, other = (gymnasium.make(FLAT[1]).reset(seed=seed)[0] for seed in (4, 4, 5))
    np.testing.assert_array_equal(first, again)
    assert np.all(first != other)
    world = gymnasium.make(FLAT[0], reset_range=0.25)
    joints = np.array([world.reset(seed=seed)[0][:2] for seed in range(200)])
    assert 0.22 < np.abs(joints).max() <= 0.25
    goals = np.array([world.reset()[0][2:] for _ in range(200)])
    tips = 2 * np.array([ours_tip(world, angles) for angles in np.radians([[67.5, 67.5], [90, 90], [112.5, 112.5]])])
    assert np.all(goals.min(0) < tips.mean(0)[:2] / 4)
    assert len(np.unique(goals, axis=0)) == 200


def ours_tip(world, joints):
    return world.unwrapped._tip_at(joints)


@pytest.mark.parametrize("name", GOAL)
def test_goal_conditioned_rewards_can_be_computed_again(name):
    world = gymnasium.make(name, goal_radius=WIDE["nico4" if "Nico" in name else "planar2"])
    world.action_space.seed(0)
    achieved, desired, rewards, ends = [], [], [], []
    for seed in range(30):
        seen, _ = world.reset(seed=seed)
        over = False
        while not over:
            seen, reward, terminated, truncated, info = world.step(world.action_space.sample())
            achieved.append(seen["achieved_goal"])
            desired.append(seen["desired_goal"])
            rewards.append(reward)
            ends.append(terminated)
            assert reward == world.unwrapped.compute_reward(achieved[-1], desired[-1], info)
            assert terminated is world.unwrapped.compute_terminated(achieved[-1], desired[-1], info)
            over = terminated or truncated
    again = world.unwrapped.compute_reward(np.array(achieved), np.array(desired), [{}] * len(rewards))
    np.testing.assert_array_equal(again, rewards)
    np.testing.assert_array_equal(world.unwrapped.compute_terminated(np.array(achieved), np.array(desired)), ends)
    assert set(rewards) == {0.0, -1.0}
    np.testing.assert_array_equal(np.array(rewards) == 0.0, ends)


def test_both_variants_are_one_task():
    flat, goal = gymnasium.make(FLAT[0]), gymnasium.make(GOAL[0])
    plain, seen = flat.reset(seed=1)[0], goal.reset(seed=1)[0]
    for action in np.random.default_rng(0).uniform(-1, 1, (5, 2)):
        np.testing.assert_allclose(plain, [*seen["observation"], *(seen["desired_goal"][:2] / 2)], atol=1e-6)
        tip = ours_tip(flat, flat.unwrapped._joints)
        np.testing.assert_allclose(seen["achieved_goal"], tip, atol=1e-6)
        plain, seen = flat.step(action)[0], goal.step(action)[0]


def test_observations_are_in_their_space_at_the_ends_of_joints_and_goals():
    """With wider limits than the arm's own some goals are outside of its goal box, and so of [-1, 1]."""
    furthest = 0.0
    wide = {"joint_low": [-180.0] * 4, "joint_high": [180.0] * 4}
    for name, task in ((FLAT[1], {}), (GOAL[1], {}), (FLAT[1], wide), (GOAL[1], wide)):
        world = gymnasium.make(name, **task).unwrapped
        rng = np.random.default_rng(0)
        tips = np.array([ours_tip(world, joints) for joints in rng.uniform(world._low, world._high, (10_000, 4))])
        for goal in tips[np.concatenate([tips.argmin(0), tips.argmax(0)])]:
            ends = np.where(rng.random(4) < 0.5, world._low, world._high)
            seen, _ = world.reset(options={"joints": ends, "goal": goal})
            assert seen in world.observation_space
            furthest = max(furthest, np.abs(seen).max() if name == FLAT[1] else 0.0)
    assert furthest > 1.01


def test_vectorised():
    worlds = gymnasium.make_vec(FLAT[0], num_envs=3, horizon=4)
    seen, _ = worlds.reset(seed=0)
    assert seen.shape == (3, 4)
    for _ in range(4):
        _, _, _, truncated, info = worlds.step(worlds.action_space.sample())
    assert truncated.any()
    assert info["steps"].shape == (3,)
    worlds.close()


OWN_ARM = Path(__file__).resolve().parents[1] / "examples" / "own_arm"


@pytest.mark.parametrize("given", [str(OWN_ARM / "arm.toml"), OWN_ARM, OWN_ARM / "arm7.xml"])
def test_an_arm_of_ones_own(given):
    """By path, as on the command line: its tip, its defaults, and the transitions of MJX."""
    world = gymnasium.make(FLAT[0], arm=given, physics="kinematic").unwrapped
    assert (world.arm.tip, world.arm.joints) == ("fingertip", 7)
    assert world.params.horizon == (50 if str(given).endswith("xml") else 40)
    check_env(gymnasium.make(GOAL[0], arm=given).unwrapped, skip_render_check=True)
    start = np.radians(np.add(world.params.joint_low, world.params.joint_high)) / 2
    seen, _ = world.reset(options={"joints": start, "goal": [0.3, 0.0, 0.6]})
    np.testing.assert_allclose(seen[:7], 0.0, atol=1e-6)
    np.testing.assert_allclose(world._position(), tip_function(world.arm)(jnp.asarray(start, jnp.float32)), atol=1e-6)
    vector = gymnasium.make_vec(FLAT[0], num_envs=2, arm=str(given))
    assert vector.reset(seed=0)[0].shape == (2, 10)
    vector.close()


def test_an_arm_of_ones_own_that_is_wrong(tmp_path):
    with pytest.raises(ConfigError, match=r"^arm: cannot read .*none.toml"):
        ours.ReachEnv(arm=str(tmp_path / "none.toml"))
    with pytest.raises(ConfigError, match=r"^arm: cannot read .*none.xml"):
        ours.ReachEnv(arm=tmp_path / "none.xml")
    with pytest.raises(ConfigError, match=r"^arm: the folder .* must hold one .toml"):
        ours.ReachEnv(arm=tmp_path)
    with pytest.raises(ConfigError, match=r"^arm: must be one of planar2, nico4 or the path"):
        ours.ReachEnv(arm=7)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_autoreset(mode):
    """Gymnasium's vector environments around ours, in each of their ways to begin the next episode."""
    worlds = SyncVectorEnv([lambda: ours.ReachEnv(horizon=2, goal_radius=1e-6)] * 2, autoreset_mode=mode)
    worlds.reset(seed=0)
    action = np.zeros((2, 2), np.float32)
    worlds.step(action)
    _, _, _, truncated, info = worlds.step(action)
    assert truncated.all()
    if mode == AutoresetMode.SAME_STEP:
        assert info["final_obs"][0].shape == (4,)
        assert (info["final_info"]["steps"] == 2).all()
        assert (info["steps"] == 0).all()
    elif mode == AutoresetMode.NEXT_STEP:
        assert (worlds.step(action)[4]["steps"] == 0).all()
    else:
        seen, info = worlds.reset(options={"reset_mask": truncated})
        assert (info["steps"] == 0).all()
        assert seen.shape == (2, 4)
    worlds.close()


def test_in_processes():
    """As Stable-Baselines3's SubprocVecEnv: each world in a process of its own, with the transitions of one here."""
    here = SyncVectorEnv([lambda: ours.ReachEnv(physics="kinematic")] * 2)
    there = AsyncVectorEnv([lambda: ours.ReachEnv(physics="kinematic")] * 2, context="spawn")
    np.testing.assert_array_equal(here.reset(seed=5)[0], there.reset(seed=5)[0])
    for action in np.random.default_rng(0).uniform(-1, 1, (3, 2, 2)).astype(np.float32):
        for one, other in zip(here.step(action)[:4], there.step(action)[:4], strict=True):
            np.testing.assert_array_equal(one, other)
    there.close()
    here.close()


def test_by_module_without_an_import():
    code = f"import gymnasium; print(gymnasium.make('icac_jax.envs.gymnasium:{FLAT[0]}').unwrapped.arm.name)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("planar2\n", "")


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        (FLAT[0], {"goal_radius": -1.0}, "goal_radius: must be"),
        (FLAT[0], {"goal_radios": 0.1}, "goal_radios: no such number of the task; there are joint_low"),
        (FLAT[0], {"horizon": 2.5}, "horizon: must be a whole number"),
        (FLAT[1], {"joint_low": [0.0, 1.0]}, "joint_low: must be 4 numbers"),
        (FLAT[1], {"joint_low": "1234"}, "joint_low: must be a list of numbers"),
        (FLAT[0], {"physics": "warp"}, "physics: must be one of servo, kinematic"),
        (FLAT[0], {"sub_steps": 0}, "sub_steps: must be a whole number at least 1"),
        (FLAT[0], {"arm": "puma"}, "arm: must be one of planar2, nico4"),
        (GOAL[0], {"goal_reward": 1.0}, "goal_reward: not used here"),
    ],
)
def test_wrong_options_are_named(name, options, message):
    with pytest.raises(ConfigError, match=f"^{message}"):
        gymnasium.make(name, **options)


def test_wrong_options_of_a_reset_are_named():
    world = gymnasium.make(FLAT[0]).unwrapped
    for options, message in (
        ({"joint": [0.0, 0.0]}, "joint: no such option of reset; there are joints, goal"),
        ({"joints": [0.0]}, "joints: must be 2 finite numbers"),
        ({"joints": "ab"}, "joints: must be 2 finite numbers"),
        ({"goal": [0.0, np.inf, 0.0]}, "goal: must be 3 finite numbers"),
        ({"joints": [-0.1, 0.0]}, "joints: must be within the joint limits"),
        ({"joints": [[0.0, 0.0]]}, "joints: must be 2 finite numbers in the options of reset"),
        ({"goal": [9, 9, 9]}, r"goal: must be within the arm's reach, .* in the options of reset, got \[9, 9, 9\]"),
        ({"goal": [0.0, 2.1, 0.0]}, "goal: must be within the arm's reach"),
        ({"goal": 1.0}, "goal: must be 3 finite numbers in the options of reset"),
        ({"goal": [0.0, np.nan, 0.0]}, "goal: must be 3 finite numbers"),
        ({1: 2}, "1: no such option of reset"),
        ([1.0, 2.0], "options: must be a dict with some of joints, goal"),
        ("goal", "options: must be a dict"),
    ):
        before = world.reset(seed=3)[0]
        with pytest.raises(ConfigError, match=f"^{message}") as caught:
            world.reset(options=options)
        assert "\n" not in str(caught.value)
        np.testing.assert_array_equal(world._observation(), before)  # nothing has happened
    with pytest.raises(ConfigError, match=r"^render_mode: must be one of"):
        ours.ReachEnv(render_mode="ansi")


def in_a_process(code, **environment):
    """Runs code with OpenGL chosen by the environment, which MuJoCo reads when it is imported."""
    kept = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")}
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", f"import gymnasium, icac_jax.envs.gymnasium\n{code}"],
        capture_output=True,
        text=True,
        check=False,
        env=kept | environment,
    )


def test_check_env_with_pictures_made_as_stable_baselines_makes_them():
    """`make_vec_env` asks for rgb_array in the constructor, without a display; the checker renders in both modes."""
    code = f"""
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.vector import SyncVectorEnv
from icac_jax.envs.gymnasium import ReachEnv
worlds = SyncVectorEnv([lambda: gymnasium.make({FLAT[0]!r}, render_mode="rgb_array")] * 2)
worlds.reset(seed=0)
worlds.step(worlds.action_space.sample())
try:
    assert [picture.shape for picture in worlds.render()] == [(480, 640, 3)] * 2
except ValueError as error:
    print(error)
    raise SystemExit(77)
worlds.close()
for name in {[FLAT[0], GOAL[1]]!r}:
    world = gymnasium.make(name, render_mode="rgb_array").unwrapped
    ReachEnv.metadata = ReachEnv.metadata | {{"render_modes": ["rgb_array"]}}  # a window needs a display
    check_env(world)
"""
    done = in_a_process(code)
    if done.returncode == 77:
        pytest.skip(f"this machine has no OpenGL: {done.stdout.strip()}")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_pictures_without_a_display():
    """The goal is drawn where it is, drawing changes nothing, and closing one environment leaves others alone."""
    code = f"""
import numpy as np
from icac_jax.fields import ConfigError
try:
    world = gymnasium.make({FLAT[0]!r}, render_mode="rgb_array")
    world.reset()
    world.render()
    world.close()
except ConfigError:
    raise SystemExit(77)
from gymnasium.utils.env_checker import env_render_passive_checker
pictures = []
for name in {[FLAT[0], GOAL[1]]!r}:
    world = gymnasium.make(name, render_mode="rgb_array", width=160, height=120)
    world.reset(seed=0)
    env_render_passive_checker(world.unwrapped)
    pictures.append(world.render())
    assert pictures[-1].shape == (120, 160, 3) and pictures[-1].dtype == np.uint8 and pictures[-1].std() > 10
    other = gymnasium.make(name, render_mode="rgb_array", width=160, height=120)
    other.reset(seed=1)
    assert not np.array_equal(pictures[-1], other.render())
    other.close()
    other.close()
    assert np.array_equal(pictures[-1], world.render())
    world.unwrapped._goal = world.unwrapped._goal + 0.1
    assert not np.array_equal(pictures[-1], world.render())
    world.reset(seed=0)
    bare = gymnasium.make(name)
    bare.reset(seed=0)
    for _ in range(5):
        world.render()
        action = world.action_space.sample()
        assert str(world.step(action)[0]) == str(bare.step(action)[0])
"""
    for environment in ({"MUJOCO_GL": "egl"}, {}):  # asked for, or chosen because there is no display
        done = in_a_process(code, **environment)
        if done.returncode == 77:
            pytest.skip("this machine has no EGL")
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_world_that_is_left_open_ends_with_the_program():
    """The renderer is freed before OpenGL ends, whatever has asked before for something to be done at the end."""
    early = "import weakref; weakref.finalize(gymnasium, int)"
    make = f"world = gymnasium.make({FLAT[0]!r}, render_mode='rgb_array'); world.reset(); world.render()"
    done = in_a_process(f"{early}\n{make}")
    if "no OpenGL" in done.stderr:
        pytest.skip("this machine has no EGL")
    assert (done.returncode, done.stderr) == (0, "")


def test_who_draws_nothing_needs_nothing_to_draw_with(tmp_path):
    """No driver and no display: a world is made and trained in; what draws says in one line why it cannot."""
    code = f"""
from icac_jax.fields import ConfigError
for mode in ("rgb_array", "human"):
    world = gymnasium.make({FLAT[0]!r}, render_mode=mode)
    try:
        world.reset(seed=0)
        world.step(world.action_space.sample())
        world.render()
    except ConfigError as error:
        print(mode, error)
    world.close()
"""
    done = in_a_process(code, __EGL_VENDOR_LIBRARY_FILENAMES=str(tmp_path / "none.json"))
    assert (done.returncode, done.stderr) == (0, "")
    first, second = done.stdout.splitlines()
    assert first.startswith("rgb_array rendering: there is no OpenGL that can be used here (")
    assert first.endswith("apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri")
    assert second == f"human {pictures.NO_DISPLAY}"


def test_a_missing_libegl_is_one_clear_line(tmp_path):
    """As where it is not installed: with MUJOCO_GL=egl the import of OpenGL ends with an AttributeError."""
    (tmp_path / "OpenGL").mkdir()
    (tmp_path / "OpenGL" / "__init__.py").write_text("raise AttributeError('eglQueryString')")
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import icac_jax.envs.gymnasium"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=os.environ | {"MUJOCO_GL": "egl"}
    )
    said = f"{ConfigError.__module__}.ConfigError: {no_opengl(AttributeError('eglQueryString'))}"
    assert done.stderr.splitlines()[-1] == said


def test_a_picture_larger_than_the_frame_buffer_is_refused():
    with pytest.raises(ConfigError, match=r"^width: must be a whole number at least 1 and at most 1280, got 2000"):
        gymnasium.make(FLAT[0], render_mode="rgb_array", width=2000)


def test_the_window_follows_the_arm(monkeypatch):
    """With a stand-in for MuJoCo's viewer: shown after reset and each step, closed at the end, not after it is shut."""

    class Viewer:
        shown, running, closed = 0, True, 0

        def is_running(self):
            return self.running

        def lock(self):
            return contextlib.nullcontext()

        def sync(self):
            self.shown += 1

        def close(self):
            self.closed += 1

    viewer = Viewer()
    monkeypatch.setattr(pictures, "open_viewer", lambda model, data: viewer)
    monkeypatch.setattr(ours.time, "sleep", lambda seconds: None)
    world = gymnasium.make(FLAT[0], render_mode="human")
    assert viewer.shown == 0
    world.reset(seed=0)
    world.step(np.zeros(2, np.float32))
    assert viewer.shown == 2
    assert world.render() is None
    np.testing.assert_allclose(world.unwrapped.data.site("goal").xpos, world.unwrapped._goal)
    viewer.running = False
    world.step(np.zeros(2, np.float32))
    assert viewer.shown == 2
    world.close()
    world.close()
    assert viewer.closed == 1


def test_a_missing_extra_is_one_line():
    """As where they are not installed: the import of the libraries fails, that of the arms does not."""
    code = """
import importlib, sys
sys.modules["gymnasium"] = sys.modules["gymnax"] = None
import icac_jax.envs.reach
from icac_jax.fields import ConfigError
for name in ("gymnasium", "gymnax"):
    try:
        importlib.import_module(f"icac_jax.envs.{name}")
    except ConfigError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == [
        "gymnasium: needs the extra, pip install 'icac_jax[gymnasium]'",
        "gymnax: needs the extra, pip install 'icac_jax[gymnax]'",
    ]
