"""The hand-written step: compiled from the package's own settings and arithmetic, and run; see `step.c`."""

import json
import math
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from icac_jax.envs import physics
from icac_jax.envs.arms import ArmSpec
from icac_jax.fast import scalars
from icac_jax.fast.arithmetic import Arithmetic
from icac_jax.settings.options import Settings, resolve

HERE = Path(__file__).resolve().parent
# Sums may change their order here, which those of the package may not.
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fno-trapping-math", "-std=gnu11", "-pthread", "-Wall", "-Wno-psabi")
_OPERATORS = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
_FUNCTIONS = {"sin": "row_sin", "cos": "row_cos", "sqrt": "row_sqrt"}


def compiler() -> str | None:
    """The C compiler of this machine, if it has one that knows vectors."""
    return shutil.which("gcc") or shutil.which("clang")


def settings_of(servo: bool) -> Settings:
    """What is trained: ICAC with the preset `paper` on NICO's arm."""
    return resolve(arm="nico4", algo="icac", physics="servo" if servo else "kinematic")


def build(folder: Path, servo: bool, capacity: int) -> Path:
    """Compiles the step for NICO's arm.

    Args:
      folder: for what is written.
      servo: with the servos' physics.
      capacity: of the map, a multiple of 32.

    Returns:
      The program.
    """
    settings = settings_of(servo)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "task.h").write_text(_task(settings, servo, capacity))
    (folder / "arm.h").write_text(_arm(settings.arm))
    program = folder / "step"
    command = [compiler() or "gcc", *FLAGS, f"-I{folder}", f"-I{HERE}", str(HERE / "step.c"), "-o", str(program), "-lm"]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return program


class ByHand:
    """A running program. Called, it runs a chunk of each lane and gives microseconds per lane-step.

    Args:
      lanes: how many learners.
      servo: with the servos' physics.
      length: steps of a chunk.
      warm: steps before the first chunk.
      capacity: of the map.

    Attributes:
      statistics: of the last tenth of the first steps: `updates` of the actor per step, the share `updated` of steps
        with any, `nodes`, the share `ended` of steps that end an episode, and the share `reached` of episodes.
    """

    def __init__(self, lanes: int, servo: bool, length: int, warm: int = 2000, capacity: int = 128) -> None:
        self.lanes, self.length = lanes, length
        with tempfile.TemporaryDirectory() as folder:
            program = build(Path(folder), servo, capacity)
            threads = min(len(os.sched_getaffinity(0)), lanes)
            self.process = subprocess.Popen(
                [str(program), *map(str, (lanes, warm, threads, length))],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            self.statistics = json.loads(self._answer())

    def _answer(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def __call__(self) -> float:
        """Runs a chunk."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return float(self._answer()) / 1e3 / self.length / self.lanes

    def close(self) -> None:
        """Ends the program."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()


def _task(settings: Settings, servo: bool, capacity: int) -> str:
    """The settings as C."""
    hyper, params, arm = settings.hyper, settings.params, settings.arm
    whole = {
        "JOINTS": arm.joints,
        "SENSED": arm.joints,
        "OBSERVED": arm.joints + len(arm.goal_axes),
        "UNITS": settings.spec.hidden_units,
        "CAPACITY": capacity,
        "MU": hyper.mu,
        "LAG": hyper.T,
        "MOST_UPDATES": hyper.max_actor_updates,
        "HORIZON": params.horizon,
        "SUB_STEPS": settings.run.sub_steps,
    }
    single = {
        "SIGMA": hyper.sigma,
        "GAMMA": hyper.gamma,
        "BETA": hyper.beta,
        "ACTOR_RATE": hyper.actor_rate,
        "CRITIC_RATE": hyper.critic_rate,
        "PREDICTOR_RATE": hyper.predictor_rate,
        "WEIGHT_SCALE": hyper.weight_scale,
        "MAP_RATE": hyper.map_rate,
        "E_MAX": hyper.e_max,
        "RESET_RANGE": params.reset_range,
        "GOAL_RADIUS": params.goal_radius,
        "GOAL_REWARD": params.goal_reward,
        "ACTION_BOUND": math.radians(params.action_bound),
    }
    lines = ["#pragma once", '#include "rows.h"', f"#define SERVO {int(servo)}"]
    lines.append(f"enum {{ {', '.join(f'{name} = {value}' for name, value in whole.items())} }};")
    lines += [f"static const float {name} = {float(value)!r}f;" for name, value in single.items()]
    for name, values in (
        ("LOW", np.radians(params.joint_low)),
        ("HIGH", np.radians(params.joint_high)),
        ("GOAL_LOW", arm.goal_low),
        ("GOAL_HIGH", arm.goal_high),
    ):
        entries = ", ".join(f"{float(value)!r}f" for value in values)
        lines.append(f"static const float {name}[{len(values)}] = {{{entries}}};")
    return "\n".join(lines) + "\n"


def _arm(arm: ArmSpec) -> str:
    """The arm's forward kinematics and its physics step as C, from the arithmetic that the package runs."""
    found: list[Arithmetic] = []

    def traced(*arguments: object) -> Arithmetic:
        found.append(unrolled(*arguments))
        return found[-1]

    unrolled = scalars.unrolled
    scalars.unrolled = traced
    try:
        physics.tip_function.__wrapped__(arm, cache=None)
        physics.step_function.__wrapped__(arm, cache=None)
    finally:
        scalars.unrolled = unrolled
    tip, step = found
    return f'#pragma once\n#include "rows.h"\n{_as_c("tip_of", tip)}{_as_c("physics_step", step)}'


def _as_c(name: str, arithmetic: Arithmetic) -> str:
    """A function of rows: a line per operation."""
    known = sum(math.prod(shape) for shape in arithmetic.shapes)

    def operand(of: object) -> str:
        return f"v{of}" if isinstance(of, int) else f"row_of({float(of)!r}f)"  # pyright: ignore[reportArgumentType]

    lines = [f"static inline void {name}(const Row *in, Row *out) {{"]
    lines += [f"  Row v{place} = in[{place}];" for place in range(known)]
    for place, (kind, _, operands) in enumerate(arithmetic.operations, known):
        parts = [operand(of) for of in operands]
        text = f" {_OPERATORS[kind]} ".join(parts) if kind in _OPERATORS else f"{_FUNCTIONS[kind]}({parts[0]})"
        lines.append(f"  Row v{place} = {text};")
    entries = [entry for _, entries in arithmetic.results for entry in entries]
    lines += [f"  out[{place}] = {operand(entry)};" for place, entry in enumerate(entries)]
    return "\n".join([*lines, "}"]) + "\n"
