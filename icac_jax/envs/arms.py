"""The arms that ship with the package: model file, limits, goal, reward. Numbers only; no physics here."""

import dataclasses

from icac_jax.console import shown
from icac_jax.fields import ConfigError


@dataclasses.dataclass(frozen=True)
class ArmSpec:
    """A serial arm and its reaching task.

    Attributes:
      name: what `--arm` takes; of an own arm what tables and folders call it.
      model: MJCF file, by its name in the assets or by its whole path. Its joints are the arm's, hinges all; for servo
        physics it has one position actuator a joint, in joint order.
      goal_axes: which Cartesian axes of the tip's frame the observation holds.
      goal_low: lowest tip position on each of `goal_axes`, in metres; maps to -1 in the observation.
      goal_high: highest tip position on each of `goal_axes`, in metres; maps to +1 in the observation.
      joint_low: default lower limit of each joint, in degrees.
      joint_high: default upper limit of each joint, in degrees.
      goal_radius: default radius of the goal zone, in metres.
      goal_reward: extrinsic reward for reaching the goal zone.
      reset_range: default central share of the joint range from which starts and goals are drawn.
      joint_names: the model's joints in its order, to be checked when it is loaded; empty: whatever they are.
      tip: the site that must reach the goal, or a body whose frame must.
    """

    name: str
    model: str
    goal_axes: tuple[int, ...]
    goal_low: tuple[float, ...]
    goal_high: tuple[float, ...]
    joint_low: tuple[float, ...]
    joint_high: tuple[float, ...]
    goal_radius: float
    goal_reward: float
    reset_range: float = 1.0
    joint_names: tuple[str, ...] = ()
    tip: str = "tip"

    @property
    def joints(self) -> int:
        """Number of joints J."""
        return len(self.joint_low)

    @property
    def observation_size(self) -> int:
        """Entries of the observation: normalised joints, then normalised goal coordinates (Sec. IV)."""
        return self.joints + len(self.goal_axes)


# Sec. IV.A: two links of one unit, goal zone of 0.3 unit, reward 50. The paper does not state joint limits; [0, 180]
# degrees is the widest range tried in which twelve hidden units can hold a policy of "slightly less than 10" steps.
PLANAR2 = ArmSpec(
    name="planar2",
    model="planar2.xml",
    goal_axes=(0, 1),
    goal_low=(-2.0, -2.0),
    goal_high=(2.0, 2.0),
    joint_low=(0.0, 0.0),
    joint_high=(180.0, 180.0),
    goal_radius=0.3,
    goal_reward=50.0,
)

# Sec. IV.B and Table I (its "r_arm_z" is the robot's joint r_arm_x). The goal radius is 12.5 % of the arm's length,
# taken as the link sum from r_arm_x, 0.3028 m. The goal box is the tip's bounding box over Table I. Starts and
# goals are in the central 25 % of Table I: of the readings tried it gives the paper's CACLA
# (docs/results/calibration.md), and uniform over Table I "around five" steps is impossible.
NICO4 = ArmSpec(
    name="nico4",
    model="nico4.xml",
    goal_axes=(0, 1, 2),
    goal_low=(-0.375, -0.456, 0.463),
    goal_high=(0.432, 0.340, 1.109),
    joint_low=(-100.0, -180.0, -140.0, -100.0),
    joint_high=(125.0, 179.0, 75.0, 100.0),
    goal_radius=0.125 * 0.3028,
    goal_reward=100.0,
    reset_range=0.25,
)

ARMS = {arm.name: arm for arm in (PLANAR2, NICO4)}


def get(name: str) -> ArmSpec:
    """The arm of that name, among those that ship with the package.

    Raises:
      ConfigError: there is none.
    """
    if not isinstance(name, str) or name not in ARMS:
        raise ConfigError(
            f"arm: must be one of {', '.join(ARMS)} or the path of a .toml file, a model file or a folder with one "
            f".toml, got {shown(repr(name))}"
        )
    return ARMS[name]
