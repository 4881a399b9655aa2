"""Pictures of a model: MuJoCo's renderer and viewer, with one clear line where a machine lacks what they need."""

import warnings
from typing import Any

from icac_jax.fields import ConfigError

NO_OPENGL = (
    "rendering: there is no OpenGL here; without a display set MUJOCO_GL=egl and install the Debian packages "
    "libegl1 libegl-mesa0 libgl1-mesa-dri"
)
NO_DISPLAY = "render_mode: human needs a display (DISPLAY is not set or cannot be opened); rgb_array does not"


def camera(model: Any) -> int:
    """The number of the model's camera "view", or -1, MuJoCo's free camera, if it has none."""
    import mujoco  # here and below: reading NO_OPENGL must not need what it is about

    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, "view")  # pyright: ignore[reportAttributeAccessIssue]


def open_renderer(model: Any, width: int, height: int) -> Any:
    """An off-screen `mujoco.Renderer`; its owner closes it with `close_renderer`.

    Args:
      model: the `mujoco.MjModel`.
      width: of the picture, in pixels.
      height: of the picture, in pixels.

    Raises:
      ConfigError: the picture is larger than the model's frame buffer, or the machine has no OpenGL.
    """
    import mujoco

    buffer = model.vis.global_
    for name, value, most in (("width", width, buffer.offwidth), ("height", height, buffer.offheight)):
        if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= most:
            raise ConfigError(f"{name}: must be a whole number at least 1 and at most {most}, got {value!r}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # glfw says there what the error says
            return mujoco.Renderer(model, height, width)  # pyright: ignore[reportAttributeAccessIssue]
    except (mujoco.FatalError, ImportError, RuntimeError, AttributeError) as error:  # pyright: ignore
        raise ConfigError(NO_OPENGL) from error


def close_renderer(renderer: Any) -> None:
    """Closes a renderer and leaves others alone.

    MuJoCo's own `close` deletes by number in whatever OpenGL context is current, which may be another renderer's: its
    next picture is noise then.

    Args:
      renderer: a `mujoco.Renderer`.
    """
    if renderer._gl_context is not None:
        renderer._gl_context.make_current()
    renderer.close()


def open_viewer(model: Any, data: Any) -> Any:
    """MuJoCo's own viewer in a window, seen by the model's camera; a `mujoco.viewer.Handle`, its owner closes it.

    Args:
      model: the `mujoco.MjModel`.
      data: the `mujoco.MjData` to show; `sync` shows what has changed.

    Raises:
      ConfigError: the machine has no display.
    """
    import glfw
    import mujoco.viewer

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        display = glfw.init()
    if not display:  # the viewer itself would end the process
        raise ConfigError(NO_DISPLAY)
    viewer = mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    if (number := camera(model)) >= 0:
        viewer.cam.type, viewer.cam.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, number  # pyright: ignore
    return viewer
