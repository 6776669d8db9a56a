"""A walk as a GIF: MuJoCo's renderer where the machine can draw off screen, line drawings otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl._output import write_gif
from phyfilter_ctl.plants.legged.rendering import Camera
from phyfilter_ctl.plants.legged.rendering import renderer as off_screen
from phyfilter_ctl.plants.legged.simulator import simulator

from .robot import LEGS, compile_model
from .terrain import Terrain

__all__ = ["animate"]

FloatArray = NDArray[np.float64]
Pixels = NDArray[np.uint8]

_SIZE = (640, 360)
_EVERY = 4  # of the policy's steps: 12.5 pictures a second


def animate(path: Path, qpos: FloatArray, *, terrain: Terrain | None = None, renderer: bool = True) -> str:
    """Write a walk.

    Parameters
    ----------
    path : Path
        GIF.
    qpos : (N, 19) array
        One row every 20 ms.
    terrain : Terrain, optional
        None: flat.
    renderer : bool
        Try MuJoCo's renderer first.

    Returns
    -------
    str
        Which of the two drew it.
    """
    rows = np.asarray(qpos, dtype=float)[::_EVERY]
    how = "MuJoCo's renderer"
    try:
        if not renderer:
            raise RuntimeError("not wanted")
        with off_screen(
            compile_model(terrain=terrain), _SIZE, Camera(1.7, 125.0, -14.0, lights=False)
        ) as draw:
            pictures = [draw(row) for row in rows]
    except Exception as error:  # every GL library fails in its own way
        how = f"line drawing (no off-screen rendering: {type(error).__name__})"
        pictures = list(_drawn(rows, terrain))
    write_gif(path, pictures, milliseconds=20 * _EVERY)
    return how


def _drawn(rows: FloatArray, terrain: Terrain | None) -> Iterator[Pixels]:
    """Trunk and legs as lines, seen from the side; left legs in colour."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    mujoco = simulator("the animation")
    model = compile_model(terrain=terrain)
    ground = Terrain() if terrain is None else terrain
    data = mujoco.MjData(model)
    figure = Figure(figsize=(_SIZE[0] / 100.0, _SIZE[1] / 100.0), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for row in rows:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        axes.clear()
        middle = row[0]
        x = np.linspace(middle - 0.9, middle + 0.9, 200)
        axes.fill_between(x, ground.height(x, row[1]), -1.0, color="0.85")
        for leg in sorted(LEGS, key=lambda name: name.endswith("L")):
            bodies = [data.body(f"{leg}_{part}").xpos for part in ("hip", "thigh", "shank")]
            points = np.array([*bodies, data.geom(f"{leg}_foot").xpos])
            axes.plot(
                points[:, 0] + 0.2 * points[:, 1],
                points[:, 2],
                color="#0072B2" if leg.endswith("L") else "0.55",
                linewidth=3.0,
                marker="o",
                markersize=3.0,
            )
        hips = np.array([data.body(f"{leg}_hip").xpos for leg in ("FL", "FR", "HR", "HL", "FL")])
        axes.fill(hips[:, 0] + 0.2 * hips[:, 1], hips[:, 2] + 0.25 * hips[:, 1], color="0.35")
        axes.set(xlim=(middle - 0.8, middle + 0.8), ylim=(row[2] - 0.45, row[2] + 0.45), aspect="equal")
        axes.set_axis_off()
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()
