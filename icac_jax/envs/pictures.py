"""Pictures of a model, drawn by MuJoCo off screen, and MuJoCo's own window; one clear line where either cannot be had.

MuJoCo decides at its import, by MUJOCO_GL, how it draws; here it is decided when the first picture is wanted, so that
one can be drawn with whatever was imported before.
"""

import atexit
import contextlib
import importlib
import itertools
import os
import sys
import warnings
import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np

from icac_jax.envs.model import no_opengl
from icac_jax.fields import ConfigError

import mujoco as _mujoco  # isort: skip  # after `model`, which says in one line what is missing where OpenGL is

mujoco: Any = _mujoco  # a compiled module without stubs

NO_DISPLAY = "render_mode: human needs a display (DISPLAY is not set or cannot be opened); rgb_array does not"

GOAL_COLOUR = (0.16, 0.63, 0.30, 0.40)
TRAIL_COLOUR = (0.84, 0.19, 0.15, 1.0)
_MOST_GEOMS = 10_000
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


@contextlib.contextmanager
def _told_to_mujoco(name: str) -> Iterator[None]:
    """MUJOCO_GL says it for a while: MuJoCo's loader of OpenGL reads it when the first context is made."""
    before = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = name
    try:
        yield
    finally:
        if before is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = before


def check_size(model: Any, width: int, height: int) -> None:
    """Checks the size of a picture, in pixels, against the model's frame buffer (`<visual><global offwidth=...>`).

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    buffer = model.vis.global_
    for name, value, most in (("width", width, buffer.offwidth), ("height", height, buffer.offheight)):
        if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= most:
            raise ConfigError(f"{name}: must be a whole number at least 1 and at most {most}, got {value!r}")


def camera(model: Any) -> Any:
    """The model's camera "view", or the free camera that its `<visual>` describes if it has none."""
    seen = mujoco.MjvCamera()
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, "view")
    if number >= 0:
        seen.type, seen.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, number
    else:
        mujoco.mjv_defaultFreeCamera(model, seen)
    return seen


class Renderer:
    """Draws one model off screen: `update` the scene, add to it what the model lacks, take the `picture`.

    It gives its graphics memory back by `close`, when nobody has it any more, or when the interpreter ends.

    Args:
      model: the `mujoco.MjModel`; its frame buffer is large enough.
      width: of a picture, in pixels.
      height: of a picture, in pixels.

    Raises:
      ConfigError: there is nothing to draw with; the line names what to install.
    """

    def __init__(self, model: Any, width: int, height: int) -> None:
        name = backend()
        try:
            with warnings.catch_warnings(), _told_to_mujoco(name):
                warnings.simplefilter("ignore")  # glfw says there what the error says
                gl = importlib.import_module(f"mujoco.{name}").GLContext(width, height)
                gl.make_current()
                context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150.value)
        except Exception as error:  # each driver fails in a way of its own
            raise no_opengl(error) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
        self.scene = mujoco.MjvScene(model, maxgeom=_MOST_GEOMS)
        self._model, self._gl, self._context = model, gl, context
        self._option, self._rect = mujoco.MjvOption(), mujoco.MjrRect(0, 0, width, height)
        self.close = weakref.finalize(self, _free, gl, context)
        # By atexit itself, which goes backwards: OpenGL, loaded before, is still there. Finalizers may come after it.
        self.close.atexit = False
        atexit.register(self.close)

    def update(self, data: Any, seen_by: Any) -> None:
        """Puts the model into the scene.

        Args:
          data: the `mujoco.MjData`, brought up to date by `mj_forward` or as much of it as a picture needs.
          seen_by: the `mujoco.MjvCamera`.
        """
        whole = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, data, self._option, None, seen_by, whole, self.scene)

    def picture(self) -> np.ndarray:
        """The scene, [height, width, 3] uint8."""
        self._gl.make_current()  # another renderer may have drawn since
        mujoco.mjr_render(self._rect, self.scene, self._context)
        picture = np.empty((self._rect.height, self._rect.width, 3), np.uint8)
        mujoco.mjr_readPixels(picture, None, self._rect, self._context)
        return picture[::-1].copy()


def _free(gl: Any, context: Any) -> None:
    """Frees a renderer: by number in whatever context is current, so in its own."""
    gl.make_current()
    context.free()
    gl.free()


class Canvas:
    """Draws one arm with its goal zone and the trail of its tip; free it with `close`.

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
        self._renderer, self._width, self._height = Renderer(model, width, height), width, height
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
        aspect = self._width / self._height
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
        self._renderer.update(self._data, self._camera)
        scene = self._renderer.scene
        sphere, line = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_LINE
        for before, after in itertools.pairwise(trail):
            if scene.ngeom < scene.maxgeom - 2 and np.linalg.norm(after - before) > 1e-9:
                geom = _add(scene, line, np.zeros(3), np.zeros(3), TRAIL_COLOUR)
                mujoco.mjv_connector(geom, line, self._height / 120, before, after)
        _add(scene, sphere, np.full(3, radius), goal, GOAL_COLOUR)
        _add(scene, sphere, np.full(3, 0.1 * radius), goal, (*GOAL_COLOUR[:3], 1.0))
        return self._renderer.picture()

    def close(self) -> None:
        """Gives the graphics memory back."""
        self._renderer.close()


def _add(scene: Any, kind: Any, size: np.ndarray, place: np.ndarray, colour: tuple[float, ...]) -> Any:
    """A geom more in the scene."""
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, size, place, np.eye(3).ravel(), np.array(colour, np.float32))
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    scene.ngeom += 1
    return geom


def open_viewer(model: Any, data: Any) -> Any:
    """MuJoCo's own viewer in a window, seen by the model's camera; a `mujoco.viewer.Handle`, its owner closes it.

    Args:
      model: the `mujoco.MjModel`.
      data: the `mujoco.MjData` to show; `sync` shows what has changed.

    Raises:
      ConfigError: the machine has no display.
    """
    import glfw
    from mujoco import viewer as viewers

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        display = glfw.init()
    if not display:  # the viewer itself would end the process
        raise ConfigError(NO_DISPLAY)
    viewer = viewers.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    seen = camera(model)
    if seen.type == mujoco.mjtCamera.mjCAMERA_FIXED:
        viewer.cam.type, viewer.cam.fixedcamid = seen.type, seen.fixedcamid
    return viewer
