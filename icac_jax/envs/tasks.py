"""Named tasks: what each sets of the options, for the arms that ship with the package. Numbers only.

Task `reach` is the paper's, and sets nothing. The others are tasks of discovery: every episode starts in the middle of
the joints' range, each seed has one goal for all of its episodes, and walls stand between the two configurations. The
tip may have a way round all the same, with the elbow bent to the other side: `goal_distance_low` leaves such goals out.
"""

from typing import Any

from icac_jax.fields import ConfigError

REACH = "reach"

_DISCOVERY: dict[str, Any] = {"start_range": 0.0, "reset_range": 1.0, "goal_per": "seed", "horizon": 80}
_FULL_TURN: dict[str, Any] = {**_DISCOVERY, "joint_low": (-180.0, -180.0), "joint_high": (180.0, 180.0)}

# By arm and name.
TASKS: dict[str, dict[str, dict[str, Any]]] = {
    "planar2": {
        # One wall; the way leads past its upper end, at 100 degrees of the second joint, and back down.
        "door": {
            **_FULL_TURN,
            "walls": (45.0, -180.0, 80.0, 100.0),
            "goal_radius": 0.2,
            "goal_joint_low": (95.0, -90.0),
            "goal_joint_high": (170.0, 60.0),
        },
        # One wall with a low door and no way round it by the left, where the first joint ends at -90 degrees: no goal
        # can be reached but through the door.
        "gate": {
            **_FULL_TURN,
            "joint_low": (-90.0, -180.0),
            "start_offset": (-45.0, 0.0),
            "walls": (45.0, -180.0, 80.0, 40.0),
            "goal_radius": 0.2,
            "goal_joint_low": (115.0, -60.0),
            "goal_joint_high": (170.0, 60.0),
        },
        # Two walls with doors at opposite ends.
        "two_walls": {
            **_FULL_TURN,
            "walls": (40.0, -180.0, 70.0, 90.0, 100.0, -90.0, 125.0, 180.0),
            "goal_radius": 0.2,
            "goal_joint_low": (140.0, -60.0),
            "goal_joint_high": (175.0, 90.0),
        },
        # Three walls about the start, open to the left, below -140 degrees of the first joint.
        "cup": {
            **_FULL_TURN,
            "walls": (
                *(40.0, -120.0, 70.0, 120.0),
                *(-140.0, 100.0, 70.0, 130.0),
                *(-140.0, -130.0, 70.0, -100.0),
            ),
            "goal_radius": 0.2,
            "goal_joint_low": (100.0, -60.0),
            "goal_joint_high": (170.0, 60.0),
        },
    },
    "nico4": {
        # As on planar2, with the walls across the first two joints of Table I; the other two are free.
        "door": {
            **_DISCOVERY,
            "walls": (*(45.0, -180.0, -140.0, -100.0), *(70.0, 80.0, 75.0, 100.0)),
            "goal_distance_low": 10.0,
        },
        "two_walls": {
            **_DISCOVERY,
            "walls": (
                *(40.0, -180.0, -140.0, -100.0),
                *(65.0, 80.0, 75.0, 100.0),
                *(85.0, -80.0, -140.0, -100.0),
                *(110.0, 179.0, 75.0, 100.0),
            ),
            "goal_distance_low": 10.0,
        },
    },
}


NAMES = tuple(dict.fromkeys([REACH, *(name for tasks in TASKS.values() for name in tasks)]))
"""All of them, of whatever arm."""


def options_of(name: str, arm: str, tasks: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What a task sets, by option.

    Args:
      name: of the task.
      arm: what an error calls the arm.
      tasks: the arm's own, by name.

    Raises:
      ConfigError: the arm has no such task.
    """
    if name == REACH:
        return {}
    if name not in tasks:
        known = ", ".join([REACH, *tasks])
        own = "" if arm in TASKS else f"; [tasks.{name}] in its file makes one, and walls can be given without"
        raise ConfigError(f"task: must be one of {known} for {arm}, got {name!r}{own}")
    return tasks[name]
