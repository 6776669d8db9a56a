"""Pictures of a robot in MuJoCo, drawn off screen."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .simulator import simulator

if TYPE_CHECKING:
    from mujoco._structs import MjModel  # the public name is not seen by type checkers

__all__ = ["Camera", "Draw", "renderer"]

_GEOMS = 5000


@dataclass(frozen=True)
class Camera:
    """Where a picture is taken from.

    Parameters
    ----------
    distance : float
        m.
    azimuth, elevation : float
        deg.
    at : (float, float, float), optional
        What it looks at, m; None: the robot's base, wherever it goes.
    lights : bool
        Whether the model's own lights shine; else its headlight alone.
    plain : bool
        Without sky, reflections and sites: what a file of few colours would waste them on.
    """

    distance: float
    azimuth: float
    elevation: float
    at: tuple[float, float, float] | None = None
    lights: bool = True
    plain: bool = False


class Draw(Protocol):
    """Draws a configuration."""

    def __call__(self, qpos: NDArray[np.float64], /) -> NDArray[np.uint8]:
        """Picture (height, width, 3) of ``qpos``."""
        ...


@contextmanager
def renderer(model: MjModel, size: tuple[int, int], camera: Camera) -> Iterator[Draw]:
    """MuJoCo's renderer without a window: by EGL where there is one, else by what MuJoCo finds.

    Parameters
    ----------
    model : mujoco.MjModel
        Its off-screen buffer must hold the picture.
    size : (int, int)
        Width and height, pixels.
    camera : Camera

    Yields
    ------
    Draw

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    Exception
        Of one kind or another where there is no driver, library or device to draw with; draw lines then.
    """
    mujoco = simulator("the animation")
    context = _context(*size)
    context.make_current()
    try:
        yield _drawn_by(mujoco, model, size, camera)
    finally:
        context.free()


def _context(width: int, height: int) -> Any:
    try:
        from mujoco.egl import GLContext
    except Exception:  # another system, or no EGL: each fails in its own way
        from mujoco.gl_context import GLContext
    return GLContext(width, height)


def _drawn_by(mujoco: Any, model: MjModel, size: tuple[int, int], camera: Camera) -> Draw:
    data, scene, option = mujoco.MjData(model), mujoco.MjvScene(model, _GEOMS), mujoco.MjvOption()
    view, place = mujoco.MjvCamera(), mujoco.MjrRect(0, 0, *size)
    view.distance, view.azimuth, view.elevation = camera.distance, camera.azimuth, camera.elevation
    if camera.plain:
        option.sitegroup[:] = 0
        for effect in (mujoco.mjtRndFlag.mjRND_SKYBOX, mujoco.mjtRndFlag.mjRND_REFLECTION):
            scene.flags[effect] = 0
    drawing = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, drawing)

    def draw(qpos: NDArray[np.float64], /) -> NDArray[np.uint8]:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        if camera.lights:
            mujoco.mj_camlight(model, data)
        view.lookat[:] = qpos[:3] if camera.at is None else camera.at
        mujoco.mjv_updateScene(model, data, option, None, view, mujoco.mjtCatBit.mjCAT_ALL.value, scene)
        mujoco.mjr_render(place, scene, drawing)
        pixels = np.empty((size[1], size[0], 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, place, drawing)
        return pixels[::-1]

    return draw
