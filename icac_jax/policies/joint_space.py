"""Joint space beside a film of an arm with two joints: walls, goal configurations, the way of an episode."""

import numpy as np
from PIL import Image, ImageDraw

from icac_jax.envs import oracle, walls
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.model import joint_names
from icac_jax.envs.pictures import GOAL_COLOUR, TRAIL_COLOUR
from icac_jax.envs.reach import ReachParams
from icac_jax.policies.lettering import font

_PAPER, _INK, _GRID, _WALL = "#f6f7f8", "#5a6068", "#dde1e5", "#7a828b"
_FINE = 2  # a picture is drawn so many times as large and then reduced, for smooth lines
_MAP = 240  # cells of the map of goal configurations along each joint


class JointSpace:
    """Draws joint space, the first joint from left to right and the second one upwards.

    Args:
      arm: with two joints.
      params: Python numbers of the task.
      side: of the square picture, in pixels.
    """

    def __init__(self, arm: ArmSpec, params: ReachParams, side: int) -> None:
        self._arm, self._params, self._side = arm, params, side * _FINE
        self._low, self._high = np.asarray(params.joint_low), np.asarray(params.joint_high)
        self._margin = round(0.11 * self._side)
        self._drawn: tuple[tuple[float, ...], Image.Image] = (), Image.new("RGB", (1, 1))
        self._names = [f"{name} [deg]" for name in joint_names(arm)]

    def _at(self, degrees: np.ndarray) -> list[tuple[float, float]]:
        """Places in the picture of joint angles [n, 2]."""
        share = (np.asarray(degrees) - self._low) / (self._high - self._low)
        room = self._side - 2 * self._margin
        return [(self._margin + a * room, self._side - self._margin - b * room) for a, b in share]

    def _ground(self, goal: tuple[float, ...]) -> Image.Image:
        """All that does not move: limits, walls, and the configurations with the tip in the goal zone."""
        image = Image.new("RGB", (self._side, self._side), "white")
        draw = ImageDraw.Draw(image)
        (left, bottom), (right, top) = self._at(np.array([self._low, self._high]))
        draw.rectangle((left, top, right, bottom), fill=_PAPER)
        line = max(1, self._side // 400)
        size = self._side // 26
        for joint in (0, 1):
            for tick in _ticks(self._low[joint], self._high[joint]):
                place = np.where(np.arange(2) == joint, tick, [self._low, self._high])
                one, other = self._at(place)
                draw.line((one, other), fill=_GRID, width=line)
                words = f"{tick:g}"
                if joint == 0:
                    draw.text((one[0], bottom + size // 3), words, font=font(size), fill=_INK, anchor="ma")
                else:
                    draw.text((left - size // 3, one[1]), words, font=font(size), fill=_INK, anchor="rm")
        colour, where = self._zone(goal, (round(right - left), round(bottom - top)))
        image.paste(colour, (round(left), round(top)), where)
        for low, high in walls.boxes(np.asarray(self._params.walls, float), 2):
            (x0, y1), (x1, y0) = self._at(np.clip([low, high], self._low, self._high))
            draw.rectangle((x0, y0, x1, y1), fill=_WALL)
        draw.rectangle((left, top, right, bottom), outline=_INK, width=line)
        draw.text(((left + right) / 2, self._side - size // 4), self._names[0], font=font(size), fill=_INK, anchor="md")
        draw.text((left, top - size // 3), self._names[1], font=font(size), fill=_INK, anchor="lb")
        return image

    def _zone(self, goal: tuple[float, ...], size: tuple[int, int]) -> tuple[Image.Image, Image.Image]:
        """A colour for the goal configurations, and where it counts, both of the size of the inner square."""
        share = (np.arange(_MAP) + 0.5) / _MAP
        across, up = np.meshgrid(share, share[::-1])
        joints = np.radians(self._low + np.stack([across, up], -1).reshape(-1, 2) * (self._high - self._low))
        near = np.linalg.norm(oracle.tips(self._arm, joints) - goal, axis=1) <= self._params.goal_radius
        mask = Image.fromarray(np.uint8(255 * near.reshape(_MAP, _MAP))).resize(size, Image.Resampling.BILINEAR)
        red, green, blue = (round(255 * part) for part in GOAL_COLOUR[:3])
        return Image.new("RGB", size, (red, green, blue)), mask

    def draw(self, way: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """The picture [side, side, 3], uint8.

        Args:
          way: [n, 2] joint angles in rad where the arm has been, the last one where it is.
          goal: [3] in m.
        """
        place = tuple(float(part) for part in goal)
        if self._drawn[0] != place:  # an episode's frames share it
            self._drawn = place, self._ground(place)
        image = self._drawn[1].copy()
        draw = ImageDraw.Draw(image)
        places = self._at(np.degrees(way))
        colour = tuple(round(255 * part) for part in TRAIL_COLOUR[:3])
        width, dot = max(2, self._side // 120), self._side // 70
        if len(places) > 1:
            draw.line(places, fill=colour, width=width, joint="curve")
        (x0, y0), (x, y) = places[0], places[-1]
        draw.ellipse((x0 - dot, y0 - dot, x0 + dot, y0 + dot), fill="white", outline=_INK, width=width)
        draw.ellipse((x - dot, y - dot, x + dot, y + dot), fill=colour, outline="white", width=max(1, width // 2))
        side = self._side // _FINE
        return np.asarray(image.resize((side, side), Image.Resampling.LANCZOS))


def _ticks(low: float, high: float) -> np.ndarray:
    """Round angles within the limits, about five of them."""
    step = next((step for step in (15, 30, 45, 90, 180, 360) if (high - low) / step <= 6), (high - low) / 4)
    return np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
