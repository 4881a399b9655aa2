"""`make bench`: what a lane-step costs, alone and in company, and how long a start takes. Medians of several chunks."""

import itertools
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax import rollout
from icac_jax.envs import arms, reach
from icac_jax.experiment import CHECKPOINT_EVERY, checkpoints, devices, settings
from icac_jax.experiment.training import Training
from tests.reference.physics import CReach
from tests.reference.slots import unflatten
from tests.reference.twin import Learner, Map

LANES = (1, 20, 320)
REPEATS = 7


def median_seconds(step, repeats=REPEATS):
    """Median time of `step()`, after one call that is not counted."""
    step()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        step()
        times.append(time.perf_counter() - started)
    return float(np.median(times))


def training_cost(arm, physics, algo, lanes):
    """Microseconds a lane-step of the whole training step."""
    training = Training.of_run(settings.resolve(arm=arm, physics=physics, algo=algo, seeds=lanes, episodes=10**9))
    length = max(20, min(400, 20_000 // lanes))
    state = training.start()
    args = training.on_lanes(training.first().slots)
    run = rollout.run_chunk.lower(
        training.settings.spec, training.env, state, *args, length=length, mesh=training.mesh
    ).compile()

    def step():
        nonlocal state
        state, _ = run(state, *args)
        jax.block_until_ready(state)

    for _ in range(3):
        step()
    return median_seconds(step) / length / lanes * 1e6


def physics_cost(arm, physics, lanes):
    """Microseconds a lane-step of the environment alone, fed with random actions and reset at random."""
    task = arms.get(arm)
    env = reach.make(task, physics)
    params = reach.default_params(task).traced()
    mesh = devices.lane_mesh(lanes)
    padded = -(-lanes // mesh.size) * mesh.size
    length = max(20, min(400, 20_000 // lanes))

    def chunk(state, seeds):
        def body(carry, time):
            state, rewards = carry
            keys = jax.vmap(lambda seed: jax.random.fold_in(jax.random.key(seed), time))(seeds)
            action = jax.vmap(lambda key: jax.random.uniform(key, (task.joints,), minval=-1.0))(keys)
            state, seen = jax.vmap(env.step, (0, 0, None))(state, action, params)
            return (state, rewards + seen.reward), None  # a reward not used would not be computed

        return jax.lax.scan(body, (state, jnp.zeros(len(seeds))), jnp.arange(length))[0]

    spread = jax.sharding.PartitionSpec("lane")
    run = jax.jit(jax.shard_map(chunk, mesh=mesh, in_specs=spread, out_specs=spread, check_vma=False))
    keys = jax.random.split(jax.random.key(0), padded)
    state = jax.device_put(jax.vmap(env.init, (0, None))(keys, params)[0], devices.over_lanes(mesh))
    seeds = jax.device_put(jnp.arange(padded), devices.over_lanes(mesh))

    def step():
        nonlocal state
        state, _ = jax.block_until_ready(run(state, seeds))

    return median_seconds(step) / length / lanes * 1e6


def twin_cost(arm, physics, steps=1500):
    """Microseconds a step of the plain NumPy learner with C MuJoCo on the same task, one process."""
    chosen = settings.resolve(arm=arm, physics=physics)
    task, rng = chosen.arm, np.random.default_rng(0)
    sizes = (task.observation_size, 12), (2 * task.joints, 12, task.joints)

    def net(layers, squash=False):
        count = sum((a + 1) * b for a, b in itertools.pairwise(layers))
        return unflatten(rng.uniform(-0.1, 0.1, count), layers, squash)

    world = CReach(task, chosen.run.sub_steps, chosen.params.reset_range, rng, physics)
    nodes = Map(rng.uniform(-1, 1, task.joints), rng.uniform(-1, 1, task.joints), 0.9, 1e-4)
    for node in nodes.nodes.values():
        node.predictor = net(sizes[1], True)
    learner = Learner(
        "icac",
        net((*sizes[0], task.joints)),
        net((*sizes[0], 1)),
        nodes,
        gamma=0.9,
        actor_rate=0.01,
        critic_rate=0.01,
        predictor_rate=0.01,
        beta=0.01,
        mu=40,
        lag=20,
    )

    def run():
        for _ in range(steps):
            action = np.clip(learner.actor(world.observe()) + 0.5 * rng.normal(size=task.joints), -1, 1)
            obs, reward, after = world.step(action)
            learner.learn(obs, action, reward, after, task.joints, lambda _: net(sizes[1], True))

    return median_seconds(run, 3) / steps * 1e6


def start_up(arm):
    """Seconds from the command to its end for a run of one episode, with a cold and with a warm compile cache."""
    command = [sys.executable, "-m", "icac_jax", "train", "--arm", arm, "--episodes", "1", "--json", "--out"]
    times = []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("cold", "warm"):
            started = time.perf_counter()
            environment = os.environ | {"XDG_CACHE_HOME": folder}
            subprocess.run([*command, f"{folder}/{name}"], check=True, capture_output=True, env=environment)
            times.append(time.perf_counter() - started)
    return times


def checkpoint_cost(arm):
    """Seconds that one save of 20 ICAC lanes takes: the state, flushed to the disk."""
    training = Training.of_run(settings.resolve(arm=arm))
    lanes = jax.block_until_ready(training.start())
    meta = {"seconds": 0.0, "options": training.settings.flat()}
    with tempfile.TemporaryDirectory(dir=".") as folder:
        return median_seconds(lambda: checkpoints.save(Path(folder) / "checkpoints", lanes, meta))


def row(*cells):
    print(
        "| " + " | ".join(f"{cell:.1f}" if isinstance(cell, float) else str(cell) for cell in cells) + " |", flush=True
    )


def main():
    """Prints the tables as Markdown."""
    devices.use_every_core()
    devices.use_compile_cache()
    print(f"jax {jax.__version__} on {jax.device_count()} x {jax.devices()[0].device_kind}\n")
    row("microseconds a lane-step", "physics", *(f"{lanes} lanes" for lanes in LANES))
    row(*["---"] * (2 + len(LANES)))
    for arm in arms.ARMS:
        for physics in ("servo", "kinematic"):
            row(f"{arm} physics alone", physics, *(physics_cost(arm, physics, lanes) for lanes in LANES))
            for algo in ("cacla", "cacla_var", "icac"):
                row(f"{arm} {algo}", physics, *(training_cost(arm, physics, algo, lanes) for lanes in LANES))
            row(f"{arm} icac, NumPy twin with C MuJoCo", physics, twin_cost(arm, physics), "", "")
    print()
    row("checkpoint of 20 icac lanes", "milliseconds", "share of the run time at the default interval, %")
    row(*["---"] * 3)
    for arm in arms.ARMS:
        seconds = checkpoint_cost(arm)
        row(arm, seconds * 1e3, f"{100 * seconds / CHECKPOINT_EVERY:.3f}")
    print()
    row("seconds for `icac train --episodes 1`", "cold cache", "warm cache")
    row(*["---"] * 3)
    for arm in arms.ARMS:
        row(arm, *start_up(arm))


if __name__ == "__main__":
    main()
