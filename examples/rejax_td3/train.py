"""rejax's TD3, a program of many seeds as this package's is, on an arm: success over steps, and what a step costs.

rejax has no hindsight. It is given what helps without: a reward of -1 per step and 0 at the goal, as the preset `best`
has. Networks, batch and updates per step are those of `icac train --algo td3`.
"""

import argparse
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rejax import TD3

from icac_jax.envs import gymnax as arms_for_gymnax


def agent_of(arm: str, physics: str, steps: int, every: int, timed: bool) -> Any:
    """The learner of rejax; without any evaluation where its steps are timed."""
    # rejax adds nothing to rewards: the step cost makes each step -1, and the goal is worth nothing beside it.
    env, params = arms_for_gymnax.make(arm, physics=physics, step_cost=1.0, goal_reward=0.0)
    agent = TD3.create(
        env=env,
        env_params=params,
        num_envs=1,
        num_epochs=1,
        batch_size=64,
        buffer_size=8192,
        fill_buffer=500,
        learning_rate=1e-3,
        gamma=0.95,
        polyak=0.95,
        target_update_freq=1,
        exploration_noise=0.2,
        policy_delay=2,
        total_timesteps=steps,
        eval_freq=every,
        skip_initial_evaluation=timed,
        actor_kwargs={"activation": "relu"},
        critic_kwargs={"activation": "relu"},
    )
    return agent.replace(eval_callback=lambda *_: jnp.zeros(())) if timed else agent


def seconds(agent: Any, keys: jax.Array) -> float:
    """How long a training of all seeds takes once it is compiled, the shortest of three."""
    # What the networks have become must be asked for: XLA leaves out a training whose results nobody uses.
    program = jax.jit(jax.vmap(lambda key: agent.train(key)[0].actor_ts.params)).lower(keys).compile()
    taken = []
    for _ in range(3):
        began = time.perf_counter()
        jax.block_until_ready(program(keys))
        taken.append(time.perf_counter() - began)
    return min(taken)


def main() -> None:
    """Reads the options, trains, prints."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--arm", default="planar2", help="planar2 or nico4")
    options.add_argument("--physics", default="servo", help="servo or kinematic")
    options.add_argument("--steps", type=int, default=6000, help="environment steps per seed")
    options.add_argument("--every", type=int, default=1000, help="steps between evaluations on 128 episodes")
    options.add_argument("--seeds", type=int, default=20, help="trained at once")
    options.add_argument("--timed", action="store_true", help="only time the steps, without evaluations")
    chosen = options.parse_args()
    keys = jax.random.split(jax.random.key(0), chosen.seeds)
    if chosen.timed:
        # Of two lengths, so that what is done once per training is not counted.
        long, short = (
            seconds(agent_of(chosen.arm, chosen.physics, steps, steps, timed=True), keys)
            for steps in (1000 + chosen.steps, 1000)
        )
        cost = (long - short) / chosen.steps / chosen.seeds
        print(f"{1e6 * cost:.0f} microseconds per step of one seed, {1e6 * cost / 64:.2f} per sample of a batch")
        return
    agent = agent_of(chosen.arm, chosen.physics, chosen.steps, chosen.every, timed=False)
    began = time.perf_counter()
    _, (lengths, returns) = jax.jit(jax.vmap(agent.train))(keys)
    success = np.asarray(returns > -lengths).mean(-1)  # the step that reaches the goal costs nothing
    for number, reached in enumerate(success.T):
        print(f"{number * chosen.every:,} steps: {reached.mean():.1%} of the goals, worst seed {reached.min():.1%}")
    print(f"{time.perf_counter() - began:.0f} s with compilation and evaluations")


if __name__ == "__main__":
    main()
