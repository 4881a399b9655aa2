"""Runs that start with the map and the predictors of another run."""

import shutil

import jax
import numpy as np
import pyarrow.parquet as pq
import pytest

import icac_jax
from icac_jax.errors import ConfigError
from icac_jax.runs import checkpoints, folder, warm_maps
from icac_jax.runs.loop import Training
from icac_jax.settings.options import resolve
from icac_jax.sweeps import sweep_file
from tests.conftest import here

SAME = {"physics": "kinematic", "map_capacity": 16}
TINY = SAME | {"seeds": 2, "episodes": 6, "horizon": 10}


def words(options):
    return [word for name, value in options.items() for word in (f"--{name.replace('_', '-')}", value)]


def trained(out, **options):
    done = here("train", *words(options), "--no-report", "--out", out)
    assert done.returncode == 0, done.stderr
    return out


def episodes(run):
    return pq.read_table(run / "episodes.parquet")


def curiosity_of(lanes):
    return jax.device_get(lanes.agent.curiosity)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return trained(tmp_path_factory.mktemp("source") / "run", **TINY)


@pytest.fixture(scope="module")
def warm(source, tmp_path_factory):
    """A run over other goals, from the source's map, and the source is gone afterwards."""
    place = tmp_path_factory.mktemp("warm")
    copy = shutil.copytree(source, place / "source")
    run = trained(place / "run", **TINY, goal_range=0.5, warm_map=copy)
    shutil.rmtree(copy)
    return run


def test_it_starts_with_the_whole_map_seed_by_seed(source):
    settings = resolve(**TINY, goal_range=0.5, warm_map=str(source))
    start = curiosity_of(Training.of_run(settings).start())
    cold = Training.of_run(resolve(**TINY))
    newest = checkpoints.listed(source / folder.CHECKPOINTS)[-1]
    loaded = curiosity_of(checkpoints.load(newest, cold.start(), 2).lanes)
    # Lanes beyond the seeds are padding.
    jax.tree.map(lambda one, other: np.testing.assert_array_equal(one[:2], other[:2]), start, loaded)
    assert start.step[:2].min() > 20
    assert start.bank.queries[:2].sum() > 40
    fresh = curiosity_of(cold.start())
    assert (np.asarray(start.map.weights) != np.asarray(fresh.map.weights)).any()


def test_one_seed_is_for_all(source):
    lanes = Training.of_run(resolve(**TINY)).start()
    found = warm_maps.load(resolve(**TINY, warm_map=str(source)))
    first = found._replace(leaves={name: leaf[:1] for name, leaf in found.leaves.items()})
    queries = curiosity_of(first.onto(lanes, np.array([0, 1]))).bank.queries
    np.testing.assert_array_equal(queries, found.leaves["bank.queries"][[0, 0]])
    with pytest.raises(ConfigError, match=r"^warm_map: must be of one seed or at least 3, .* has 2$"):
        found.onto(lanes, np.array([0, 2]))


def test_what_the_run_says_and_how_it_goes_on(warm, tmp_path):
    said = (warm / folder.CONFIG).read_text()
    assert 'warm_map = "warm_map.npz"' in said
    settings = folder.load(warm)
    assert settings.warm.warm_map_from == str(warm.parent / "source")
    # Stopped and made longer, wherever it is now: the same as in one go.
    whole = trained(tmp_path / "whole", **TINY | {"episodes": 9}, goal_range=0.5, warm_map=warm / folder.WARM_MAP)
    moved = shutil.copytree(warm, tmp_path / "moved")
    assert here("resume", moved, "--episodes", 9).returncode == 0
    assert episodes(moved).equals(episodes(whole))
    # Its own file repeats it, and says again where the map came from first.
    again = trained(tmp_path / "again", config=warm / folder.CONFIG)
    assert episodes(again).equals(episodes(warm))
    assert folder.load(again).warm.warm_map_from == settings.warm.warm_map_from


def test_a_run_that_was_killed_before_its_first_checkpoint_starts_from_its_copy(warm, tmp_path):
    begun = shutil.copytree(warm, tmp_path / "begun")
    for name in (folder.CHECKPOINTS, folder.RECORDS):
        shutil.rmtree(begun / name, ignore_errors=True)
    for name in ("episodes.parquet", folder.SUMMARY, folder.STATUS):
        (begun / name).unlink()
    done = here("resume", begun)
    assert done.returncode == 0, done.stderr
    assert episodes(begun).equals(episodes(warm))


def test_python_gives_the_same(source, warm):
    options = {name: value for name, value in TINY.items() if name not in ("seeds", "episodes")}
    run = icac_jax.train(
        "planar2", "icac", seeds=2, episodes=6, goal_range=0.5, warm_map=str(source), progress=False, **options
    )
    rows = episodes(warm).to_pandas().sort_values(["seed", "episode"])
    np.testing.assert_array_equal(run.episodes["intrinsic_reward"].ravel(), rows["intrinsic_reward"])
    cold = icac_jax.train("planar2", "icac", seeds=2, episodes=6, goal_range=0.5, progress=False, **options)
    assert (cold.episodes["intrinsic_reward"] != run.episodes["intrinsic_reward"]).any()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"arm": "nico4"}, "must be of a run with arm nico4, {} has planar2"),
        ({"map": "gng"}, "must be of a run with map gng, {} has itm"),
        ({"signal": "counts"}, "must be of a run with signal counts, {} has icac"),
        ({"map_capacity": 32}, "must have map.weights of (32, 2) float32 as this run has, {} has (16, 2) float32"),
        ({"hidden_units": 5}, "must have bank.params of (16, 37) float32"),
        ({"seeds": 3}, "must be of one seed or at least 3, {} has 2"),
        ({"signal": "rnd"}, "must not be given, the signal rnd has no map"),
        ({"algo": "cacla"}, "must not be given, cacla has no map"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_another_run_is_refused_before_there_is_a_folder(source, tmp_path, options, words):
    given = TINY | options
    if options.get("algo") == "cacla":
        del given["map_capacity"]
    with pytest.raises(ConfigError) as caught:
        Training.of_run(resolve(**given, warm_map=str(source)))
    assert str(caught.value).startswith(f"warm_map: {words.format(source.resolve())}"[:45])
    assert words.format(source.resolve()) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_map_is_refused_in_one_line(warm, source, tmp_path):
    def line(**options):
        done = here("train", *words(TINY | options), "--out", tmp_path / "out")
        assert done.returncode == 2
        assert not (tmp_path / "out").exists()
        assert len(done.stderr.strip().splitlines()) == 1
        return done.stderr

    assert "warm_map: cannot read nowhere: No such file" in line(warm_map="nowhere")
    (tmp_path / "empty").mkdir()
    assert "holds no run" in line(warm_map=tmp_path / "empty")
    (tmp_path / "text.npz").write_text("no archive")
    assert "warm_map: " in line(warm_map=tmp_path / "text.npz")
    with pytest.raises(ConfigError, match=r"^\[base\] warm_map: must not be in a sweep"):
        sweep_file.parse(f'[base]\nwarm_map = "{source}"\n[grid]\nsigma = [0.1, 0.2]\n')
    changed = shutil.copytree(warm, tmp_path / "changed")
    with (changed / folder.WARM_MAP).open("ab") as file:
        file.write(b"more")
    said = here("resume", changed)
    assert said.returncode == 2
    assert "is not what it was when the run began" in said.stderr
