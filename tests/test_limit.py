"""The yardstick of the bench does what the package does: the same statistics after as many steps."""

import numpy as np
import pytest

from icac_jax import rollout
from icac_jax.runs.loop import Training
from icac_jax.settings.options import resolve
from tests.limit import build

pytestmark = pytest.mark.skipif(build.compiler() is None, reason="needs a C compiler")
LANES, STEPS = 64, 10_000


@pytest.mark.slow
@pytest.mark.parametrize("servo", [False, True])
def test_the_step_by_hand_is_that_of_the_package(servo):
    options = {"arm": "nico4", "algo": "icac", "physics": "servo" if servo else "kinematic"}
    training = Training.of_run(resolve(**options, seeds=LANES, episodes=10**9))
    lanes, log = training.start(), None
    args = training.on_lanes(training.first().slots)
    for _ in range(10):
        lanes, log = rollout.run_chunk(
            training.agent, training.env, lanes, *args, length=STEPS // 10, mesh=training.mesh
        )
    done = np.asarray(log.done)
    ours = {
        "nodes": float(np.asarray(log.last["live_nodes"])[done].mean()),
        "ended": float(done.mean()),
        "reached": float(np.asarray(log.reached)[done].mean()),
    }
    by_hand = build.ByHand(LANES, servo, 100, STEPS)
    by_hand.close()
    theirs = by_hand.statistics
    assert theirs["nodes"] == pytest.approx(ours["nodes"], rel=0.1)
    assert theirs["ended"] == pytest.approx(ours["ended"], rel=0.1)
    assert theirs["reached"] == pytest.approx(ours["reached"], abs=0.05)
    assert 0.1 < theirs["updated"] <= theirs["updates"] < 1
