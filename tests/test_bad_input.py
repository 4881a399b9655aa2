"""Malformed command lines, configurations, checkpoints and records: one line that names the culprit, no traceback."""

import dataclasses
import functools
import io
import json
import pickle
import shutil
import tempfile
from pathlib import Path
from typing import Literal

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from icac_jax.cli import main, parsing
from icac_jax.fields import ConfigError, param
from icac_jax.runs import checkpoints, folder, store
from icac_jax.runs.loop import Training
from icac_jax.settings.options import of_learner, resolve

TINY = ["--physics", "kinematic", "--seeds", "2", "--episodes", "4", "--map-capacity", "16", "--checkpoint-every", "0"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished run to spoil copies of; it has records in `episodes.parquet` and two checkpoints."""
    place = tmp_path_factory.mktemp("whole") / "run"
    assert main.main(["train", *TINY, "--episodes", "60", "--out", str(place)]) == 0
    return place


@pytest.fixture
def run(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "run")
    return tmp_path / "run"


def outcome(capsys, *args):
    """Exit status and what was said, for one call of the command line."""
    capsys.readouterr()
    try:
        status = main.main([str(arg) for arg in args])
    except SystemExit as stop:
        status = stop.code
    return status, capsys.readouterr()


def refused(capsys, status, names, *args):
    got, said = outcome(capsys, *args)
    assert got == status, said.err
    assert said.out == ""
    assert said.err.count("\n") == 1, said.err
    assert said.err.startswith(f"icac {args[0]}: ")
    for name in names:
        assert name in said.err, said.err


COMMAND_LINES = [
    ("walk", ["unknown command"]),
    ("train --seed 3", ["--seed: no such option; did you mean --seeds?"]),
    ("train --num-envs 8", ["--num-envs: no such option"]),
    ("train --num-envs=8 word", ["--num-envs: no such option"]),
    ("train word another", ["unexpected argument 'word'"]),
    ("train --config=", ["config: must not be empty"]),
    ("train --out=", ["out: must be a path, got ''"]),
    ("train --json=yes", ["json: takes no value, got 'yes'"]),
    ("train --joint-low -180 -1e2 --gama 1", ["--gama", "--gamma"]),
    ("export . --format", ["format"]),
    ("render . --episodes 2.5", ["episodes: must be a whole number, got '2.5'"]),
    ("sweep a b", ["unexpected argument 'b'"]),
    ("best a --metric reward", ["metric: must be one of steps, success_rate, extrinsic_reward, got 'reward'"]),
    ("reproduce --arm left", ["arm: must be one of planar2, nico4, both, got 'left'"]),
    ("train --gamma=-0.1", ["gamma", "-0.1"]),
    ("train --gamma nan", ["gamma", "nan"]),
    ("train --gamma inf", ["gamma", "inf"]),
    ("train --gamma 0.9 0.8", ["0.8"]),
    ("train --gamma ''", ["gamma"]),
    ("train --sigma -1", ["sigma"]),
    ("train --sigma 0,5", ["sigma", "0,5"]),
    ("train --beta 0", ["beta"]),
    ("train --beta 1.01", ["beta"]),
    ("train --actor-rate 0", ["actor_rate"]),
    ("train --critic-rate -2", ["critic_rate"]),
    ("train --predictor-rate 0", ["predictor_rate"]),
    ("train --map-rate 2", ["map_rate"]),
    ("train --e-max -1", ["e_max"]),
    ("train --mu 0", ["mu"]),
    ("train --mu 20.5", ["mu"]),
    ("train --mu 100", ["window", "120"]),
    ("train --T 0", ["T"]),
    ("train --T 50", ["T", "mu"]),
    ("train --window 1", ["window"]),
    ("train --horizon -5", ["horizon"]),
    ("train --horizon 1e3", ["horizon"]),
    ("train --seeds -1", ["seeds"]),
    ("train --seeds many", ["seeds"]),
    ("train --episodes 0", ["episodes"]),
    ("train --sub-steps 0", ["sub_steps"]),
    ("train --root-seed -1", ["root_seed"]),
    ("train --root-seed 99999999999", ["root_seed"]),
    ("train --episodes 3000000000", ["episodes", "3000000000"]),
    ("train --horizon 3000000000", ["horizon"]),
    ("train --seeds 3000000000", ["seeds"]),
    ("evaluate . --pairs 0", ["pairs"]),
    ("evaluate . --pair-seed 99999999999999999999", ["pair_seed"]),
    ("train --hidden-units 0", ["hidden_units"]),
    ("train --hidden-layers 9", ["hidden_layers"]),
    ("train --map-capacity 1", ["map_capacity"]),
    ("train --map-capacity 1e9", ["map_capacity"]),
    ("train --variance-init 0", ["variance_init"]),
    ("train --max-actor-updates 0", ["max_actor_updates"]),
    ("train --reward-scale 0", ["reward_scale"]),
    ("train --goal-radius 0", ["goal_radius"]),
    ("train --goal-reward nan", ["goal_reward"]),
    ("train --action-bound 0", ["action_bound"]),
    ("train --reset-range 0", ["reset_range"]),
    ("train --reset-range 1.1", ["reset_range"]),
    ("train --joint-low 0 0 0", ["joint_low", "2 numbers"]),
    ("train --joint-low 0 x", ["joint_low"]),
    ("train --joint-low 170 10 --joint-high 10 170", ["joint_low", "less than joint_high"]),
    ("train --joint-high 40000 10", ["joint_high", "36000"]),
    ("train --arm nico4 --joint-low 0 0", ["joint_low", "4 numbers"]),
    ("train --optimizer lion", ["optimizer", "sgd, adam, rmsprop"]),
    ("train --exploration none", ["exploration"]),
    ("train --window-mean T", ["window_mean"]),
    ("train --prediction-node both", ["prediction_node"]),
    ("train --bootstrap-at-goal 1", ["bootstrap_at_goal"]),
    ("train --perception-half-life 0", ["perception_half_life"]),
    ("train --perception-patience -1", ["perception_patience"]),
    ("train --checkpoint-every -1", ["checkpoint_every"]),
    ("train --checkpoint-every nan", ["checkpoint_every"]),
    ("train --checkpoint-every soon", ["checkpoint"]),
    ("train --config", ["config"]),
    ("train --config /", ["config"]),
    ("train --out", ["out"]),
    ("train -x", ["-x"]),
    ("train --observation-size 3", ["--observation-size"]),
    ("resume", ["run"]),
    ("resume absent", ["run", "absent"]),
    ("resume . --episodes 5", ["run", "holds no run"]),
    ("resume . --episodes x", ["episodes"]),
    ("resume a b", ["b"]),
    ("resume . --gamma 0.5", ["--gamma"]),
    ("runs absent", ["folder", "absent"]),
    ("runs --all", ["--all"]),
]


@pytest.mark.parametrize(("line", "names"), COMMAND_LINES, ids=[line for line, _ in COMMAND_LINES])
def test_command_line(line, names, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    args = [arg.strip("'") for arg in line.split()]
    if args[0] == "walk":
        status, said = outcome(capsys, *args)
        assert (status, said.out, said.err.count("\n")) == (2, "", 1)
    else:
        refused(capsys, 2, names, *args)
    assert list(tmp_path.iterdir()) == []


def test_commands_are_suggested_and_helped(capsys):
    for args in (["trian"], ["help", "trian"]):
        status, said = outcome(capsys, *args)
        assert (status, said.out, said.err.count("\n")) == (2, "", 1)
        assert said.err.endswith("did you mean train?\n")
    for args in (["help"], ["help", "runs"], ["runs", "--help"]):
        status, said = outcome(capsys, *args)
        assert (status, said.err, said.out.startswith("usage: icac")) == (0, "", True)


def test_values_are_read_as_the_fields_say():
    @dataclasses.dataclass(frozen=True)
    class Some:
        place: parsing.Positional[tuple[Path, ...]] = (Path("runs"),)
        low: tuple[float, ...] = ()
        kind: Literal["a", "b"] = "a"
        flag: bool = False
        no_cache: bool = False
        truth: bool = True
        maybe: int | None = None
        text: str = ""

    fields = {"truth": param(True, "", source="")}
    read = functools.partial(parsing.parse, "some", Some, fields=fields)
    assert read([]) == Some()
    given = [
        "x",
        "--low",
        "-180",
        "-1e2",
        "--kind=b",
        "--flag",
        "--no-cache",
        "--truth",
        "False",
        "--maybe",
        "-3",
        "--",
        "-y",
    ]
    assert read(given) == Some((Path("x"), Path("-y")), (-180.0, -100.0), "b", True, True, False, -3)
    assert read(["--no-flag", "--cache", "--text=-x", "--low=-inf"]) == Some(text="-x", low=(-float("inf"),))
    assert read(["--maybe", "1", "--maybe", "2", "--no_cache"]) == Some(maybe=2, no_cache=True)


CONFIGS = {
    "empty option": "gamma =",
    "not TOML": "{'gamma': 0.9}",
    "YAML": "gamma: 0.9",
    "a table": "[gamma]\nvalue = 0.9",
    "twice": "gamma = 0.9\ngamma = 0.8",
    "unknown": "discount = 0.9",
    "misspelt": "gama = 0.9",
    "text for a number": 'gamma = "0.9"',
    "list for a number": "gamma = [0.9, 0.8]",
    "number for a list": "joint_low = 0.0",
    "nested list": "joint_low = [[0.0, 0.0]]",
    "list of text": 'joint_low = ["0", "0"]',
    "list with nan": "joint_low = [nan, 0.0]",
    "number for a choice": "algo = 1",
    "wrong choice": 'algo = "dqn"',
    "list for a choice": 'algo = ["icac"]',
    "float for an integer": "seeds = 2.5",
    "date": "seeds = 2026-01-01",
    "bool for a number": "sigma = true",
    "number for a bool": "bootstrap_at_goal = 1",
    "huge integer": "root_seed = 99999999999999999999",
    "integer too long for a float": "gamma = 1" + "0" * 400,
    "integer too long for anything": "gamma = 1" + "0" * 5000,
    "wrong arm": 'arm = "left"',
    "number for an arm": "arm = 2",
    "wrong preset": 'preset = "bestest"',
    "number for a preset": "preset = 1",
    "T beyond mu": "T = 60\nwindow = 200",
    "short window": "window = 10",
    "derived": "observation_size = 4",
}


NO_TOML = ("empty option", "not TOML", "YAML", "twice", "integer too long for anything")
FIELDS = {"short window": "window", "T beyond mu": "T: must be at most mu"}


@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.parametrize("command", ["train", "resume"])
def test_configuration(name, command, run, capsys, tmp_path):
    target = run / "config.toml" if command == "resume" else tmp_path / "c.toml"
    target.write_text(CONFIGS[name])
    before = sorted(path.name for path in run.iterdir())
    args = ["resume", run] if command == "resume" else ["train", "--config", target, "--out", tmp_path / "new"]
    names = (
        [str(target)] if name in NO_TOML else [str(target), FIELDS.get(name) or CONFIGS[name].split()[0].strip("[]")]
    )
    refused(capsys, 2, names, *args)
    assert sorted(path.name for path in run.iterdir()) == before
    assert not (tmp_path / "new").exists()


def test_configuration_in_bytes_that_are_no_text(run, capsys):
    (run / "config.toml").write_bytes(b"\xff\xfe\x00gamma")
    refused(capsys, 2, ["config.toml", "not valid TOML"], "resume", run)


@pytest.mark.parametrize(
    ("option", "value"), [("gamma", 0.5), ("seeds", 1), ("algo", "cacla"), ("hidden_units", 5), ("root_seed", 1)]
)
def test_configuration_that_is_not_the_checkpoints(option, value, run, capsys):
    changed = resolve(**of_learner(folder.load(run).flat() | {option: value}))
    folder.write_config(run, changed)
    for command in ("resume", "evaluate"):
        refused(capsys, 2, ["config.toml", f"{option} must be"], command, run)


def rewrite(path, **changes):
    """The archive again with some arrays replaced, or left out where the change is None."""
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files} | changes
    np.savez(path.with_suffix(""), **{name: array for name, array in arrays.items() if array is not None})


def meta(**changes):
    facts = {"seconds": 1.0, "options": {}} | changes
    return np.frombuffer(json.dumps(facts).encode(), np.uint8)


TRAP = Path(tempfile.mkdtemp()) / "code-was-run"


class Evil:
    def __reduce__(self):
        return (TRAP.touch, ())


CHECKPOINTS = {
    "empty": lambda path: path.write_bytes(b""),
    "one byte": lambda path: path.write_bytes(b"P"),
    "cut to a tenth": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 10]),
    "cut to half": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "last byte gone": lambda path: path.write_bytes(path.read_bytes()[:-1]),
    "first byte gone": lambda path: path.write_bytes(path.read_bytes()[1:]),
    "text": lambda path: path.write_text("hello"),
    "zeros": lambda path: path.write_bytes(bytes(path.stat().st_size)),
    "one number": lambda path: np.save(path.open("wb"), np.ones(3)),
    "pickled object": lambda path: path.write_bytes(pickle.dumps(Evil())),
    "objects in the archive": lambda path: rewrite(path, **{"agent.agent.actor": np.array([Evil()], object)}),
    "no meta": lambda path: rewrite(path, meta=None),
    "meta that is no JSON": lambda path: rewrite(path, meta=np.frombuffer(b"{]", np.uint8)),
    "meta that is a list": lambda path: rewrite(path, meta=np.frombuffer(b"[]", np.uint8)),
    "meta without options": lambda path: rewrite(path, meta=np.frombuffer(b'{"seconds": 1}', np.uint8)),
    "options that are a list": lambda path: rewrite(path, meta=meta(options=[])),
    "negative seconds": lambda path: rewrite(path, meta=meta(seconds=-1)),
    "seconds that are text": lambda path: rewrite(path, meta=meta(seconds="1")),
    "array missing": lambda path: rewrite(path, **{"agent.agent.critic": None}),
    "array too many": lambda path: rewrite(path, more=np.ones(3)),
    "other shape": lambda path: rewrite(path, **{"agent.agent.actor": np.ones((2, 3), np.float32)}),
    "other type": lambda path: rewrite(path, episode=np.ones(2, np.float64)),
    "no lanes": lambda path: rewrite(path, episode=np.ones(0, np.int32)),
    "a scalar": lambda path: rewrite(path, episode=np.int32(3)),
    "more episodes than recorded": lambda path: rewrite(path, episode=np.full(2, 5000, np.int32)),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
}


@pytest.mark.parametrize("name", CHECKPOINTS)
def test_checkpoint(name, run, capsys, tmp_path):
    """With the newest one damaged the run goes on from the one before; with both, it says which file and stops."""
    older, newest = checkpoints.listed(run / "checkpoints")
    CHECKPOINTS[name](newest)
    if older.stat().st_size:
        shutil.copytree(run, tmp_path / "both")
    CHECKPOINTS[name](tmp_path / "both" / "checkpoints" / older.name)
    before = (tmp_path / "both" / "episodes.parquet").read_bytes()
    refused(
        capsys, 3, [newest.name if name != "more episodes than recorded" else "records"], "resume", tmp_path / "both"
    )
    assert (tmp_path / "both" / "episodes.parquet").read_bytes() == before
    status, said = outcome(capsys, "resume", run)
    assert status == 0
    assert "resumed from the checkpoint before" in said.err
    assert "Traceback" not in said.err
    assert not TRAP.exists()


def with_nulls(table):
    episode = table["episode"].to_pylist()
    return table.set_column(1, table.schema.field("episode"), [pa.array([None, *episode[1:]], pa.int32())])


def spoil_schema(path):
    pq.write_table(pa.table({"seed": [0], "episode": ["x"]}), path)


RECORDS = {
    "empty": lambda path: path.write_bytes(b""),
    "cut to half": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "last byte gone": lambda path: path.write_bytes(path.read_bytes()[:-1]),
    "text": lambda path: path.write_text("seed,episode\n0,0\n"),
    "other columns": spoil_schema,
    "one column gone": lambda path: pq.write_table(pq.read_table(path).drop_columns(["seed"]), path),
    "empty cells": lambda path: pq.write_table(with_nulls(pq.read_table(path)), path),
    "no rows": lambda path: pq.write_table(pq.read_table(path).slice(0, 0), path),
    "some rows gone": lambda path: pq.write_table(pq.read_table(path).slice(3), path),
    "gone": lambda path: path.unlink(),
}


@pytest.mark.parametrize("name", RECORDS)
def test_records(name, run, capsys):
    RECORDS[name](run / "episodes.parquet")
    refused(
        capsys, 3, ["records" if name in ("no rows", "some rows gone", "gone") else "episodes.parquet"], "resume", run
    )


def test_status_files_that_are_damaged_do_not_matter(run, capsys):
    for text in (b"\xff{", b'{"state": null, "episodes_done": "x"}', b"[" * 100_000, b'{"last_tenth": {"steps": []}}'):
        for name in ("status.json", "summary.json", "history.jsonl"):
            (run / name).write_bytes(text)
        status, said = outcome(capsys, "runs", run)
        assert status == 0
        assert "icac planar2" in said.out
    assert outcome(capsys, "resume", run, "--episodes", 61)[0] == 0


@pytest.mark.parametrize(
    "change", [{"live_nodes": []}, {"failed_seeds": {"9": 1}}, {"algo": "cacla"}, {"lane_steps": None}]
)
def test_a_summary_that_is_altered_is_written_anew(change, run, capsys):
    path, records = run / "summary.json", (run / "episodes.parquet").read_bytes()
    wanted = json.loads(path.read_text())
    path.write_text(json.dumps(wanted | change))
    assert outcome(capsys, "resume", run)[0] == 0
    now = json.loads(path.read_text())
    assert {name: now[name] for name in change} == {name: wanted[name] for name in change}
    assert (run / "episodes.parquet").read_bytes() == records
    assert "finished already" in outcome(capsys, "resume", run)[1].err


def test_a_history_of_another_kind_of_machine_is_compared_as_far_as_it_goes(run, capsys):
    facts = {"event": "started", "platform": {"devices": 3, "versions": [], "python": {"a": 10**400}}}
    (run / "history.jsonl").write_text(json.dumps(facts) + "\n")
    status, said = outcome(capsys, "resume", run, "--episodes", 61)
    assert status == 0
    warning = said.err.splitlines()[0]
    assert ("python {'a': 1000" in warning, "0 -> " in warning, len(warning) < 400) == (True, True, True)


@pytest.fixture(scope="module")
def fuzzed(whole):
    training = Training.of_run(folder.load(whole))
    return checkpoints.listed(whole / "checkpoints")[-1].read_bytes(), jax.device_get(training.start())


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.randoms(use_true_random=False), st.sampled_from(["flip", "cut", "swap", "insert"]))
def test_any_damage_to_a_checkpoint_is_seen_or_harmless(fuzzed, tmp_path, random, kind):
    original, template = fuzzed
    data = bytearray(original)
    at = random.randrange(len(data))
    if kind == "flip":
        data[at] ^= 1 << random.randrange(8)
    elif kind == "cut":
        del data[at : at + random.randrange(1, 2000)]
    elif kind == "insert":
        data[at:at] = bytes(random.randrange(256) for _ in range(random.randrange(1, 50)))
    else:
        other = random.randrange(len(data))
        data[at : at + 64], data[other : other + 64] = data[other : other + 64], data[at : at + 64]
    path = tmp_path / "checkpoint-00000001.npz"
    path.write_bytes(data)
    try:
        loaded = checkpoints.load(path, template, 2)
    except checkpoints.DamagedError as error:
        assert "\n" not in str(error)
        assert str(path) in str(error)
        return
    (tmp_path / "whole.npz").write_bytes(original)
    wanted = checkpoints.load(tmp_path / "whole.npz", template, 2)
    for mine, theirs in zip(jax.tree.leaves(loaded.lanes), jax.tree.leaves(wanted.lanes), strict=True):
        if checkpoints._is_key(mine):
            mine, theirs = jax.random.key_data(mine), jax.random.key_data(theirs)
        np.testing.assert_array_equal(mine, theirs)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.randoms(use_true_random=False))
def test_any_damage_to_a_configuration_is_one_line(whole, tmp_path, random):
    text = (whole / "config.toml").read_text()
    at = random.randrange(len(text))
    text = (
        text[:at]
        + random.choice(["", "x", "=", '"', "[", "-", "9", "\n", "é", "\x00"])
        + text[at + random.randrange(3) :]
    )
    (tmp_path / "config.toml").write_text(text)
    try:
        folder.load(tmp_path)
    except ConfigError as error:
        assert "\n" not in str(error)
        assert "config.toml" in str(error)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.randoms(use_true_random=False))
def test_any_damage_to_records_is_seen_or_harmless(whole, tmp_path, random):
    data = bytearray((whole / "episodes.parquet").read_bytes())
    at = random.randrange(len(data))
    if random.random() < 0.5:
        data[at] ^= 1 << random.randrange(8)
    else:
        del data[at : at + random.randrange(1, 500)]
    (tmp_path / store.EPISODES).write_bytes(data)
    try:
        table = store.Store(tmp_path).table(np.array([60, 60]))
    except checkpoints.DamagedError as error:
        assert "\n" not in str(error)
        return
    assert table.equals(pq.read_table(whole / "episodes.parquet"))


def test_nothing_that_is_read_can_run_code(tmp_path):
    """An archive of pickled objects is refused, not opened."""
    marker = tmp_path / "ran"

    class Trap:
        def __reduce__(self):
            return (marker.touch, ())

    buffer = io.BytesIO()
    np.savez(buffer, meta=np.array([Trap()], object))
    path = tmp_path / "checkpoint-00000001.npz"
    path.write_bytes(buffer.getvalue())
    template = Training.of_run(resolve(seeds=1, physics="kinematic", map_capacity=16)).start()
    with pytest.raises(checkpoints.DamagedError):
        checkpoints.load(path, template, 1)
    assert not marker.exists()


def test_a_run_without_its_checkpoints_is_not_started_anew(run, capsys):
    shutil.rmtree(run / "checkpoints")
    before = (run / "episodes.parquet").read_bytes()
    refused(capsys, 3, ["no checkpoint is left"], "resume", run)
    assert (run / "episodes.parquet").read_bytes() == before


@pytest.mark.parametrize(
    "name", ["lock", "log.txt", "history.jsonl", "records", "checkpoints/checkpoint-00000003.npz.partial"]
)
def test_links_in_a_strangers_folder_lead_nowhere(name, run, capsys, tmp_path):
    """A link planted in a run folder must not let `icac resume` write where it points."""
    treasure = tmp_path / "treasure"
    treasure.mkdir() if name == "records" else treasure.write_text("precious")
    if (run / name).exists():
        (run / name).unlink()
    (run / name).symlink_to(treasure)
    outcome(capsys, "resume", run, "--episodes", 61, "--checkpoint-every", 0)
    assert list(treasure.iterdir()) == [] if name == "records" else treasure.read_text() == "precious"
