"""Reads a policy that `icac export` wrote, with NumPy alone: `Policy("policy.npz").move(joints, goal)`."""

import json

import numpy as np

ACTIVATIONS = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0), "linear": lambda x: x}


class Policy:
    def __init__(self, path):
        with np.load(path, allow_pickle=False) as file:
            self.header = json.loads(file["header"].tobytes())
            self.layers = [(file[f"weights_{k}"], file[f"bias_{k}"]) for k in range(len(file.files) // 2)]

    def act(self, x):  # observation [O] to an action [A] in [-1, 1]
        kinds = [self.header["network"]["hidden"]] * (len(self.layers) - 1) + [self.header["network"]["output"]]
        for kind, (weights, bias) in zip(kinds, self.layers, strict=True):
            x = ACTIVATIONS[kind](weights @ x + bias)
        return np.clip(x, *self.header["action"]["clip"])

    def move(self, joints, goal):  # joint angles in degrees and a goal [x, y, z] in m to the joint angles to go to
        space, span, goal = self.header["observation"], self.header.get("reach"), np.array(goal)
        if np.shape(joints) != np.shape(space["joint_low"]) or goal.shape != (3,) or np.isnan([*joints, *goal]).any():
            raise ValueError(f"must be one angle per joint and three coordinates, got {joints} and {goal}")
        if span and (np.linalg.norm(goal - span["base"]) > span["most"] or any(goal != np.clip(goal, *span["box"]))):
            raise ValueError(f"goal out of reach: {goal}, from {span['base']} the tip gets {span['most']:.3g} m far")
        low, high = (np.array(space[f"joint_{end}"] + space[f"goal_{end}"]) for end in ("low", "high"))
        change = self.act(2 * (np.append(joints, goal[space["goal_axes"]]) - low) / (high - low) - 1)
        return np.clip(joints + self.header["action"]["bound"] * change, space["joint_low"], space["joint_high"])
