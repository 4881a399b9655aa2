"""`make bench`: what a lane-step costs beside physics alone and beside plain NumPy, against the goals.

Everything compared is compiled first and then run in turn, a short chunk each, round after round: a ratio of medians of
one run says more than any time of a busy machine. What needs other cores or no JAX runs in processes of its own that
wait for their turn. Results: `docs/benchmarks.md` and, for `make bench-check`, `docs/benchmarks.json`.
"""

import argparse
import contextlib
import dataclasses
import datetime
import importlib.metadata
import itertools
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax.envs import arms, reach
from icac_jax.runs import CHECKPOINT_EVERY, capacity, checkpoints, devices
from icac_jax.runs.loop import Training
from icac_jax.settings.options import resolve
from tests import operations
from tests.limit import build as limit
from tests.reference.learner import Learner, Map
from tests.reference.physics import CReach
from tests.reference.slots import unflatten

ROOT = Path(__file__).resolve().parents[1]
ROUNDS = 21
# Lane-steps of a chunk, and bounds of its steps: some tenths of a second at most.
LANE_STEPS, FEWEST, MOST = 20_000, 20, 400
# Seconds of chunks, and most of them, that one figure is of.
STEADY, MOST_CHUNKS = 0.1, 20
TWIN_STEPS = 1000
CORES_LANES = (20, 32, 640)
NICO = {"arm": "nico4", "algo": "icac"}
MANY = 20_000
REPLAY = {"arm": "planar2", "algo": "td3", "physics": "kinematic", "hindsight": "future"}


def steady(run):
    """Microseconds per lane-step over some chunks, a tenth of a second of them: the first finds the caches cold."""
    seconds = run() * run.length * run.lanes / 1e6
    number = int(np.clip(STEADY / seconds, 1, MOST_CHUNKS))
    return float(np.mean([run() for _ in range(number)]))


def length_of(lanes):
    """Steps of a measured chunk."""
    return max(FEWEST, min(MOST, LANE_STEPS // lanes))


@dataclasses.dataclass(frozen=True)
class Goal:
    """One figure that is to be reached.

    Attributes:
      name: G1 to G6.
      what: in words.
      sense: "at least" or "at most".
      target: the figure.
      value: what was measured, None where it was not.
    """

    name: str
    what: str
    sense: str
    target: float
    value: float | None

    @property
    def verdict(self):
        if self.value is None:
            return "not measured"
        good = self.value >= self.target if self.sense == "at least" else self.value <= self.target
        return "reached" if good else "not reached"

    def cells(self):
        value = "" if self.value is None else f"{self.value:.3g}"
        return self.name, self.what, f"{self.sense} {self.target:g}", value, self.verdict


class Learning:
    """The whole training step, as `icac train` runs it. Called, it runs a chunk and gives microseconds a lane-step."""

    def __init__(self, lanes, **options):
        training = Training.of_run(resolve(**options, seeds=lanes, episodes=10**9))
        # Of as many steps as in a run: lanes are copied into blocks and out of them once per chunk.
        self.lanes, self.length = lanes, training.length
        self.args = training.on_lanes(training.first().slots)
        state = training.start()
        self.slots = capacity.Capacity(training.agent, state, None)
        self.state = self.slots.cut(state)
        self.compiled = training.program.compiled(self.state, self.args)
        for _ in range(2):
            self()

    def __call__(self):
        started = time.perf_counter()
        kept = None if self.slots.is_whole else capacity.copied(self.state)
        self.state, _ = jax.block_until_ready(self.compiled(self.state, *self.args))
        assert kept is None or not self.slots.lacked(kept, self.state)  # a run would have more slots from here on
        return (time.perf_counter() - started) / self.length / self.lanes * 1e6


class Physics:
    """The environment alone, fed with random actions; called as above."""

    def __init__(self, lanes, arm, physics):
        task = arms.get(arm)
        env, params = reach.make(task, physics), reach.default_params(task).traced()
        mesh = devices.lane_mesh(lanes)
        padded = -(-lanes // mesh.size) * mesh.size
        self.lanes, self.length = lanes, length_of(lanes)

        def chunk(state, seeds):
            def body(carry, time):
                state, rewards = carry
                # A few operations instead of a generator: the bench is of the physics.
                phase = time + seeds[:, None] * 0.7 + jnp.arange(task.joints)
                state, seen = jax.vmap(env.step, (0, 0, None))(state, jnp.sin(phase), params)
                return (state, rewards + seen.reward), None  # a reward not used would not be computed

            return jax.lax.scan(body, (state, jnp.zeros(len(seeds))), jnp.arange(self.length))[0]

        spread = jax.sharding.PartitionSpec("lane")
        whole = jax.jit(jax.shard_map(chunk, mesh=mesh, in_specs=spread, out_specs=spread, check_vma=False))
        state = jax.vmap(env.init, (0, None))(jax.random.split(jax.random.key(0), padded), params)[0]
        self.state = jax.device_put(state, devices.over_lanes(mesh))
        self.seeds = jax.device_put(jnp.arange(padded), devices.over_lanes(mesh))
        self.compiled = whole.lower(self.state, self.seeds).compile()
        for _ in range(2):
            self()

    def __call__(self):
        started = time.perf_counter()
        self.state, _ = jax.block_until_ready(self.compiled(self.state, self.seeds))
        return (time.perf_counter() - started) / self.length / self.lanes * 1e6


class Twin:
    """The plain NumPy learner with C MuJoCo on the same task, one lane; called as above."""

    def __init__(self, arm, physics):
        chosen = resolve(arm=arm, physics=physics)
        self.lanes, self.length = 1, TWIN_STEPS
        self.task, self.rng = chosen.arm, np.random.default_rng(0)
        task, rng, hyper = self.task, self.rng, chosen.hyper
        sizes = (task.observation_size, 12), (2 * task.joints, 12, task.joints)

        def net(layers, squash=False):
            count = sum((a + 1) * b for a, b in itertools.pairwise(layers))
            return unflatten(rng.uniform(-0.1, 0.1, count), layers, squash)

        self.new_predictor = lambda _: net(sizes[1], True)
        self.world = CReach(task, chosen.run.sub_steps, chosen.params.reset_range, rng, physics)
        start = (rng.uniform(-1, 1, task.joints) for _ in range(2))
        nodes = Map(*start, hyper.e_max, hyper.map_rate)
        for node in nodes.nodes.values():
            node.predictor = net(sizes[1], True)
        self.learner = Learner(
            "icac",
            net((*sizes[0], task.joints)),
            net((*sizes[0], 1)),
            nodes,
            gamma=hyper.gamma,
            actor_rate=hyper.actor_rate,
            critic_rate=hyper.critic_rate,
            predictor_rate=hyper.predictor_rate,
            beta=hyper.beta,
            mu=hyper.mu,
            lag=hyper.T,
        )

    def __call__(self):
        started = time.perf_counter()
        for _ in range(TWIN_STEPS):
            noise = 0.5 * self.rng.normal(size=self.task.joints)
            action = np.clip(self.learner.actor(self.world.observe()) + noise, -1, 1)
            obs, reward, after = self.world.step(action)
            self.learner.learn(obs, action, reward, after, self.task.joints, self.new_predictor)
        return (time.perf_counter() - started) / TWIN_STEPS * 1e6


class Process:
    """Measurements in a process of their own, pinned to one core or not, that waits for its turn."""

    def __init__(self, *what):
        command = [sys.executable, "-m", "tests.bench", "--worker", *what]
        self.process = subprocess.Popen(command, cwd=ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.answer()

    def ask(self):
        self.process.stdin.write("go\n")
        self.process.stdin.flush()

    def answer(self):
        return json.loads(self.process.stdout.readline())

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def worker(what):
    """Serves a `Process`: a round for each line of standard input, times as JSON for each answer."""
    if what[0] == "reference":
        runners = {physics: Twin("nico4", physics) for physics in ("servo", "kinematic")}
    elif what[0] == "replay":  # a command that trains such learners alone has loops unrolled
        os.environ.pop("XLA_FLAGS", None)
        devices.use_every_core()
        devices.use_compile_cache()
        runners = {"planar2 kinematic, td3 with hindsight, 20 lanes": Learning(20, **REPLAY)}
    else:
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        devices.use_every_core()
        devices.keep_loops()
        devices.use_compile_cache()
        runners = {str(lanes): Learning(lanes, **NICO) for lanes in CORES_LANES}
    print(json.dumps("ready"), flush=True)
    for _ in sys.stdin:
        print(json.dumps({name: steady(run) for name, run in runners.items()}), flush=True)


def start_up(arm, starts=3):
    """Seconds from the command to its first finished chunk: with an empty cache, and the median of later starts."""
    times = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(1 + starts):
            command = [sys.executable, "-m", "icac_jax", "train", "--arm", arm, "--episodes", "1", "--json"]
            started = time.perf_counter()
            run = subprocess.Popen(
                [*command, "--out", f"{folder}/{number}"],
                cwd=ROOT,
                env=os.environ | {"XDG_CACHE_HOME": folder},
                text=True,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
            )
            # The line of progress after the one that says "compiling" is printed when a chunk has finished.
            next(line for line in run.stderr if " of " in line)
            times.append(time.perf_counter() - started)
            run.communicate()
    return times[0], float(np.median(times[1:]))


def checkpoint_cost(arm):
    """Seconds that one save of 20 ICAC lanes takes: the state, flushed to the disk."""
    training = Training.of_run(resolve(arm=arm))
    lanes = jax.block_until_ready(training.start())
    meta = {"seconds": 0.0, "options": training.settings.flat()}
    times = []
    with tempfile.TemporaryDirectory(dir=".") as folder:
        for _ in range(5):
            started = time.perf_counter()
            checkpoints.save(Path(folder) / "checkpoints", lanes, meta)
            times.append(time.perf_counter() - started)
    return float(np.median(times))


def measured_costs(rounds):
    """Medians of microseconds a lane-step by name, and instructions of the compiled chunks by name."""
    processes = {"one core": Process("one-core")}
    references = [Process("reference") for _ in range(2)]
    replay = Process("replay")
    runners = {}
    for arm in arms.ARMS:
        for physics in ("servo", "kinematic"):
            for lanes in (20, 640):
                runners[f"{arm} {physics}, physics alone, {lanes} lanes"] = Physics(lanes, arm, physics)
                runners[f"{arm} {physics}, icac, {lanes} lanes"] = Learning(lanes, arm=arm, physics=physics)
    for algo, lanes in itertools.product(("cacla", "cacla_var"), (20, 640)):
        runners[f"nico4 servo, {algo}, {lanes} lanes"] = Learning(lanes, arm="nico4", algo=algo)
    for lanes in (1, 32, MANY):
        runners[f"nico4 servo, icac, {lanes} lanes"] = Learning(lanes, **NICO)
    for nodes in (64, 1024):
        runners[f"nico4 servo, icac, 20 lanes, map capacity {nodes}"] = Learning(20, **NICO, map_capacity=nodes)
    if limit.compiler() is None:
        say("no C compiler, so no yardstick")
    else:
        for physics, lanes in itertools.product(("servo", "kinematic"), (20, 640)):
            runners[_by_hand(physics, lanes)] = limit.ByHand(lanes, physics == "servo", length_of(lanes))
    say(f"{len(runners)} programs compiled")

    times = {name: [] for name in runners}
    for _ in range(rounds):
        for name, run in runners.items():
            times[name].append(steady(run))
        for name, process in processes.items():
            process.ask()
            for lanes, cost in process.answer().items():
                times.setdefault(f"nico4 servo, icac, {lanes} lanes, {name}", []).append(cost)
        replay.ask()
        for name, cost in replay.answer().items():
            times.setdefault(name, []).append(cost)
        for reference in references:
            reference.ask()
        for physics, cost in pairs(*(reference.answer() for reference in references)):
            # Two at a time: a lane-step of either costs half.
            times.setdefault(f"nico4 {physics}, NumPy reference with C MuJoCo, 2 processes", []).append(cost)
    by_hand = [run for run in runners.values() if isinstance(run, limit.ByHand)]
    for process in (*processes.values(), *references, replay, *by_hand):
        process.close()
    counts = {
        name: operations.started(run) / run.length
        for name, run in runners.items()
        if name.startswith("nico4") and name.endswith(", 20 lanes") and run not in by_hand
    }
    return {name: float(np.median(values)) for name, values in times.items()}, counts


def _by_hand(physics, lanes):
    """What the hand-written step is called among the costs."""
    return f"nico4 {physics}, by hand in C, {lanes} lanes"


def pairs(first, second):
    """What two processes at work together cost a lane-step, by name."""
    return [(name, 1 / (1 / first[name] + 1 / second[name])) for name in first]


def goals(costs, starts, reproduce_seconds):
    """The goals beside what was measured."""

    def ratio(above, below):
        return costs[above] / costs[below]

    rows = []
    for lanes, servo, kinematic in ((20, 40, 50), (640, 40, 60)):
        for physics, target in (("servo", servo), ("kinematic", kinematic)):
            value = ratio(
                f"nico4 {physics}, NumPy reference with C MuJoCo, 2 processes", f"nico4 {physics}, icac, {lanes} lanes"
            )
            rows.append(Goal("G1", f"icac against the reference, {physics}, {lanes} lanes", "at least", target, value))
    for lanes, target in ((20, 5), (640, 4)):
        for physics in ("servo", "kinematic"):
            by_hand = _by_hand(physics, lanes)
            value = ratio(f"nico4 {physics}, icac, {lanes} lanes", by_hand) if by_hand in costs else None
            rows.append(Goal("G2", f"icac / by hand in C, {physics}, {lanes} lanes", "at most", target, value))
    for lanes, target in zip(CORES_LANES, (1.5, 1.8, 1.8), strict=True):
        value = ratio(f"nico4 servo, icac, {lanes} lanes, one core", f"nico4 servo, icac, {lanes} lanes")
        rows.append(Goal("G3", f"two cores against one, {lanes} lanes", "at least", target, value))
    base = "nico4 servo, icac, 20 lanes"
    small, large = (f"{base}, map capacity {nodes}" for nodes in (64, 1024))
    rows.append(Goal("G4", "map capacity 1,024 / 64, 20 lanes", "at most", 1.2, ratio(large, small)))
    rows.append(
        Goal("G4", "20,000 / 20 lanes, a lane-step", "at most", 1.2, ratio(f"nico4 servo, icac, {MANY} lanes", base))
    )
    rows += [
        Goal("G5", f"{arm}: seconds to the first finished chunk, second start", "at most", 5, warm)
        for arm, (_, warm) in starts.items()
    ]
    return [*rows, Goal("G6", "`make reproduce`, seconds", "at most", 100, reproduce_seconds)]


def facts():
    """Machine, versions, commit, date."""

    def git(*args):
        with contextlib.suppress(OSError):
            done = subprocess.run(["git", *args], cwd=ROOT, capture_output=True, text=True, check=False)
            return done.stdout.strip()
        return ""

    cpu = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), cpu)
    versions = {name: importlib.metadata.version(name) for name in ("jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy")}
    changed = " with changes" if git("status", "--porcelain", "--untracked-files=no") else ""
    return {
        "machine": {"cpu": cpu, "cores": len(os.sched_getaffinity(0)), "device": jax.devices()[0].device_kind},
        "versions": {"python": platform.python_version()} | versions,
        "commit": (git("rev-parse", "--short", "HEAD") or "unknown") + changed,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "load": round(os.getloadavg()[0], 2),
    }


def table(rows, head=("goal", "what", "target", "measured", "")):
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def page(about, judged, costs, counts, starts, saves):
    """`docs/benchmarks.md`."""
    machine = about["machine"]
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    parts = [
        "# Benchmarks",
        "Written by `make bench`. Medians of chunks that were run in turn, so that ratios hold where times may not:\n"
        "the absolute numbers are this machine's, on this day. What stands in the way of a goal is in the\n"
        "[performance log](performance.md).",
        f"{machine['cpu']}, {machine['cores']} cores, {machine['device']} device, load {about['load']} at the end; "
        f"{versions};\ncommit {about['commit']}, {about['date']}.",
        "## Goals",
        "Of nico4, icac, servo physics and 20 lanes on all cores where a row does not say otherwise. By hand in C is\n"
        "the whole step as `tests/limit` has it, with vectors and threads: what the processor allows. Physics alone\n"
        "is the environment's step without a learner, random numbers and the starts of episodes.",
        table([goal.cells() for goal in judged]),
        "## Microseconds a lane-step",
        table([(name, f"{cost:.3g}") for name, cost in costs.items()], ("", "microseconds")),
        "## Operations that are started by themselves, nico4, 20 lanes",
        "Per step, on all cores together, from XLA's own trace of a chunk.",
        table([(name, f"{count:.3g}") for name, count in counts.items()], ("", "operations per step")),
        "## Starting and saving",
        "Seconds from `icac train --episodes 1` to its first finished chunk; one checkpoint of 20 icac lanes.",
        table(
            [
                (arm, f"{cold:.1f}", f"{warm:.1f}", f"{saves[arm] * 1e3:.1f}", f"{saves[arm] / CHECKPOINT_EVERY:.2%}")
                for arm, (cold, warm) in starts.items()
            ],
            ("arm", "first start", "second start", "checkpoint, ms", "of the run at the default interval"),
        ),
    ]
    return "\n\n".join(parts) + "\n"


def measurements(costs, counts, starts, saves, judged):
    """All figures by name, as `bench_check` compares them."""

    def entry(value, unit, better="less"):
        return {"value": value, "unit": unit, "better": better}

    found = {name: entry(cost, "microseconds a lane-step") for name, cost in costs.items()}
    found |= {f"operations, {name}": entry(count, "operations per step") for name, count in counts.items()}
    for arm, (cold, warm) in starts.items():
        found[f"{arm}, first start"] = entry(cold, "s")
        found[f"{arm}, second start"] = entry(warm, "s")
        found[f"{arm}, checkpoint"] = entry(saves[arm] * 1e3, "ms")
    for goal in judged:
        if goal.value is not None and goal.name not in ("G5", "G6"):
            better = "more" if goal.sense == "at least" else "less"
            found[f"{goal.name}: {goal.what}"] = entry(goal.value, "x", better)
    return found


def say(line):
    """Progress on standard error, with the time since the start."""
    print(f"{time.perf_counter() - _BEGUN:5.0f} s  {line}", file=sys.stderr, flush=True)


_BEGUN = time.perf_counter()


def main():
    """Measures, writes both files, prints the page."""
    parser = argparse.ArgumentParser(prog="bench", description=__doc__)
    parser.add_argument("--worker", nargs="+", help=argparse.SUPPRESS)
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="chunks of each program (%(default)s)")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder for benchmarks.md and .json")
    parser.add_argument("--times", type=Path, help="times.json of a finished `make reproduce`, for G6")
    given = parser.parse_args()
    if given.worker:
        worker(given.worker)
        return
    devices.use_every_core()
    devices.keep_loops()
    devices.use_compile_cache()
    seconds = sum(json.loads(given.times.read_text()).values()) if given.times else None
    costs, counts = measured_costs(given.rounds)
    say("chunks measured")
    starts = {arm: start_up(arm) for arm in arms.ARMS}
    saves = {arm: checkpoint_cost(arm) for arm in arms.ARMS}
    judged = goals(costs, starts, seconds)
    about = facts()
    text = page(about, judged, costs, counts, starts, saves)
    figures = {
        "measurements": measurements(costs, counts, starts, saves, judged),
        "operations": counts,
        "goals": [dataclasses.asdict(goal) | {"verdict": goal.verdict} for goal in judged],
    }
    (given.out / "benchmarks.json").write_text(json.dumps(about | figures, indent=1) + "\n")
    (given.out / "benchmarks.md").write_text(text)
    say("written")
    print(text)


if __name__ == "__main__":
    main()
