"""Walks as a GIF, one or several side by side: MuJoCo's renderer where the machine can draw off screen, else lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl._output import write_gif
from phyfilter_ctl.plants.legged.rendering import Camera
from phyfilter_ctl.plants.legged.rendering import renderer as off_screen
from phyfilter_ctl.plants.legged.simulator import simulator

from .params import Params, params
from .robot import legged
from .terrain import Terrain

__all__ = ["animate"]

FloatArray = NDArray[np.float64]
Pixels = NDArray[np.uint8]

# Of the whole, and of one beside another.
_SIZE, _BESIDE = (640, 360), (400, 300)
_COLOUR = (0.12, 0.2, 0.4, 1.0)
_EVERY = 4  # of the policy's steps: 12.5 pictures a second


def animate(
    path: Path,
    walks: Sequence[FloatArray],
    *,
    labels: Sequence[str] = (),
    terrain: Terrain | None = None,
    parameters: Params | None = None,
    renderer: bool = True,
) -> str:
    """Write walks of one robot.

    Parameters
    ----------
    path : Path
        GIF.
    walks : sequence of (N, 19) array
        Drawn side by side; one row every 20 ms.
    labels : sequence of str
        Written over each, if there are any.
    terrain : Terrain, optional
        None: flat.
    parameters : Params, optional
        The robot; None: that of ``params.toml``.
    renderer : bool
        Try MuJoCo's renderer first.

    Returns
    -------
    str
        Which of the two drew it.
    """
    p = params() if parameters is None else parameters
    size = _SIZE if len(walks) == 1 else _BESIDE
    each = [np.asarray(walk, dtype=float)[::_EVERY] for walk in walks]
    how = "MuJoCo's renderer"
    try:
        if not renderer:
            raise RuntimeError("not wanted")
        model = legged(p, terrain=terrain).model
        if p.robot.file:  # without its meshes it has nothing but what collides, which is hidden and grey
            model.geom_group[:] = 0
            model.geom_rgba[model.geom_bodyid > 0] = _COLOUR
        with off_screen(model, size, Camera(1.7, 125.0, -14.0, lights=False)) as draw:
            columns = [[draw(row) for row in rows] for rows in each]
    except Exception as error:  # every GL library fails in its own way
        how = f"line drawing (no off-screen rendering: {type(error).__name__})"
        columns = [list(_drawn(rows, terrain, size, p)) for rows in each]
    titles = [*labels, *[""] * (len(walks) - len(labels))]
    columns = [
        [_titled(picture, title) for picture in column] for column, title in zip(columns, titles, strict=True)
    ]
    pictures = (np.concatenate(beside, axis=1) for beside in zip(*columns, strict=True))
    write_gif(path, pictures, milliseconds=20 * _EVERY)
    return how


def _titled(picture: Pixels, title: str) -> Pixels:
    if not title:
        return picture
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    draw.rectangle((0, 0, image.width, 22), fill=(255, 255, 255))
    draw.text((6, 3), title, fill=(0, 0, 0), font_size=14)
    return np.asarray(image)


def _drawn(rows: FloatArray, terrain: Terrain | None, size: tuple[int, int], p: Params) -> Iterator[Pixels]:
    """Trunk and legs as lines, seen from the side; left legs in colour."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    mujoco = simulator("the animation")
    robot = legged(p, terrain=terrain)
    bodies = np.array([robot.model.joint(name).bodyid[0] for name in robot.joints]).reshape(4, 3)
    ground = Terrain() if terrain is None else terrain
    data = mujoco.MjData(robot.model)
    figure = Figure(figsize=(size[0] / 100.0, size[1] / 100.0), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for row in rows:
        data.qpos[:] = row
        mujoco.mj_kinematics(robot.model, data)
        axes.clear()
        middle = row[0]
        x = np.linspace(middle - 0.9, middle + 0.9, 200)
        axes.fill_between(x, ground.height(x, row[1]), -1.0, color="0.85")
        for k in (1, 3, 0, 2):  # the right ones are behind
            points = np.array([*data.xpos[bodies[k]], data.geom_xpos[robot.geoms[k]]])
            axes.plot(
                points[:, 0] + 0.2 * points[:, 1],
                points[:, 2],
                color="0.55" if k % 2 else "#0072B2",
                linewidth=3.0,
                marker="o",
                markersize=3.0,
            )
        hips = data.xpos[bodies[[0, 1, 3, 2, 0], 0]]
        axes.fill(hips[:, 0] + 0.2 * hips[:, 1], hips[:, 2] + 0.25 * hips[:, 1], color="0.35")
        axes.set(xlim=(middle - 0.8, middle + 0.8), ylim=(row[2] - 0.45, row[2] + 0.45), aspect="equal")
        axes.set_axis_off()
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()
