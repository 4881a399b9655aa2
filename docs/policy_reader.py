"""Reads a policy that `icac export` wrote, with NumPy alone: `Policy("policy-seed-3.npz").move(joints, goal)`."""

# ruff: noqa: ANN001, ANN201, D101, D102
import json

import numpy as np

ACTIVATIONS = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0), "linear": lambda x: x}


class Policy:
    def __init__(self, path):
        with np.load(path, allow_pickle=False) as file:
            self.header = json.loads(file["header"].tobytes())
            layers = range(len(self.header["network"]["sizes"]) - 1)
            self.layers = [(file[f"weights_{k}"], file[f"bias_{k}"]) for k in layers]

    def act(self, observation):  # [O] to an action [A] in [-1, 1]
        kinds = [self.header["network"]["hidden"]] * (len(self.layers) - 1) + [self.header["network"]["output"]]
        for kind, (weights, bias) in zip(kinds, self.layers, strict=True):
            observation = ACTIVATIONS[kind](weights @ observation + bias)
        return np.clip(observation, *self.header["action"]["clip"])

    def move(self, joints, goal):  # joint angles in degrees and a goal [x, y, z] in m to the joint angles to go to
        space = self.header["observation"]
        low = np.array(space["joint_low"] + space["goal_low"])
        high = np.array(space["joint_high"] + space["goal_high"])
        seen = np.concatenate([joints, np.asarray(goal)[space["goal_axes"]]])
        change = self.header["action"]["bound"] * self.act(2 * (seen - low) / (high - low) - 1)
        return np.clip(joints + change, space["joint_low"], space["joint_high"])
