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
from phyfilter_ctl.plots import COLOURS, PAGE, dress, letter_panels, typeset

from .around import ANSWERS, HEADINGS, Around
from .limits import PROFILES, Comparison
from .robot import FloatArray, Humanoid
from .trial import Trial

__all__ = ["animate", "draw", "draw_around", "skeleton"]

_COLOURS = {"alone": "#999999", "filter": COLOURS[0]}
_ANSWERS = {"alone": "#999999", "torque": COLOURS[1], "filter": COLOURS[0], "told": COLOURS[2]}
_LABELS = {"alone": "LQR alone", "filter": "with PhyFilter"}
_SIZE = 280  # pixels of a frame's side
_CAPTION = 44  # and of the strip of words above it
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
    figure = Figure(figsize=(PAGE, 6.4), layout="constrained")
    bars, postures, centre, estimate = np.ravel(np.asarray(figure.subplots(2, 2), dtype=object))
    _draw_limits(bars, found)
    _draw_postures(postures, found)
    _draw_trials(centre, estimate, found)
    letter_panels(figure)
    return figure


def draw_around(found: Around) -> Figure:
    """Held forces by heading, one polar diagram for each place and profile.

    Parameters
    ----------
    found : Around
    """
    grips = list(dict.fromkeys(grip for grip, _ in found.tipping))
    profiles = list(dict.fromkeys(each.profile for each in found.held))
    figure = Figure(figsize=(4.2 * len(profiles), 4.0 * len(grips) + 0.6), layout="constrained")
    names = list(dict.fromkeys(name for _, name in found.tipping))
    turn = np.radians([HEADINGS[name] for name in names])
    for k, (grip, profile) in enumerate((grip, profile) for grip in grips for profile in profiles):
        axes: Any = figure.add_subplot(len(grips), len(profiles), k + 1, projection="polar")
        axes.set_theta_zero_location("N")
        tips = [found.tipping[grip, name] for name in names]
        axes.plot(_closed(turn), _closed(tips), color="black", linestyle="--", label="tips, as if rigid")
        for mode, answer in ANSWERS.items():
            row = found.row(grip, profile, mode)
            axes.plot(
                _closed(turn),
                _closed([each.force for each in row]),
                color=_ANSWERS[mode],
                marker="o",
                markersize=3,
                label=typeset(answer),
            )
            capped = [(turn[names.index(each.heading)], each.force) for each in row if each.capped]
            if capped:
                axes.plot(*zip(*capped, strict=True), "*", color=_ANSWERS[mode], markersize=9)
        axes.set_xticks(turn, names)
        axes.set_rlabel_position(22.5)  # between two headings
        axes.tick_params(labelsize="x-small")
        axes.set_title(
            f"{grip.capitalize()}, {profile} force [N]", loc="left", fontsize="small", fontweight="bold"
        )
    first: Any = figure.axes[0]
    if any(each.capped for each in found.held):
        first.plot([], [], "*", color="0.3", markersize=9, label="held, largest tried")
    handles, labels = first.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize="x-small", frameon=False)
    letter_panels(figure)
    return figure


def _closed(values: ArrayLike) -> FloatArray:
    array = np.asarray(values, dtype=float)
    return np.append(array, array[0])


def _draw_limits(axes: Axes, found: Comparison) -> None:
    width, names = 0.2, list(found.schedules)
    for i, profile in enumerate(PROFILES):
        for j, mode in enumerate(("alone", "filter")):
            limits = [
                min((found.limit(n, profile, d, mode) for d in (1.0, -1.0)), key=lambda each: each.force)
                for n in names
            ]
            place = np.arange(len(names)) + (2 * i + j - 1.5) * width
            for x, each in zip(place, limits, strict=True):
                at_least = f"\u2265 {each.force:g}" if each.capped else ""
                axes.annotate(
                    at_least,
                    (x, each.force),
                    (0, 2),
                    textcoords="offset points",
                    fontsize="x-small",
                    ha="center",
                )
            axes.bar(
                place,
                [each.force for each in limits],
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
    axes.set_ylabel("Held in both directions [N]")
    axes.set_ylim(0.0, 1.6 * axes.get_ylim()[1])  # room for the legend
    axes.legend(fontsize="x-small", frameon=False, loc="upper left", ncols=1)
    dress(axes, "Largest force on the right hand")


def _draw_postures(axes: Axes, found: Comparison) -> None:
    for k, points in enumerate(found.schedules.values()):
        for point, colour in ((points.upright, _COLOURS["alone"]), (points.points[-1], _COLOURS["filter"])):
            for line in skeleton(found.humanoid, point.q):
                axes.plot(line[:, 1] + 1.8 * k, line[:, 2], color=colour, linewidth=2.0)
    force = next(iter(found.schedules.values())).forces[-1]
    axes.set(aspect="equal", xlabel="y [m], stances side by side", ylabel="z [m]")
    axes.axhline(0.0, color="black", linewidth=0.8)
    dress(axes, f"Postures: upright, and under {force:g} N")


def _draw_trials(centre: Axes, estimate: Axes, found: Comparison) -> None:
    centre.set(xlabel="Time [s]", ylabel="y [m]")
    estimate.set(xlabel="Time [s]", ylabel="Force [N]")
    slow = [
        (stance, force)
        for stance, profile, force, mode in found.trials
        if (profile, mode) == ("slow", "filter")
    ]
    if not slow:
        return
    held = [(s, f) for s, f in slow if found.trials[s, "slow", f, "filter"].held]
    tells = [
        (s, f) for s, f in held if not found.trials[s, "slow", f, "alone"].held
    ]  # where the filter decides
    stance, force = max(tells or held or slow, key=lambda each: abs(each[1]))
    for mode, label in _LABELS.items():
        trial = found.trials[stance, "slow", force, "filter" if mode == "filter" else "alone"]
        shown = trial.time <= _SHOWN
        centre.plot(trial.time[shown], trial.centre[shown, 1], color=_COLOURS[mode], label=label)
        if mode == "filter":
            estimate.plot(trial.time[shown], trial.f_hat[shown], color=_COLOURS[mode], label="estimate")
            estimate.plot(trial.time[shown], trial.force[shown], color="black", linestyle="--", label="force")
    for axes in (centre, estimate):
        axes.legend(fontsize="x-small", frameon=False)
    dress(centre, f"Centre of mass, {stance} stance, {force:g} N")
    dress(estimate, "Force on the hand")


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
    from PIL import Image, ImageDraw, ImageFont

    def captioned(pixels: NDArray[np.uint8], caption: str, time: float) -> NDArray[np.uint8]:
        # Above the picture: whatever the sky, the words can be read.
        shown = Image.new("RGB", (pixels.shape[1], pixels.shape[0] + _CAPTION), "white")
        shown.paste(Image.fromarray(pixels), (0, _CAPTION))
        ImageDraw.Draw(shown).text((8, 4), f"{caption}\n{time:.1f} s", "black", ImageFont.load_default(16))
        return np.asarray(shown)

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
            rows = {name: min(k * stride, len(trial.q) - 1) for name, trial in trials.items()}
            pictures.append(
                np.hstack([captioned(image(trials[name].q[i]), name, i * step) for name, i in rows.items()])
            )
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
