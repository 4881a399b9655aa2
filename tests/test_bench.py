"""The comparison of two benchmarks, the count of operations, and that a step does not quietly come to need more."""

import copy
import json

import jax
import numpy as np
import pytest

from icac_jax import rollout
from icac_jax.fast import compiling
from icac_jax.runs.loop import Training
from icac_jax.settings import options
from tests import bench, bench_check, operations

OLD = {
    "machine": {"device": "cpu", "cores": 2, "cpu": "a processor"},
    "measurements": {
        "nico4 servo icac, 20 lanes": {"value": 4.0, "unit": "microseconds a lane-step", "better": "less"},
        "G3, 64 lanes": {"value": 1.8, "unit": "x", "better": "more"},
        "fusions": {"value": 100, "unit": "operations", "better": "less"},
    },
}


def compared(tmp_path, capsys, changes, *options, **machine):
    new = copy.deepcopy(OLD)
    new["machine"] |= machine
    for name, value in changes.items():
        new["measurements"].setdefault(name, {"unit": "x", "better": "less"})["value"] = value
    for name, content in (("old", OLD), ("new", new)):
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    status = bench_check.main([str(tmp_path / "old.json"), str(tmp_path / "new.json"), *options])
    return status, capsys.readouterr().out


def test_what_became_slower_is_named(tmp_path, capsys):
    changes = {"nico4 servo icac, 20 lanes": 6.0, "G3, 64 lanes": 0.9, "fusions": 101}
    status, said = compared(tmp_path, capsys, changes)
    assert status == 1
    assert said.splitlines() == [
        "2.00 x worse: G3, 64 lanes, 1.8 to 0.9 x",
        "1.50 x worse: nico4 servo icac, 20 lanes, 4 to 6 microseconds a lane-step",
        "2 of 3 measurements worse by more than 1.25",
    ]
    assert compared(tmp_path, capsys, changes, "--factor", "3")[0] == 0


def test_faster_and_equal_is_no_complaint(tmp_path, capsys):
    changes = {"nico4 servo icac, 20 lanes": 2.0, "G3, 64 lanes": 3.0}
    assert compared(tmp_path, capsys, changes) == (0, "0 of 3 measurements worse by more than 1.25\n")


def test_other_machines_and_measurements_are_said(tmp_path, capsys):
    status, said = compared(tmp_path, capsys, {"a new one": 1.0}, cores=8)
    assert status == 0
    assert "another machine (cores): 2 then, 8 now" in said
    assert "only now: a new one" in said


def test_goals_are_judged_and_written_as_a_table():
    reached = bench.Goal("G1", "twenty seeds", "at least", 10.0, 12.5)
    missed = bench.Goal("G2", "training / physics", "at most", 1.25, 2.0)
    unknown = bench.Goal("G6", "make reproduce, minutes", "at most", 25.0, None)
    assert [goal.verdict for goal in (reached, missed, unknown)] == ["reached", "not reached", "not measured"]
    assert bench.table([reached.cells()]).splitlines()[-1] == "| G1 | twenty seeds | at least 10 | 12.5 | reached |"


def test_operations_inside_a_fusion_are_not_counted():
    text = """\
%fused_computation (p: f32[2]) -> f32[2] {
  %p = f32[2]{0} parameter(0)
  ROOT %copy.1 = f32[2]{0} copy(%p)
}

ENTRY %main (a: f32[2]) -> f32[2] {
  %a = f32[2]{0} parameter(0)
  %fusion = f32[2]{0} fusion(%a), kind=kLoop, calls=%fused_computation
  ROOT %copy.2 = f32[2]{0} copy(%fusion)
}
"""
    found = operations.counts(text)
    assert (found["fusion"], found["copy"], found["dot"]) == (1, 1, 0)


# Of version 0.1.0, before learners went behind a seam: the chunk of 20 lanes on one device, kinematic physics.
OPERATIONS = {
    ("planar2", "cacla"): 106,
    ("planar2", "cacla_var"): 108,
    ("planar2", "icac"): 181,
    ("nico4", "cacla"): 101,
    ("nico4", "cacla_var"): 103,
    ("nico4", "icac"): 182,
}


@pytest.mark.parametrize(("arm", "algo"), OPERATIONS, ids="-".join)
def test_a_step_needs_no_more_operations_than_it_did(arm, algo):
    """At few lanes starting operations is what a step costs. Whoever adds some should know."""
    one_device = jax.sharding.Mesh(np.array(jax.local_devices()[:1]), ("lane",))
    settings = options.resolve(arm=arm, physics="kinematic", algo=algo, seeds=20, episodes=1)
    training = Training.of_run(settings, one_device)
    args = training.on_lanes(training.first().slots)
    compiled = rollout.run_chunk.lower(
        training.agent, training.env, training.start(), *args, length=training.length, mesh=training.mesh
    ).compile()
    found = operations.counts(compiled.as_text())
    assert found["dot"] == 0, found  # a library call a lane and product, unless written out
    assert 20 < sum(found.values()) <= OPERATIONS[arm, algo], found


def test_no_operation_is_split_over_threads_where_each_core_has_a_device():
    """A split waits for a thread that another device keeps busy."""
    training = Training.of_run(options.resolve(arm="nico4", physics="kinematic", algo="icac", seeds=20, episodes=1))
    args = training.on_lanes(training.first().slots)
    lowered = rollout.run_chunk.lower(
        training.agent, training.env, training.start(), *args, length=training.length, mesh=training.mesh
    )
    assert "outer_dimension_partitions" not in compiling.compiled(lowered, compiling.APART).as_text()


def test_an_option_that_the_compiler_does_not_know_is_left_out():
    doubled = compiling.compiled(jax.jit(lambda x: 2 * x).lower(1.0), {"xla_no_such_option": True})
    assert float(doubled(2.0)) == 4.0
