"""The tasks and the learners that are compared: options of `icac train` by name."""

TASKS = {
    "planar2": {"arm": "planar2"},  # joints in [0, 180] degrees
    "planar2-90": {"arm": "planar2", "joint_low": [-90.0, -90.0], "joint_high": [90.0, 90.0]},
    "planar2-180": {"arm": "planar2", "joint_low": [-180.0, -180.0], "joint_high": [180.0, 180.0]},
    "nico4-25": {"arm": "nico4", "reset_range": 0.25},
    "nico4-50": {"arm": "nico4", "reset_range": 0.5},
    "nico4-100": {"arm": "nico4", "reset_range": 1.0},
}
# The paper's numbers of episodes, with steps that they take at most where episodes are not short yet.
EPISODES = {"planar2": 1000, "nico4": 15000}

LEARNERS = {
    "cacla": {"algo": "cacla"},
    "cacla_var": {"algo": "cacla_var"},
    "icac": {"algo": "icac"},
    "cacla + hindsight": {"algo": "cacla", "hindsight": "future"},
    "cacla_var + hindsight": {"algo": "cacla_var", "hindsight": "future"},
    "icac + hindsight": {"algo": "icac", "hindsight": "future"},
    "ddpg": {"algo": "ddpg"},
    "td3": {"algo": "td3"},
    "td3 + hindsight": {"algo": "td3", "hindsight": "future"},
    "best": {"preset": "best"},
}
