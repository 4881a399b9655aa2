"""Pictures of an arm, its goal zone and the trail of its tip, drawn by MuJoCo without a window.

MuJoCo decides at its import, by MUJOCO_GL, how it draws; here it is decided when a picture is wanted, so that the
program can be drawn with whatever was imported before.
"""

import atexit
import importlib
import itertools
import os
import sys
from typing import Any

import numpy as np

from icac_jax.fields import ConfigError

_NEEDS = (
    "rendering: needs EGL, which cannot be used here; on Debian: "
    "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri (reason: {reason})"
)

try:
    import mujoco as _mujoco  # with MUJOCO_GL=egl in the environment this loads EGL
except (ImportError, AttributeError) as error:  # AttributeError is what a missing libEGL.so gives
    raise ConfigError(_NEEDS.format(reason=str(error).partition("\n")[0])) from error

mujoco: Any = _mujoco  # a compiled module without stubs

GOAL_COLOUR = (0.16, 0.63, 0.30, 0.40)
TRAIL_COLOUR = (0.84, 0.19, 0.15, 1.0)
_MOST_GEOMS = 5000
_MARGIN = 1.08  # so much more than the points is in the picture


def backend() -> str:
    """Which of MuJoCo's ways to draw is taken: what MUJOCO_GL says, else EGL unless there is a screen."""
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    if asked in ("egl", "osmesa", "glfw"):
        return asked
    if sys.platform == "darwin":
        return "cgl"
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return "glfw" if screen or sys.platform == "win32" else "egl"


class Canvas:
    """Draws one arm; free it with `close`.

    Args:
      model: of the arm, whose `<visual>` says from where it is looked at; its own site "goal", if any, is hidden.
      tip: name of the site whose trail is drawn.
      width: of a picture, in pixels.
      height: of a picture, in pixels.

    Raises:
      ConfigError: there is nothing to draw with; the line names what to install.
    """

    def __init__(self, model: Any, tip: str, width: int, height: int) -> None:
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        if (goal := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "goal")) >= 0:
            model.site_rgba[goal, 3] = 0.0
        self._model, self._data, self._tip = model, mujoco.MjData(model), model.site(tip).id
        os.environ.setdefault("MUJOCO_GL", backend())  # for what MuJoCo looks up later
        try:
            self._gl = importlib.import_module(f"mujoco.{backend()}").GLContext(width, height)
            self._gl.make_current()
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150.value)
        except Exception as error:  # each driver fails in a way of its own
            reason = str(error).partition("\n")[0] or type(error).__name__
            raise ConfigError(_NEEDS.format(reason=reason)) from error
        atexit.register(self.close)  # a context that is freed after its library raises
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._scene = mujoco.MjvScene(model, maxgeom=_MOST_GEOMS)
        self._option = mujoco.MjvOption()
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self._camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, self._camera)

    def anchors(self) -> np.ndarray:
        """Where the joints are, [J, 3] in m, with the arm as it was last asked for."""
        return self._data.xanchor.copy()

    def tip(self, joints: np.ndarray) -> np.ndarray:
        """Position [3] of the tip in m, for joint angles [J] in rad; the next picture shows the arm there."""
        self._data.qpos[:] = joints
        mujoco.mj_kinematics(self._model, self._data)
        return self._data.site_xpos[self._tip].copy()

    def look_at(self, points: np.ndarray) -> None:
        """Moves the camera along its direction so that all points [n, 3], in m, are in the picture."""
        azimuth, elevation = np.radians([self._camera.azimuth, self._camera.elevation])
        forward = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        axes = np.stack([right, np.cross(right, forward), forward])
        seen = points @ axes.T
        middle = (seen.max(0) + seen.min(0)) / 2
        right_of, above, behind = (seen - middle).T
        slope = np.tan(np.radians(self._model.vis.global_.fovy) / 2)
        aspect = self._rect.width / self._rect.height
        wanted = np.maximum(np.abs(above), np.abs(right_of) / aspect) / slope - behind
        self._camera.lookat[:] = middle @ axes
        self._camera.distance = _MARGIN * wanted.max()

    def draw(self, joints: np.ndarray, goal: np.ndarray, radius: float, trail: np.ndarray) -> np.ndarray:
        """A picture [height, width, 3], uint8.

        Args:
          joints: [J] angles in rad.
          goal: [3] in m.
          radius: of the goal zone, in m.
          trail: [n, 3] where the tip has been, in m.
        """
        self._data.qpos[:] = joints
        for place in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):  # all that a picture needs
            place(self._model, self._data)
        scene = self._scene
        mujoco.mjv_updateScene(
            self._model,
            self._data,
            self._option,
            mujoco.MjvPerturb(),
            self._camera,
            mujoco.mjtCatBit.mjCAT_ALL.value,
            scene,
        )
        sphere, line = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_LINE
        for before, after in itertools.pairwise(trail):
            if scene.ngeom < scene.maxgeom - 1 and np.linalg.norm(after - before) > 1e-9:
                geom = self._add(line, np.zeros(3), np.zeros(3), TRAIL_COLOUR)
                mujoco.mjv_connector(geom, line, self._rect.height / 120, before, after)
        self._add(sphere, np.full(3, radius), goal, GOAL_COLOUR)
        self._add(sphere, np.full(3, 0.1 * radius), goal, (*GOAL_COLOUR[:3], 1.0))
        self._gl.make_current()
        mujoco.mjr_render(self._rect, scene, self._context)
        picture = np.empty((self._rect.height, self._rect.width, 3), np.uint8)
        mujoco.mjr_readPixels(picture, None, self._rect, self._context)
        return picture[::-1]

    def _add(self, kind: Any, size: np.ndarray, place: np.ndarray, colour: tuple[float, ...]) -> Any:
        """A geom more in the scene."""
        geom = self._scene.geoms[self._scene.ngeom]
        mujoco.mjv_initGeom(geom, kind, size, place, np.eye(3).ravel(), np.array(colour, np.float32))
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        self._scene.ngeom += 1
        return geom

    def close(self) -> None:
        """Gives the graphics memory back."""
        atexit.unregister(self.close)
        self._gl.make_current()
        self._context.free()
        self._gl.free()
