"""Stable-Baselines3: SAC or TD3 with hindsight experience replay on a goal-conditioned arm.

Writes OUT/sb3_her.csv (a row per evaluation) and OUT/sb3_her.png (success over steps and over training time).
"""

import argparse
import csv
import time
from pathlib import Path

import gymnasium
import matplotlib
import numpy as np
import torch
from stable_baselines3 import SAC, TD3, HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise

import icac_jax.envs.gymnasium  # noqa: F401  (registers the environments)

matplotlib.use("Agg")
import matplotlib.pyplot as plt

ENVIRONMENTS = {"planar2": "icac_jax/Planar2ReachGoal-v0", "nico4": "icac_jax/Nico4ReachGoal-v0"}
# Time is that of training alone: by the clock, and of the processor (the two differ where a machine is shared).
COLUMNS = ("seed", "steps", "seconds", "processor_seconds", "success", "mean_steps")


class Evaluation(BaseCallback):
    """Success of the policy without exploration, on the same starts and goals each time; its time is not counted."""

    def __init__(self, world: gymnasium.Env, seed: int, every: int, episodes: int, until: float | None) -> None:
        super().__init__()
        self.seed, self.every, self.episodes, self.until = seed, every, episodes, until
        self.world = world
        self.rows, self.spent = [], np.zeros(2)

    def _on_training_start(self) -> None:
        self.evaluate()

    def _on_step(self) -> bool:
        if self.num_timesteps % self.every == 0:
            self.spent += np.array([time.perf_counter(), time.process_time()]) - self.since
            self.evaluate()
            return self.until is None or self.rows[-1][COLUMNS.index("success")] < self.until
        return True

    def evaluate(self) -> None:
        """Adds a row."""
        reached, lengths = 0, []
        for episode in range(self.episodes):
            observation, info = self.world.reset(seed=1_000_000 + episode)
            terminated = truncated = False
            while not (terminated or truncated):
                action, _ = self.model.predict(observation, deterministic=True)
                observation, _, terminated, truncated, info = self.world.step(action)
            reached += terminated
            lengths.append(info["steps"])
        row = (self.seed, self.num_timesteps, *self.spent.round(2), reached / self.episodes, np.mean(lengths).round(2))
        self.rows.append(row)
        print(*(f"{name} {value:g}" for name, value in zip(COLUMNS, row, strict=True)), sep="  ", flush=True)
        self.since = np.array([time.perf_counter(), time.process_time()])


def train(algo: str, task: dict, seed: int, steps: int, every: int, episodes: int, until: float | None) -> list[tuple]:
    """The rows of one seed; `task` is the environment's name with its options."""
    world = gymnasium.make(**task)
    joints = world.action_space.shape
    noise = NormalActionNoise(np.zeros(joints), np.full(joints, 0.2))
    agent = {"sac": SAC, "td3": TD3}[algo](
        "MultiInputPolicy",
        world,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        policy_kwargs={"net_arch": [64, 64]},
        gamma=0.95,
        learning_rate=1e-3,
        learning_starts=1000,
        action_noise=noise if algo == "td3" else None,
        seed=seed,
        device="cpu",
    )
    evaluation = Evaluation(gymnasium.make(**task), seed, every, episodes, until)
    agent.learn(steps, callback=evaluation)
    return evaluation.rows


def draw(table: np.ndarray, title: str, file: Path) -> None:
    """Draws the rows: thin lines are seeds, the thick line their mean."""
    seeds = [table[table[:, 0] == seed] for seed in np.unique(table[:, 0])]
    mean = np.mean(seeds, axis=0)
    figure, panels = plt.subplots(1, 2, figsize=(8, 3), sharey=True, layout="constrained")
    for panel, column, label in ((panels[0], 1, "environment steps"), (panels[1], 3, "processor seconds of training")):
        for one in seeds:
            panel.plot(one[:, column], 100 * one[:, 4], color="#7fb3d5", linewidth=0.9)
        panel.plot(mean[:, column], 100 * mean[:, 4], color="#1b4f72", linewidth=2)
        panel.set(xlabel=label, xlim=(0, mean[-1, column]), ylim=(0, 102))
        panel.locator_params(axis="x", nbins=6)
        panel.grid(color="0.9")
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("goals reached (%)")
    figure.get_layout_engine().set(wspace=0.06)
    figure.suptitle(
        f"{title}: " + (f"{len(seeds)} seeds and their mean" if len(seeds) > 1 else "one seed"),
        fontsize=11,
    )
    figure.savefig(file, dpi=150)


def main() -> None:
    """Reads the options, trains, writes."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--algo", default="sac", choices=("sac", "td3"))
    options.add_argument("--arm", default="planar2", choices=ENVIRONMENTS)
    options.add_argument("--reset-range", type=float, default=1.0, help="central share of the joints' range")
    options.add_argument("--until", type=float, help="a seed ends at this success")
    options.add_argument("--steps", type=int, default=15_000, help="environment steps per seed")
    options.add_argument("--seeds", type=int, default=3, help="seeds, one after another")
    options.add_argument("--evaluate-every", type=int, default=500, help="steps between evaluations")
    options.add_argument("--evaluate-episodes", type=int, default=200, help="episodes per evaluation")
    options.add_argument("--out", type=Path, default=Path("."), help="folder of the CSV and the PNG")
    chosen = options.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    task = {"id": ENVIRONMENTS[chosen.arm], "reset_range": chosen.reset_range}
    rows = []
    for seed in range(chosen.seeds):
        numbers = chosen.steps, chosen.evaluate_every, chosen.evaluate_episodes, chosen.until
        rows += train(chosen.algo, task, seed, *numbers)
        with (chosen.out / "sb3_her.csv").open("w", newline="") as file:
            csv.writer(file).writerows([COLUMNS, *rows])
    draw(np.array(rows), f"{chosen.algo.upper()} with HER on {chosen.arm}", chosen.out / "sb3_her.png")


if __name__ == "__main__":
    main()
