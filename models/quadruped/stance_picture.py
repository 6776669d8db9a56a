"""The picture of the standing robot: the controller that a filter makes, and how the trunk gives way."""

from __future__ import annotations

from collections.abc import Sequence

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray

from phyfilter_ctl.analysis import frequency_response
from phyfilter_ctl.plots import COLOURS, PAGE, dress, letter_panels, typeset

from .params import params
from .stance import CASES, Case, closed, controller, linearized, pid

__all__ = ["draw"]

FloatArray = NDArray[np.float64]

_OMEGA = np.geomspace(0.05, 60.0, 300)
# The hip of the first leg: it carries most.
_JOINT = 1
_AXES = {"sag": (2, 2), "roll": (3, 1)}


def draw(cases: Sequence[Case] | None = None, *, plant: ct.StateSpace | None = None) -> Figure:
    """Draw torque over angle of a hip, and what a force on the trunk does.

    Parameters
    ----------
    cases : sequence of Case, optional
        That stand; None: those of ``CASES`` with the vendor's gains that do.
    plant : control.StateSpace, optional
        Of :func:`linearized`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    plant = linearized() if plant is None else plant
    kp = params().control.kp
    chosen = (
        [case for case in CASES if case.kp == kp and case.name != "vendor, a0 = 5"]
        if cases is None
        else cases
    )
    figure = Figure(figsize=(PAGE, 3.2), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for case, colour in zip(chosen, COLOURS, strict=False):
        name = case.name.partition(", ")[2] or case.name
        left.loglog(_OMEGA, np.abs(_torque(case)), color=colour, label=typeset(name))
        response = np.abs(np.asarray(frequency_response(closed(case, plant), _OMEGA).frdata))
        for axis, key, scale in ((middle, "sag", 1e3), (right, "roll", 1e3)):
            axis.loglog(_OMEGA, scale * response[*_AXES[key]], color=colour, label=typeset(name))
        if case.filter is not None and case.filter.order == 1 and case.filter.type == 1:
            at = _OMEGA[::25]
            left.loglog(at, np.abs(pid(case, at, _JOINT)), "o", color=colour, ms=3, mfc="none")
    left.plot([], [], "o", color="0.4", ms=3, mfc="none", label="PID of the formula")
    _finish(left, "Hip torque over angle", "N m/rad")
    _finish(middle, "The trunk under a load", "mm/N")
    _finish(right, "Roll for a lateral force", "mrad/N")
    left.legend(frameon=False, fontsize="x-small")
    letter_panels(figure)
    return figure


def _torque(case: Case) -> NDArray[np.complex128]:
    """Torque over -q of one joint alone, with q' = s q."""
    K = controller(case)
    s = 1j * _OMEGA
    found = np.asarray(frequency_response(K, _OMEGA).frdata)
    return -(found[_JOINT, _JOINT] + s * found[_JOINT, 12 + _JOINT])


def _finish(axis: Axes, title: str, unit: str) -> None:
    axis.set(xlabel="Frequency [rad/s]", ylabel=f"Magnitude [{unit}]")
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())
    dress(axis, title)
