"""A policy as a folder for a robot: the policy file, the program that reads it, and a card that says what it is."""

from pathlib import Path
from typing import Any

from icac_jax.console import shown
from icac_jax.envs.model import load_model
from icac_jax.policies import evaluate
from icac_jax.policies.saved import Learner
from icac_jax.reports.tables import markdown_code, markdown_text
from icac_jax.runs import stored_summary

POLICY, READER, CARD = "policy.npz", "policy_reader.py", "card.md"
_PACKAGE = Path(__file__).resolve().parents[1]
# In the package, or in a source checkout beside it.
_READERS = (_PACKAGE / "assets" / READER, _PACKAGE.parent / "docs" / READER)


def reader() -> str:
    """The text of the program that reads a policy file with NumPy alone."""
    return next(path for path in _READERS if path.is_file()).read_text("utf-8")


def control_period(learner: Learner) -> float:
    """Seconds from one action to the next, as in training."""
    return float(load_model(learner.settings.arm).opt.timestep) * learner.settings.run.sub_steps


def success(folder: Path, learner: Learner) -> str:
    """What is known of the policy's success, in a sentence."""
    found = evaluate.read(folder)
    if found is not None and found["episodes_trained"][learner.seed] == learner.episodes:
        rate, steps = (found["by_seed"][name][learner.seed] for name in ("success_rate", "steps"))
        if rate is not None and steps is not None:
            where = f"{found['pairs']:,} start and goal pairs without exploration, in simulation"
            return f"It reached {rate:.1%} of the goals, in {steps:.1f} steps on average, on {where}."
    summary = stored_summary.read(folder, learner.settings)
    part = {} if summary is None else summary["last_tenth_by_seed"].get(str(learner.seed), {})
    advice = "Not evaluated without exploration yet: `icac evaluate RUN`, then export again."
    if part.get("success_rate") is None:
        return advice
    return f"{advice} With exploration it reached {part['success_rate']:.1%} in the last tenth of training."


def card(folder: Path, learner: Learner, header: dict[str, Any]) -> str:
    """What somebody who puts the policy on a robot must know, as Markdown.

    Args:
      folder: of the run.
      learner: whose policy it is.
      header: of the policy file.
    """
    settings, space, action = learner.settings, header["observation"], header["action"]
    params, run = settings.params, settings.run
    limits = [
        f"| {markdown_text(name)} | {low:g} | {high:g} |"
        for name, low, high in zip(header["joints"], space["joint_low"], space["joint_high"], strict=True)
    ]
    base = ", ".join(f"{value:.3g}" for value in header["reach"]["base"])
    versions = ", ".join(f"{name} {version}" for name, version in header["versions"].items())
    lines = [
        f"# A policy of {markdown_text(settings.algo)} for {markdown_text(shown(settings.arm.name))}",
        "",
        "Reaches a goal with the tip of the arm: joint angles and a goal in, joint angles to go to out.",
        "",
        "```python",
        "from policy_reader import Policy  # NumPy is all that it needs",
        "",
        f'policy = Policy("{POLICY}")',
        "target = policy.move(joints, goal)  # once per control period",
        "```",
        "",
        "| | |",
        "|---|---|",
        f"| Task | {markdown_text(run.task)}: the tip within {params.goal_radius:g} m of the goal |",
        "| Joint angles | degrees, in the order below |",
        "| Goal | x, y, z in metres, in the world frame of the model |",
        f"| Control period | {control_period(learner):g} s ({run.sub_steps} physics steps), {run.physics} physics |",
        f"| Change per step | at most {action['bound']:g} degrees per joint; targets are clipped to the limits |",
        f"| Reach | {header['reach']['most']:.3g} m from ({base}), goal radius included; other goals are refused |",
        f"| Longest episode in training | {params.horizon} steps |",
        "",
        "| Joint | lowest, degrees | highest, degrees |",
        "|---|---|---|",
        *limits,
        "",
        "## Success",
        "",
        success(folder, learner),
        "",
        "It was trained in simulation alone. It knows nothing of obstacles, loads, delays and people: on a robot, keep",
        "the robot's own limits on speed and torque, and stop it when the arm does not follow.",
        "",
        "## Training",
        "",
        f"Learner {markdown_code(settings.algo)}, preset {markdown_code(run.preset)}, root seed {run.root_seed},",
        f"seed {learner.seed} of {run.seeds}, {learner.episodes:,} episodes; {versions}.",
        f"The header of `{POLICY}` has all of this as JSON; `config.toml` of the run repeats the training.",
        "",
    ]
    return "\n".join(lines)
