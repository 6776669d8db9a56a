"""The comparison as a picture, and a trial as an animation."""

from __future__ import annotations

import contextlib
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl._output import write_gif
from phyfilter_ctl.plants.legged.rendering import Camera, renderer
from phyfilter_ctl.plots import COLOURS, dress

from .around import ANSWERS, HEADINGS, Around
from .limits import PROFILES, Comparison
from .robot import FloatArray, Humanoid
from .trial import Trial

__all__ = ["animate", "draw", "draw_around", "skeleton"]

_COLOURS = {"alone": "#999999", "filter": COLOURS[0]}
_ANSWERS = {"alone": "#999999", "torque": COLOURS[1], "filter": COLOURS[0], "told": COLOURS[2]}
_LABELS = {"alone": "LQR alone", "filter": "with PhyFilter"}
_SIZE = 280  # pixels of a frame's side
_FRAMES_PER_SECOND = 10
_SHOWN = 12.0  # s of a trial
_CAMERA = Camera(3.2, 180.0, -8.0, (0.0, 0.0, 0.85), plain=True)  # a GIF has few colours


def skeleton(humanoid: Humanoid, q: FloatArray) -> list[FloatArray]:
    """Lines (2, 3) from each body to the one that carries it.

    Parameters
    ----------
    humanoid : Humanoid
    q : (28,) array
        Configuration.
    """
    data = humanoid.data()
    data.qpos[:] = q
    humanoid.mujoco.mj_kinematics(humanoid.model, data)
    parents = humanoid.model.body_parentid
    return [np.array([data.xpos[parents[i]], data.xpos[i]]) for i in range(2, humanoid.model.nbody)]


def draw(found: Comparison) -> Figure:
    """Held forces by stance; centre of mass and estimate over time; the postures.

    Parameters
    ----------
    found : Comparison
    """
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    bars, postures, centre, estimate = np.ravel(np.asarray(figure.subplots(2, 2), dtype=object))
    _draw_limits(bars, found)
    _draw_postures(postures, found)
    _draw_trials(centre, estimate, found)
    return figure


def draw_around(found: Around) -> Figure:
    """Held forces by heading, one polar diagram for each place and profile.

    Parameters
    ----------
    found : Around
    """
    grips = list(dict.fromkeys(grip for grip, _ in found.tipping))
    profiles = list(dict.fromkeys(each.profile for each in found.held))
    figure = Figure(figsize=(4.5 * len(profiles), 4.5 * len(grips)), layout="constrained")
    names = list(dict.fromkeys(name for _, name in found.tipping))
    turn = np.radians([HEADINGS[name] for name in names])
    for k, (grip, profile) in enumerate((grip, profile) for grip in grips for profile in profiles):
        axes: Any = figure.add_subplot(len(grips), len(profiles), k + 1, projection="polar")
        axes.set_theta_zero_location("N")
        tips = [found.tipping[grip, name] for name in names]
        axes.plot(_closed(turn), _closed(tips), color="black", linestyle="--", label="tips, as if rigid")
        for mode, answer in ANSWERS.items():
            forces = [each.force for each in found.row(grip, profile, mode)]
            axes.plot(
                _closed(turn), _closed(forces), color=_ANSWERS[mode], marker="o", markersize=3, label=answer
            )
        axes.set_xticks(turn, names, fontsize="x-small")
        axes.set_title(f"{grip}, {profile} force, N", fontsize="medium")
        if k == 0:
            axes.legend(fontsize="x-small", frameon=False, loc="lower left", bbox_to_anchor=(-0.3, -0.15))
    return figure


def _closed(values: ArrayLike) -> FloatArray:
    array = np.asarray(values, dtype=float)
    return np.append(array, array[0])


def _draw_limits(axes: Axes, found: Comparison) -> None:
    width, names = 0.2, list(found.schedules)
    for i, profile in enumerate(PROFILES):
        for j, mode in enumerate(("alone", "filter")):
            least = [min(found.limit(n, profile, d, mode).force for d in (1.0, -1.0)) for n in names]
            place = np.arange(len(names)) + (2 * i + j - 1.5) * width
            axes.bar(
                place,
                least,
                0.9 * width,
                color=_COLOURS[mode],
                alpha=1.0 if profile == "slow" else 0.5,
                label=f"{profile} force, {_LABELS[mode]}",
            )
    for k, name in enumerate(names):
        axes.hlines(
            min(found.tipping[name]), k - 0.45, k + 0.45, color="black", label="" if k else "tips, upright"
        )
    axes.set_xticks(np.arange(len(names)), names)
    axes.set_ylabel("held in both directions [N]")
    axes.set_ylim(0.0, 1.4 * axes.get_ylim()[1])  # room for the legend
    axes.legend(fontsize="x-small", frameon=False, loc="upper left", ncols=2)
    dress(axes, "a  Largest force on the right hand")


def _draw_postures(axes: Axes, found: Comparison) -> None:
    for k, points in enumerate(found.schedules.values()):
        for point, colour in ((points.upright, _COLOURS["alone"]), (points.points[-1], _COLOURS["filter"])):
            for line in skeleton(found.humanoid, point.q):
                axes.plot(line[:, 1] + 1.8 * k, line[:, 2], color=colour, linewidth=2.0)
    force = next(iter(found.schedules.values())).forces[-1]
    axes.set(aspect="equal", xlabel="y [m], stances side by side", ylabel="z [m]")
    axes.axhline(0.0, color="black", linewidth=0.8)
    dress(axes, f"b  Postures: upright, and under {force:g} N")


def _draw_trials(centre: Axes, estimate: Axes, found: Comparison) -> None:
    chosen = [key for key in found.trials if key[1] == "slow"] or list(found.trials)
    centre.set(xlabel="Time [s]", ylabel="y [m]")
    estimate.set(xlabel="Time [s]", ylabel="N")
    if not chosen:
        return
    stance, force = chosen[0][0], max((key[2] for key in chosen if key[0] == chosen[0][0]), key=abs)
    for key, trial in found.trials.items():
        if key[0] == stance and key[1] == "slow" and key[2] == force:
            centre.plot(trial.time, trial.centre[:, 1], color=_COLOURS[key[3]], label=_LABELS[key[3]])
            if key[3] == "filter":
                estimate.plot(trial.time, trial.f_hat, color=_COLOURS[key[3]], label="estimate")
                estimate.plot(trial.time, trial.force, color="black", linestyle="--", label="force")
    for axes in (centre, estimate):
        axes.legend(fontsize="x-small", frameon=False)
    dress(centre, f"c  Centre of mass, {stance} stance, {force:g} N")
    dress(estimate, "d  Force on the hand")


def animate(humanoid: Humanoid, trials: dict[str, Trial], path: str) -> str:
    """Write the beginning of trials side by side as a GIF.

    Parameters
    ----------
    humanoid : Humanoid
    trials : dict
        By caption.
    path : str
        Ends in .gif.

    Returns
    -------
    str
        What drew it: MuJoCo's renderer where there is OpenGL without a screen (EGL), else Matplotlib.
    """
    step = float(humanoid.model.opt.timestep)
    count = round(min(_SHOWN, max(trial.time[-1] for trial in trials.values())) * _FRAMES_PER_SECOND)
    stride = round(1.0 / (_FRAMES_PER_SECOND * step))
    pictures = []
    with contextlib.ExitStack() as stack:
        try:
            image = stack.enter_context(renderer(humanoid.model, (_SIZE, _SIZE), _CAMERA))
            who = "MuJoCo"
        except Exception:  # no driver, no library, no device: each fails in its own way
            who, image = "Matplotlib", partial(_drawn_skeleton, humanoid)
        for k in range(count):
            rows = [trial.q[min(k * stride, len(trial.q) - 1)] for trial in trials.values()]
            pictures.append(np.hstack([image(q) for q in rows]))
    write_gif(path, pictures, milliseconds=1000 // _FRAMES_PER_SECOND)
    return who


def _drawn_skeleton(humanoid: Humanoid, q: FloatArray) -> NDArray[np.uint8]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = Figure(figsize=(_SIZE / 100.0, _SIZE / 100.0), dpi=100)
    axes: Any = figure.add_subplot(projection="3d")
    for line in skeleton(humanoid, q):
        axes.plot(*line.T, color="tab:blue", linewidth=3.0)
    axes.set(xlim=(-0.9, 0.9), ylim=(-0.9, 0.9), zlim=(0.0, 1.8))
    axes.view_init(elev=8.0, azim=0.0)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba(), dtype=np.uint8)[..., :3].copy()
