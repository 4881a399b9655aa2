"""Starting from demonstrations: what the oracle shows, files of it, what learners make of it, resuming, refusals."""

import json
from pathlib import Path

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import icac_jax
from icac_jax.agents import imitation, registry
from icac_jax.agents.imitation import NONE
from icac_jax.cli import main
from icac_jax.envs import demonstrator, oracle, planner, reach
from icac_jax.fields import ConfigError
from icac_jax.runs import demonstrations, trials
from icac_jax.runs.loop import Job, Training
from icac_jax.runs.recorder import DemonstrationRecorder
from icac_jax.settings import demonstration_files
from icac_jax.settings.options import resolve
from icac_jax.sweeps import sweep_file

TINY = {"physics": "kinematic", "seeds": 2, "episodes": 6}
FEW = {"demonstrated_episodes": 3, "pretraining_updates": 50}


def task(**changes):
    return resolve(**TINY | changes)


@pytest.fixture(scope="module")
def played():
    settings = task()
    env = reach.make(settings.arm, "kinematic")
    return lambda episodes, noise=0.0: demonstrator.demonstrate(
        settings.arm, env, settings.params, jax.random.key(3), episodes, noise
    )


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("demonstrations") / "some.parquet"
    assert main.main(["demonstrate", "planar2", "--physics", "kinematic", "--episodes", "5", "--out", str(path)]) == 0
    return path


def joints_of(observation, params):
    low, high = np.radians(params.joint_low), np.radians(params.joint_high)
    return low + (observation[:, :2] + 1) / 2 * (high - low)


def test_the_oracle_takes_the_least_steps(played):
    settings, recorded = task(), played(20)
    lengths, first = np.bincount(recorded.episode), np.searchsorted(recorded.episode, np.arange(20))
    arm = settings.arm
    start = joints_of(recorded.observation[first].astype(float), settings.params)
    low, high = np.array(arm.goal_low), np.array(arm.goal_high)
    goal = np.zeros((20, 3))
    goal[:, list(arm.goal_axes)] = low + (recorded.observation[first, 2:] + 1) / 2 * (high - low)
    least = oracle.steps(arm, settings.params, start, goal)
    # Rounding of what is read back from observations may cost or spare a step at the edge of the goal zone.
    assert np.mean(lengths == least) >= 0.9
    assert np.max(np.abs(lengths - least)) <= 1
    last = np.append(np.diff(recorded.episode) != 0, True)
    assert np.array_equal(recorded.terminated, last)  # each ends in the goal zone, and none goes on there
    assert np.array_equal(recorded.reward, np.where(last, 50.0, 0.0))
    assert np.array_equal(recorded.next_observation[~last], recorded.observation[1:][~last[:-1]])
    tips = oracle.tips(arm, joints_of(recorded.next_observation.astype(float), settings.params))
    np.testing.assert_allclose(recorded.achieved, tips, atol=1e-5)


def test_an_episode_is_the_same_however_many_there_are(played):
    few, many = played(3), played(40)
    for one, other in zip(few, many.first(3), strict=True):
        assert np.array_equal(one, other)
    assert (few.episodes, many.episodes) == (3, 40)


def test_noise_makes_demonstrations_worse_and_still_right(played):
    plain, noisy = played(20), played(20, 0.5)
    assert len(noisy.action) > 1.1 * len(plain.action)
    assert noisy.terminated.sum() == 20
    assert np.abs(noisy.action).max() <= 1.0


def test_postures_of_nico_are_in_the_goal_zone_within_the_steps_of_the_oracle():
    settings = resolve(arm="nico4", physics="kinematic")
    start, goal = oracle.pairs(settings.arm, settings.params, 8)
    posture = planner.postures(settings.arm, settings.params, start, goal)
    miss = np.linalg.norm(oracle.tips(settings.arm, posture) - goal, axis=1)
    assert np.all(miss <= settings.params.goal_radius)
    needed = np.ceil(np.max(np.abs(posture - start), axis=1) / np.radians(10) - 1e-4)
    least = oracle.steps(settings.arm, settings.params, start, goal)
    assert np.mean(np.maximum(needed, 1) <= least) >= 0.75


@pytest.mark.parametrize("algo", ["icac", "td3"])
def test_learners_can_do_something_before_they_train(algo):
    more = {"hindsight": "future", "pretraining_updates": 600} if algo == "td3" else {}
    settings = task(algo=algo, demonstrations="oracle", demonstrated_episodes=20, **more)
    training, play = Training.of_run(settings), trials.player(settings, 100, 0)
    before, after = (
        play(jax.tree.map(np.asarray, lanes.agent)).reached.mean() for lanes in (training.fresh(), training.start())
    )
    assert after > before + 0.25
    assert after > 0.5


def learners_of(**options):
    """What two seeds have learnt and kept before they train."""
    return jax.device_get(Training.of_run(task(**options)).start().agent)


@pytest.mark.parametrize("algo", registry.LEARNERS)
def test_every_learner_starts_from_them(algo):
    """By shapes alone: what is shown leaves states that training, checkpoints and records can go on with."""
    settings = task(algo=algo, hindsight="future", coverage_bins=4, demonstrations="oracle", **FEW)
    training = Training([Job(settings, 0)])

    def shown(key):
        state = jax.vmap(lambda key: training.agent.init(key, settings.hyper.traced()))(key[None])
        numbers = jax.tree.map(lambda leaf: leaf[None], (settings.hyper.traced(), settings.params.traced()))
        demonstrated = demonstrations.shown([(settings, 0, settings.params)])()
        return state, imitation.imitated(training.agent, training.env, state, demonstrated, key[None], *numbers)

    with jax.ensure_compile_time_eval():
        demonstrations.of_oracle(settings, 0)  # kept from here on
    plain, taught = jax.eval_shape(shown, jax.random.key(0))
    assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), plain) == jax.tree.map(
        lambda leaf: (leaf.shape, leaf.dtype), taught
    )


def test_the_buffer_holds_them():
    options = {"algo": "td3", "hindsight": "future", "demonstrations": "oracle"} | FEW
    recorded = demonstrations.of_oracle(task(**options), 0)
    buffer = jax.tree.map(lambda leaf: leaf[0], learners_of(**options).replay)
    number = len(recorded.episode)
    assert (int(buffer.count), int(buffer.episode)) == (number, 3)
    rows = np.column_stack([recorded.observation, recorded.action, recorded.next_observation])
    assert np.array_equal(buffer.rows[:number, : rows.shape[1]], rows)
    assert np.array_equal(buffer.rows[:number, -1], recorded.terminated)
    assert np.array_equal(buffer.episodes[:number], recorded.episode)
    assert np.array_equal(buffer.rows[:number, rows.shape[1] : -3], recorded.achieved)


def test_a_seed_is_shown_its_own_and_one_that_is_shown_none_is_as_ever():
    options = {"algo": "cacla", "demonstrations": "oracle"} | FEW
    none = task(**options | {"demonstrated_episodes": 0})
    shown, fresh = learners_of(**options).actor, learners_of(algo="cacla").actor
    mixed = np.asarray(Training([Job(task(**options), 1), Job(none, 1)]).start().agent.actor)
    assert not np.array_equal(shown[0], shown[1])
    assert np.array_equal(mixed[:2], [shown[1], fresh[1]])  # whatever company they have


def test_demonstrations_cost_training_nothing():
    """The compiled program of the steps is the one without them: only where lanes begin is another one."""
    plain, shown = Training.of_run(task()), Training.of_run(task(demonstrations="oracle", **FEW))
    assert (plain.agent, plain.env) == (shown.agent, shown.env)
    assert all(a is b for a, b in zip(plain.agent, shown.agent, strict=True))
    kinds = [[leaf.dtype for leaf in jax.tree.leaves(one.fresh())] for one in (plain, shown)]
    assert kinds[0] == kinds[1]


def files_of(run):
    return pq.read_table(run / "episodes.parquet")


def test_a_run_is_resumed_without_its_file(file, tmp_path, capsys):
    args = ["--algo", "cacla", "--physics", "kinematic", "--seeds", "2", "--no-report"]
    args += ["--pretraining-updates", "50", "--demonstrations"]
    copy = tmp_path / "gone.parquet"
    copy.write_bytes(file.read_bytes())
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    assert main.main(["train", *args, str(copy), "--episodes", "9", "--out", str(whole)]) == 0
    assert main.main(["train", *args, str(copy), "--episodes", "4", "--out", str(cut)]) == 0
    copy.unlink()
    assert main.main(["resume", str(cut), "--episodes", "9"]) == 0
    assert files_of(whole).equals(files_of(cut))
    # From before the first checkpoint, in another place: the run's own copy is read again.
    moved = tmp_path / "moved"
    cut.rename(moved)
    for path in ("checkpoints", "episodes.parquet", "summary.json"):
        target = moved / path
        for one in target.glob("*") if target.is_dir() else [target]:
            one.unlink()
    assert main.main(["resume", str(moved)]) == 0
    assert files_of(whole).equals(files_of(moved))
    assert main.main(["train", "--config", str(moved / "config.toml"), "--out", str(tmp_path / "again")]) == 0
    assert files_of(whole).equals(files_of(tmp_path / "again"))
    capsys.readouterr()
    (moved / "demonstrations.parquet").write_bytes(b"other")
    for one in (moved / "checkpoints").glob("*"):
        one.unlink()
    (moved / "episodes.parquet").unlink()
    demonstration_files._read.cache_clear()
    assert main.main(["resume", str(moved)]) == 2
    assert "is not what it was when the run began" in capsys.readouterr().err


def test_python_and_sweeps(tmp_path):
    options = {"demonstrations": "oracle"} | FEW
    run = icac_jax.train("planar2", "cacla", seeds=2, episodes=3, physics="kinematic", progress=False, **options)
    kept = icac_jax.train("planar2", "cacla", seeds=2, episodes=3, physics="kinematic", out=tmp_path / "run", **options)
    assert np.array_equal(run.episodes["steps"], kept.episodes["steps"])
    with pytest.raises(ConfigError, match="demonstrations: must be left out with objects"):
        icac_jax.train(reach.make(task().arm, "kinematic"), "cacla", demonstrations="oracle")
    text = 'base = {algo = "cacla", demonstrations = "oracle", seeds = 2, episodes = 2, physics = "kinematic"}\n'
    cells = sweep_file.parse(text + "grid = {demonstrated_episodes = [0, 2]}").cells()
    assert [cell.settings.imitation.of_oracle for cell in cells] == [0, 2]
    study = tmp_path / "study.toml"
    study.write_text(text + "grid = {demonstrated_episodes = [0, 2]}")
    assert main.main(["sweep", str(study), "--out", str(tmp_path / "sweep"), "--lanes", "2"]) == 0
    rows = json.loads((tmp_path / "sweep" / "summary.json").read_text())["cells"]
    assert [row["varied"]["demonstrated_episodes"] for row in rows] == [0, 2]


def altered(path, target, change):
    """A copy of a file with its table changed."""
    table = change(pq.read_table(path))
    pq.write_table(table, target)
    return target


def with_column(name, values):
    return lambda table: table.set_column(table.column_names.index(name), name, values(table[name]))


def first_is(value):
    return lambda column: pa.array([value, *column.to_pylist()[1:]], column.type)


DAMAGED = {
    "column": (lambda t: t.drop_columns("action"), "no column action"),
    "metadata": (lambda t: t.replace_schema_metadata({}), "no metadata"),
    "empty": (lambda t: t.slice(0, 0), "no rows"),
    "nan": (with_column("observation", first_is([np.nan] * 4)), "observation must be finite"),
    "action": (with_column("action", first_is([2.0, 0.0])), "action must be within"),
    "null": (with_column("reward", first_is(None)), "reward has missing values"),
    "episode": (with_column("episode", first_is(7)), "episode must count from 0"),
    "sizes": (lambda t: t.set_column(1, "action", t["next_observation"]), "action must have 2 entries"),
    "several": (with_column("action", lambda c: pa.array([[0.1], *c.to_pylist()[1:]])), "rows of several sizes"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_wrong_files_are_refused_in_a_line(name, file, tmp_path):
    change, said = DAMAGED[name]
    with pytest.raises(ConfigError, match=said) as refused:
        task(demonstrations=str(altered(file, tmp_path / "wrong.parquet", change)))
    assert "\n" not in str(refused.value)
    assert "demonstrations:" in str(refused.value)


@pytest.mark.parametrize("place", [0.1, 0.5, 0.9])
def test_damaged_files_are_refused(place, file, tmp_path):
    content = bytearray(file.read_bytes())
    content[int(place * len(content))] ^= 0xFF
    (tmp_path / "wrong.parquet").write_bytes(content)
    with pytest.raises(ConfigError, match=r"^demonstrations: [^\n]*$"):
        task(demonstrations=str(tmp_path / "wrong.parquet"))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"arm": "nico4"}, "demonstrations: must be of nico4"),
        ({"joint_high": (90.0, 90.0)}, "demonstrations: joint_high must be"),
        ({"goal_reward": 1.0}, "demonstrations: goal_reward must be"),
        ({"demonstrated_episodes": 6}, "demonstrated_episodes: must be at most 5"),
        ({"demonstration_noise": 0.1}, "demonstration_noise: only with demonstrations oracle"),
        ({"demonstrations": "nowhere.parquet"}, "demonstrations: cannot read"),
        ({"demonstrations": NONE, "pretraining_updates": 5}, "pretraining_updates: only with demonstrations"),
        ({"demonstrations": "oracle", "task": "door"}, "demonstrations: must not be oracle"),
    ],
)
def test_other_tasks_are_refused(options, said, file):
    with pytest.raises(ConfigError, match=said):
        task(**{"demonstrations": str(file)} | options)


def test_wrong_command_lines(file, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for line, said in (
        ("demonstrate planar2 --episodes 0", "episodes: must be"),
        ("demonstrate planar2 --noise -1", "demonstration_noise: must be"),
        ("demonstrate planar2 --physics kinematic --out no/where.parquet --episodes 1", "out: cannot write"),
        ("demonstrate planar2 --physics kinematic --horizon 1 --episodes 40", "the oracle reached"),
        ("train --demonstrations nowhere.parquet", "demonstrations: cannot read"),
    ):
        assert main.main(line.split()) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1, error
    assert not list(Path().iterdir())


def test_an_agent_that_cannot_is_refused(monkeypatch):
    learner = registry.LEARNERS["cacla"]
    cannot = learner._replace(build=lambda spec, env: learner.build(spec, env)._replace(imitate=None))
    monkeypatch.setitem(registry.learners(), "cacla", cannot)
    with pytest.raises(ConfigError, match="demonstrations: must be none with cacla"):
        Training.of_run(task(algo="cacla", demonstrations="oracle"))


def test_the_recorder_keeps_what_was_done(tmp_path):
    gymnasium = pytest.importorskip("gymnasium")
    out = tmp_path / "by_hand.parquet"
    for name in ("Planar2Reach", "Planar2ReachGoal"):
        env = DemonstrationRecorder(
            gymnasium.make(f"icac_jax.envs.gymnasium:icac_jax/{name}-v0", physics="kinematic"), out
        )
        world = env.unwrapped
        wanted = 3
        for seed in range(3):
            env.reset(seed=seed)
            wanted += env.step(np.zeros(2))[2]  # given up, unless the goal happens to be there
            env.reset(seed=seed)
            goal = planner.postures(world.arm, world.params, world._joints[None], world._goal[None])[0]
            over = False
            while not over:
                change = (goal - world._joints) / np.radians(10)
                *_, terminated, truncated, _ = env.step(change / max(1.0, np.abs(change).max()))
                over = terminated or truncated
        assert env.episodes == wanted
        env.close()
        settings = task(demonstrations=str(out), algo="cacla", pretraining_updates=50)
        recorded = demonstration_files.read(settings.imitation, settings.arm, settings.params)
        assert recorded.episodes == wanted
        assert recorded.reward.sum() == 50.0 * wanted
        tips = oracle.tips(world.arm, joints_of(recorded.next_observation.astype(float), world.params))
        np.testing.assert_allclose(recorded.achieved, tips, atol=1e-5)
        Training.of_run(settings).start()
        out.unlink()
    with pytest.raises(ConfigError, match=r"env: must be one of icac_jax\.envs\.gymnasium"):
        DemonstrationRecorder(gymnasium.make("CartPole-v1"), out)


@pytest.mark.parametrize("option", ["demonstrations", "encoder"])
def test_a_file_that_is_not_there(option):
    """A line, and no character in it that a terminal would obey."""
    with pytest.raises(ConfigError, match=rf"^{option}: cannot read .*No such file") as raised:
        resolve(**{option: "/nowhere/\x1b[31m.file"})
    assert "\x1b" not in str(raised.value)
