"""What the error of a filter is made of: residual, wrong inertia, noise, side by side or over bandwidth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import control as ct
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from .. import _signals
from .._renamed import former_field
from .._sections import FloatArray
from ..plots.budget import budget_curves, budget_plot
from ..results import PerChannel, Result
from .bounds import ErrorBound
from .frequency import frequency_response
from .variance import Variance

__all__ = ["ErrorBudget", "error_budget"]


@dataclass(frozen=True, eq=False, repr=False)
class ErrorBudget(Result):
    """Parts of the error of m designs; made by :func:`error_budget`.

    Attributes
    ----------
    kind : {"bound", "variance"}
        In which sense.
    names : tuple of str or None
        Of the designs, where they have names.
    bandwidth : (m,) array or None
        Of the designs in rad/s, ascending, where they have no names.
    residual, inertia, noise, implementation : (m,) arrays
        The parts: left of the residual, from the wrong inertia, from the noise of x, from what a sampled filter meets
        as it runs.
    unit : str
        Of f.
    """

    kind: str
    names: tuple[str, ...] | None
    bandwidth: FloatArray | None
    residual: FloatArray
    inertia: FloatArray
    noise: FloatArray
    implementation: FloatArray
    unit: str

    @property
    def prior(self) -> FloatArray:
        """``inertia`` by its name of 0.2."""
        return former_field(self, "prior", "inertia")

    @property
    def total(self) -> FloatArray:
        """Sum of the parts, shape (m,)."""
        return self.residual + self.inertia + self.noise + self.implementation

    @property
    def parts(self) -> dict[str, FloatArray]:
        """The parts by name; those that are 0 for every design are left out, unless all are."""
        names = ("residual", "inertia", "noise", "implementation")
        every = {name: getattr(self, name) for name in names}
        return {name: values for name, values in every.items() if np.any(values)} or every

    def plot(self, *, ax: Axes | None = None, Hz: bool | None = None) -> ct.ControlPlot:
        """Draw stacked bars of named designs, else curves over bandwidth.

        Parameters
        ----------
        ax : Axes, optional
            Where to draw; None makes a new figure.
        Hz : bool, optional
            Bandwidths in Hz; None: python-control's setting ``freqplot.Hz``.

        Returns
        -------
        control.ControlPlot
        """
        unit = self.unit or "unit of f"
        if self.kind == "variance":
            square = f"{unit}$^2$" if unit.isalpha() else f"({unit})$^2$"
            label = f"Variance of $f-\\hat f$ [{square}]"
        else:
            label = f"Bound of $|f-\\hat f|$ [{unit}]"
        label = label.replace("s^2", "s$^2$")
        if self.names is not None:
            return budget_plot(self.parts, self.names, label=label, ax=ax)
        assert self.bandwidth is not None
        return budget_curves(self.parts, self.bandwidth, label=label, ax=ax, Hz=Hz)


def error_budget(
    results: Mapping[str, ErrorBound] | Mapping[str, Variance] | Sequence[ErrorBound] | Sequence[Variance],
    *,
    bandwidth: ArrayLike | None = None,
    unit: str = "",
) -> ErrorBudget:
    """Parts of the error of several designs.

    Parameters
    ----------
    results : mapping of str to, or sequence of, ErrorBound or Variance
        A mapping names the designs, to be compared as bars, as a PerChannel does its channels; a sequence is drawn over
        bandwidth.
    bandwidth : (m,) array_like, optional
        Of the designs in rad/s, for a sequence. None: the -3 dB width of each filter (a Variance does not know its
        filter and needs it).
    unit : str
        Of f, such as "N".

    Returns
    -------
    ErrorBudget
        In the order of the mapping, or from slow to fast.

    Raises
    ------
    TypeError
        If the results are not all ErrorBound or all Variance.
    ValueError
        If there are none, or ``bandwidth`` is missing, of another length, not positive, or given for a mapping.

    Examples
    --------
    >>> from phyfilter_ctl import Bounded, PhyFilter, error_bound
    >>> designs = {f"{w} rad/s": PhyFilter([w]) for w in (10.0, 20.0)}
    >>> bounds = {name: error_bound(f, Bounded({1: 8.0}, noise=0.01)) for name, f in designs.items()}
    >>> budget = error_budget(bounds, unit="N")
    >>> budget.residual.round(6).tolist(), budget.noise.round(6).tolist()
    ([0.8, 0.4], [0.2, 0.4])
    """
    if isinstance(results, PerChannel):
        results = results.by_name
    names = tuple(results) if isinstance(results, Mapping) else None
    found = list(results.values()) if isinstance(results, Mapping) else list(results)
    if not found:
        raise ValueError("results: expected at least one ErrorBound or Variance, got none")
    bounds = [entry for entry in found if isinstance(entry, ErrorBound)]
    variances = [entry for entry in found if isinstance(entry, Variance)]
    if len(found) not in (len(bounds), len(variances)):
        raise TypeError(
            "results: expected all ErrorBound or all Variance, got "
            + ", ".join(type(e).__name__ for e in found)
        )
    if bounds:
        rows = [
            (entry.intrinsic, entry.inertia, entry.noise, sum(entry.implementation.values()))
            for entry in bounds
        ]
    else:
        rows = [(entry.residual_error, 0.0, entry.noise, 0.0) for entry in variances]
    parts, kind = np.array(rows, dtype=float).T, "bound" if bounds else "variance"
    if names is not None:
        if bandwidth is not None:
            raise ValueError(
                "bandwidth: a mapping is compared by its names; give a sequence of results instead"
            )
        return ErrorBudget(kind, names, None, parts[0], parts[1], parts[2], parts[3], unit)
    widths = _widths(bounds, len(found), bandwidth)
    order = np.argsort(widths, kind="stable")
    parts = parts[:, order]
    return ErrorBudget(kind, None, widths[order], parts[0], parts[1], parts[2], parts[3], unit)


def _widths(bounds: Sequence[ErrorBound], count: int, bandwidth: ArrayLike | None) -> FloatArray:
    if bandwidth is None:
        if not bounds:
            raise ValueError(
                "bandwidth: expected those of the designs, since a Variance does not know its filter; or name the "
                "designs by a mapping"
            )
        widths = np.array([frequency_response(entry.system).bandwidth for entry in bounds])
    else:
        widths = _signals.real("bandwidth", bandwidth)
    if widths.shape != (count,):
        raise ValueError(f"bandwidth: expected shape ({count},), one for every result, got {widths.shape}")
    if not np.all(np.isfinite(widths) & (widths > 0.0)):
        raise ValueError(
            f"bandwidth: expected positive finite rad/s, got {widths}; name the designs by a mapping"
        )
    return widths
