"""Named tasks, and the goal that each seed has for good: the same wherever it is asked for."""

import math
import shutil
from pathlib import Path

import gymnasium
import jax
import numpy as np
import pyarrow.parquet as pq
import pytest

import icac_jax
from icac_jax.envs import gymnax, oracle, tasks, walls
from icac_jax.fields import ConfigError
from icac_jax.policies import film, saved
from icac_jax.runs import build, trials
from icac_jax.runs.loop import Training, jobs_of
from icac_jax.settings.options import resolve
from icac_jax.sweeps import groups, sweep_file

OWN_ARM = Path(__file__).resolve().parents[1] / "examples" / "own_arm"
EVERY = [(arm, name) for arm, mine in tasks.TASKS.items() for name in mine]
TINY = ("--task", "two_walls", "--physics", "kinematic", "--seeds", 3, "--map-capacity", 32)


def goals_of(number, **options):
    settings = resolve(**options)
    return settings, np.array([build.task(settings, seed).goal_joints for seed in range(number)])


def tips_of(settings, goals):
    return oracle.tips(settings.arm, np.radians(goals))


def test_the_tasks_are_those_of_the_trial():
    """Boxes in degrees, first joint x second joint, and where the goals' configurations lie."""
    door, two_walls, cup = (resolve(task=name) for name in ("door", "two_walls", "cup"))
    assert door.params.walls == (45, -180, 80, 100)
    assert two_walls.params.walls == (40, -180, 70, 90, 100, -90, 125, 180)
    # The trial's upper and lower wall began at the joint's limit, and left no way out.
    assert cup.params.walls == (40, -120, 70, 120, -140, 100, 70, 130, -140, -130, 70, -100)
    assert (door.goals.goal_joint_low, door.goals.goal_joint_high) == ((95, -90), (170, 60))
    assert (two_walls.goals.goal_joint_low, two_walls.goals.goal_joint_high) == ((140, -60), (175, 90))
    assert (cup.goals.goal_joint_low, cup.goals.goal_joint_high) == ((100, -60), (170, 60))
    for settings in (door, two_walls, cup):
        params = settings.params
        assert (params.joint_low, params.joint_high) == ((-180, -180), (180, 180))
        assert (params.goal_radius, params.horizon, params.start_range, params.reset_range) == (0.2, 80, 0.0, 1.0)
    assert resolve().params.walls == resolve().params.goal_joints == ()


@pytest.mark.parametrize(("arm", "name"), EVERY)
def test_goals_can_be_reached_and_lie_where_they_should(arm, name):
    settings, goals = goals_of(12, arm=arm, task=name)
    where = settings.goals
    if where.goal_joint_low:
        assert np.all((goals >= where.goal_joint_low) & (goals <= where.goal_joint_high))
    assert np.all((goals >= settings.params.joint_low) & (goals <= settings.params.joint_high))
    assert not np.any(walls.within(np.radians(goals), walls.in_rad(settings.params.walls, settings.arm.joints)))
    steps = oracle.distances(settings.arm, settings.params, tips_of(settings, goals))
    assert np.all(np.isfinite(steps) & (steps >= where.goal_distance_low))
    assert len(np.unique(goals, axis=0)) == 12


@pytest.mark.parametrize(
    ("task", "shut", "least"),
    [("gate", (45.0, -180.0, 80.0, 180.0), 1.0), ("door", (45.0, -180.0, 80.0, 180.0), 0.4)],
)
def test_goals_behind_a_wall(task, shut, least):
    """Were the door shut, at least this share of them could not be reached."""
    settings, goals = goals_of(40, task=task)
    steps = oracle.distances(settings.arm, settings.params.replace(walls=shut), tips_of(settings, goals))
    assert np.isinf(steps).mean() >= least


def test_goals_depend_on_the_seeds_alone():
    _, goals = goals_of(4, task="door", algo="icac", seeds=4)
    _, others = goals_of(2, task="door", algo="cacla", seeds=20, sigma=0.1, physics="kinematic", episodes=7)
    np.testing.assert_array_equal(goals[:2], others)
    _, elsewhere = goals_of(4, task="door", root_seed=1)
    assert not np.any(np.all(goals == elsewhere, axis=1))


def test_distances_are_those_asked_for():
    settings, goals = goals_of(6, task="door", goal_distance_low=19, goal_distance_high=22)
    steps = oracle.distances(settings.arm, settings.params, tips_of(settings, goals))
    assert np.all((steps >= 19) & (steps <= 22))
    with pytest.raises(ConfigError, match="goal_distance_low: no goal was found from 90 to inf control steps"):
        build.task(resolve(task="door", goal_distance_low=90), 0)


def test_the_goal_of_a_seed_is_the_same_everywhere(tmp_path, icac):
    """In training by every door, in evaluation, in films, in Gymnasium and in gymnax."""
    settings, goals = goals_of(3, task="cup", algo="cacla", physics="kinematic", seeds=3, episodes=2)
    tips = tips_of(settings, goals)
    training = Training(jobs_of(settings)[1:])
    lanes = training.start()
    np.testing.assert_allclose(np.asarray(lanes.env.goal)[:2], tips[1:], atol=1e-5)
    played = trials.player(settings, 2, 0)(jax.tree.map(lambda leaf: np.asarray(leaf)[:2], lanes.agent))
    np.testing.assert_allclose(played.start.goal, tips[:2, None].repeat(2, 1), atol=1e-5)
    train = {"task": "cup", "physics": "kinematic", "episodes": 2, "progress": False}
    several = icac_jax.train("planar2", "cacla", seeds=np.array([2, 1]), sigma=[[0.1], [0.5]], **train)
    assert several.success.shape == (2, 2)
    icac("train", "--task", "cup", "--algo", "cacla", *TINY[2:6], "--episodes", 2, "--out", "run", check=0)
    mine = icac_jax.train("planar2", "cacla", seeds=3, **train)
    kept = pq.read_table(tmp_path / "run" / "episodes.parquet")
    np.testing.assert_array_equal(kept["steps"].to_numpy(), mine.episodes["steps"].ravel())
    shown = film.play(saved.pick(tmp_path / "run", "2"), 2)
    np.testing.assert_allclose([one.goal for one in shown], tips[[2, 2]], atol=1e-5)
    name = "icac_jax.envs.gymnasium:icac_jax/Planar2Reach-v0"
    world = gymnasium.make(name, task="cup", goal_seed=2).unwrapped
    assert np.allclose([world.reset(seed=seed)[0][2:] for seed in (0, 1)], tips[2, :2] / 2, atol=1e-5)
    env, params = gymnax.make("planar2", task="cup", goal_seed=2)
    np.testing.assert_allclose(env.reset(jax.random.key(3), params)[1].goal, tips[2], atol=1e-5)


def test_a_run_with_walls_is_resumed_to_the_bit(icac, tmp_path):
    icac("train", *TINY, "--episodes", 6, "--out", "whole", check=0)
    icac("train", *TINY, "--episodes", 3, "--out", "parts", check=0)
    icac("resume", "parts", "--episodes", 6, check=0)
    whole, parts = (tmp_path / run for run in ("whole", "parts"))
    assert pq.read_table(whole / "episodes.parquet").equals(pq.read_table(parts / "episodes.parquet"))
    last = [sorted((run / "checkpoints").glob("*.npz"))[-1] for run in (whole, parts)]
    with np.load(last[0]) as first, np.load(last[1]) as second:
        for name in set(first.files) - {"meta"}:
            np.testing.assert_array_equal(first[name], second[name], err_msg=name)
    assert "oracle" in icac("evaluate", "whole", "--pairs", 3, check=0).stdout
    said = icac("train", "--config", "whole/config.toml", "--task", "door")
    assert said.returncode == 2
    assert "task: must be 'two_walls' as in" in said.stderr


def test_what_the_user_says_wins():
    settings = resolve(task="door", preset="best", walls=[[50, -180, 70, 90]], horizon=60, goal_per="episode")
    assert settings.algo == "td3"
    assert settings.params.walls == (50, -180, 70, 90)
    assert (settings.params.horizon, settings.params.goal_radius) == (60, 0.2)
    again = resolve(**settings.flat())
    assert again == settings
    literal = resolve(task="cup", preset="paper-literal", goal_distance_high=math.inf)
    assert literal.spec.critic_target == "previous"


def test_a_sweep_over_tasks_has_a_program_for_each_shape():
    names = ["reach", "door", "gate", "cup"]
    text = f'[base]\nalgo = "cacla"\nphysics = "kinematic"\nseeds = 2\nepisodes = 2\n[grid]\ntask = {names}\n'
    cells = sweep_file.parse(text).cells()
    assert [cell.settings.run.task for cell in cells] == names
    assert [len(group.cells) for group in groups.grouped(cells)] == [1, 2, 1]
    both = Training(groups.grouped(cells)[1].jobs()).start()
    tips = [tips_of(*goals_of(2, task=name)) for name in ("door", "gate")]
    np.testing.assert_allclose(np.asarray(both.env.goal)[:4], np.concatenate(tips), atol=1e-5)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"task": "nix"}, "task: must be one of reach, door, gate, two_walls, cup for planar2, got 'nix'"),
        ({"arm": "nico4", "task": "cup"}, "task: must be one of reach, door, two_walls for nico4, got 'cup'"),
        ({"goal_distance_low": 3.0}, "goal_distance_low: only with goal_per seed"),
        ({"goal_joint_low": (1.0, 2.0)}, "goal_joint_low: only with goal_per seed"),
        ({"task": "door", "goal_joints": (120.0, 0.0)}, "goal_joints: must be left out with goal_per seed"),
        ({"task": "door", "goal_joint_low": (1.0,)}, "goal_joint_low: must be 2 numbers, got 1"),
        ({"task": "door", "goal_joint_low": (171.0, 0.0)}, "goal_joint_low: must be at most goal_joint_high"),
        ({"task": "door", "goal_distance_low": 9.0, "goal_distance_high": 8.0}, "goal_distance_low: must be at most"),
        ({"goal_per": "lane"}, "goal_per: must be one of episode, seed, got 'lane'"),
    ],
)
def test_what_is_refused(options, words):
    with pytest.raises(ConfigError, match=words):
        resolve(**options)


def test_an_own_arm_has_the_tasks_of_its_file(tmp_path):
    place = shutil.copytree(OWN_ARM, tmp_path / "own") / "arm.toml"
    with pytest.raises(
        ConfigError, match=r"task: must be one of reach for .*arm.toml, got 'door'; \[tasks.door\] in its file"
    ):
        resolve(arm=str(place), task="door")
    joints = resolve(arm=str(place)).arm.joints
    low, high = [10.0] + [-400.0] * (joints - 1), [20.0] + [400.0] * (joints - 1)
    place.write_text(f"{place.read_text()}\n[tasks.door]\nwalls = {[low + high]}\nstart_range = 0.0\nhorizon = 33\n")
    found = resolve(arm=str(place), task="door").params
    assert (found.walls, found.horizon) == ((*low, *high), 33)
    assert resolve(arm=str(place), walls=(*low, *high), start_range=0.0).params.walls == found.walls
    place.write_text(place.read_text() + "horizont = 3\n")
    with pytest.raises(ConfigError, match="horizont: no such option; did you mean horizon"):
        resolve(arm=str(place), task="door")
