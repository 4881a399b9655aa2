"""Reaching by sight: the learner sees embeddings of pictures, the world judges by its own joints. Pure, for one lane.

An observation is the embedding of a picture of the arm, then that of a picture of the goal. Two pictures and not one
with both, for two reasons: curiosity maps the arm's own state, the first L entries, which then do not change with the
goal; and hindsight can replace a goal without the joints, which a replay buffer does not hold. What is achieved carries
the embedding of a goal at the tip, drawn once when it was reached; so replacing goals costs no pictures.
"""

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.base import Environment, Goal, TimeStep
from icac_jax.envs.drawing import Camera
from icac_jax.envs.embedding import Embedding
from icac_jax.envs.reach import ReachParams, ReachState


class SeenState(struct.PyTreeNode):
    """The arm and its goal, and how the goal looks.

    Attributes:
      inside: of the world of joints.
      goal_embedding: [L] of the goal's picture, which stays for an episode.
    """

    inside: ReachState
    goal_embedding: jax.Array

    @property
    def joints(self) -> jax.Array:
        """Joint angles [J] in rad."""
        return self.inside.joints

    @property
    def goal(self) -> jax.Array:
        """Goal position [3] in m."""
        return self.inside.goal


def seen(env: Environment, camera: Camera, embedding: Embedding) -> Environment:
    """The world of an arm as its camera shows it.

    Args:
      env: the world, by `reach.make`.
      camera: of the same arm.
      embedding: of that camera's pictures.

    Returns:
      The same starts, goals, moves, rewards and ends of episodes; observations [2 L] of embeddings, of which the first
      L are the learner's own state; goals [3 + L], a position in m and the embedding of a goal there.
    """
    inside = env.goal
    assert inside is not None  # every arm has one

    def of_arm(state: ReachState) -> jax.Array:
        return embedding.embed("arm", camera.arm(state.joints))

    def of_goal(place: jax.Array) -> jax.Array:
        return embedding.embed("goal", camera.goal(place))

    def init(key: jax.Array, params: ReachParams) -> tuple[SeenState, jax.Array]:
        state, _ = env.init(key, params)
        goal = of_goal(state.goal)
        return SeenState(state, goal), jnp.concatenate([of_arm(state), goal])

    def step(state: SeenState, action: jax.Array, params: ReachParams) -> tuple[SeenState, TimeStep]:
        moved, after = env.step(state.inside, action, params)
        observation = jnp.concatenate([of_arm(moved), state.goal_embedding])
        return state.replace(inside=moved), after._replace(observation=observation)

    def achieved(state: SeenState) -> jax.Array:
        tip = inside.achieved(state.inside)
        return jnp.concatenate([tip, of_goal(tip)])

    def reached(achieved: jax.Array, goal: jax.Array, params: ReachParams) -> jax.Array:
        return inside.reached(achieved[: inside.size], goal[: inside.size], params)

    def relabel(observation: jax.Array, goal: jax.Array) -> jax.Array:
        return jnp.concatenate([observation[: embedding.size], goal[inside.size :]])

    return Environment(
        init=init,
        step=step,
        observation_size=2 * embedding.size,
        action_size=env.action_size,
        state_size=embedding.size,
        params=env.params,
        goal=Goal(
            size=inside.size + embedding.size,
            achieved=achieved,
            desired=lambda state: jnp.concatenate([state.goal, state.goal_embedding]),
            reached=reached,
            reward=inside.reward,
            relabel=relabel,
        ),
    )


def example(arm: ArmSpec) -> jax.Array:
    """The joints [J] in rad of the picture by which another arm of the same name is told apart."""
    low, high = jnp.radians(jnp.array(arm.joint_low)), jnp.radians(jnp.array(arm.joint_high))
    return low + 0.4 * (high - low)
