"""The reaching task on C MuJoCo, one control step at a time, in float64."""

import mujoco
import numpy as np

from icac_jax.envs import assets


class CArm:
    """An arm of the assets, driven as the task drives it."""

    def __init__(self, arm, sub_steps):
        self.arm, self.sub_steps = arm, sub_steps
        self.model = mujoco.MjModel.from_xml_path(str(assets.path(arm.model)))
        self.data = mujoco.MjData(self.model)
        self.low, self.high = np.radians(arm.joint_low), np.radians(arm.joint_high)
        self.tip_site = self.model.site("tip").id

    def tip(self, joints):
        self.data.qpos[:] = joints
        mujoco.mj_kinematics(self.model, self.data)
        return self.data.site_xpos[self.tip_site].copy()

    def move(self, joints, velocity, action, bound=10.0):
        """Joints, velocities and tip after one control step from the given state."""
        self.data.qpos[:], self.data.qvel[:] = joints, velocity
        self.data.ctrl[:] = np.clip(joints + np.radians(bound) * action, self.low, self.high)
        for _ in range(self.sub_steps):
            mujoco.mj_step(self.model, self.data)
        joints = np.clip(self.data.qpos, self.low, self.high)
        velocity = np.where(joints == self.data.qpos, self.data.qvel, 0.0)
        return joints, velocity, self.tip(joints)


class CReach:
    """The whole task with resets, for the benchmark's plain NumPy learner."""

    def __init__(self, arm, sub_steps, reset_range, rng, physics="servo"):
        self.c, self.arm, self.rng, self.physics = CArm(arm, sub_steps), arm, rng, physics
        self.reset_range = reset_range
        self.reset()

    def random_joints(self):
        middle, half = (self.c.low + self.c.high) / 2, self.reset_range * (self.c.high - self.c.low) / 2
        return middle + half * self.rng.uniform(-1, 1, self.arm.joints)

    def reset(self):
        self.joints, self.velocity, self.steps = self.random_joints(), np.zeros(self.arm.joints), 0
        self.goal = self.c.tip(self.random_joints())

    def observe(self):
        joints = (self.joints - self.c.low) / (self.c.high - self.c.low)
        low, high = np.array(self.arm.goal_low), np.array(self.arm.goal_high)
        goal = (self.goal[list(self.arm.goal_axes)] - low) / (high - low)
        return 2 * np.concatenate([joints, goal]) - 1

    def step(self, action):
        obs = self.observe()
        if self.physics == "servo":
            self.joints, self.velocity, tip = self.c.move(self.joints, self.velocity, action)
        else:
            self.joints = np.clip(self.joints + np.radians(10) * action, self.c.low, self.c.high)
            tip = self.c.tip(self.joints)
        self.steps += 1
        reached = np.linalg.norm(tip - self.goal) <= self.arm.goal_radius
        after = self.observe()
        if reached or self.steps >= 50:
            self.reset()
        return obs, self.arm.goal_reward * reached, after
