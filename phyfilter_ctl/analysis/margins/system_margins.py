"""Margins of a loop gain that python-control holds: of L itself, or of a diagram opened at its signals."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import control as ct

from .margins import Margins
from .matrix_search import MatrixSearch
from .scalar_search import MarginSearch, ScalarSearch
from .statespace import StateSpaceLoop

__all__ = ["SystemMargins", "gain_margins"]


@dataclass(frozen=True, eq=False, repr=False)
class SystemMargins(Margins):
    """Margins of a loop gain, or of a diagram at one or several of its signals; made by :func:`phyfilter_ctl.margins`.

    Parameters
    ----------
    signal : str or tuple of str
        "" where L itself was given.
    open_loop : control.StateSpace or None
        L, with the return difference I + L; None where a sampled loop is opened at a signal that acts between the
        instants.
    about : str
        Where a sampled diagram was linearised, whether it is at rest there, and which inputs nothing drives.
    _known : MarginSearch, optional
        What is known beyond L.

    Notes
    -----
    Several signals: gain, phase and delay are common to all of them; modulus and disk margins allow each its own.

    Sampled blocks of several periods: L is lifted over their common period H, and frequencies are known up to multiples
    of 2 pi/H. Gain margins are those of a constant factor on the signal, exact from the eigenvalues over H. A factor
    e^(j phi) is the phase that is meant (it turns two equal axes into each other); modulus and disk margins are taken
    in the norm of lifted signals and allow dynamic factors that change periodically too.
    """

    _figures = ("signal", "about", *Margins._figures)

    signal: str | tuple[str, ...]
    open_loop: ct.StateSpace | None
    about: str = ""
    _known: MarginSearch | None = field(default=None, repr=False)

    @cached_property
    def _search(self) -> MarginSearch:
        if self._known is not None:
            return self._known
        assert self.open_loop is not None
        if self.open_loop.ninputs == 1:
            return ScalarSearch(StateSpaceLoop(self.open_loop))
        return MatrixSearch.of(self.open_loop)

    def _lines(self) -> dict[str, str]:
        return super()._lines() | ({"linearised": self.about} if self.about else {})


def gain_margins(L: ct.StateSpace | ct.TransferFunction) -> SystemMargins:
    """Margins of a loop gain with the return difference I + L; see :func:`phyfilter_ctl.margins`.

    Parameters
    ----------
    L : control.StateSpace or control.TransferFunction
        As many outputs as inputs; continuous or discrete.

    Returns
    -------
    SystemMargins

    Raises
    ------
    ValueError
        If L is not square.

    Notes
    -----
    ``control.disk_margins`` looks at given frequencies and needs slycot for several channels. Here the peak is searched
    for, and mu is bounded from above by min over diagonal D of the largest singular value of D M D^-1, a convex
    problem: that is mu itself for up to three channels (A. Packard, J. Doyle, "The complex structured singular value",
    Automatica 29 (1993)), and a guarantee for more.

    Examples
    --------
    One channel at a time this loop has margins of 90 degrees and more; both together have 21.

    >>> import numpy as np
    >>> P = ct.ss([[0, 10], [-10, 0]], [[1, 0], [0, 1]], [[1, 10], [-10, 1]], 0)
    >>> K = ct.ss([], [], [], [[1, -2], [0, 1]])
    >>> both = gain_margins(P * K).disk
    >>> round(both.alpha, 4), round(float(np.rad2deg(both.phase_margin)), 2)
    (0.3762, 21.3)
    """
    if L.ninputs != L.noutputs:
        raise ValueError(f"L: expected as many outputs as inputs, got {L.noutputs} and {L.ninputs}")
    return SystemMargins("", ct.StateSpace(ct.ss(L), remove_useless_states=False))
