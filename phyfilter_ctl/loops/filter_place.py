"""The place of a filter in a diagram, and the margins of that diagram for every filter that might stand there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .._sections import ComplexArray, FloatArray
from ..analysis import Surroundings, SystemMargins
from ..filter import PhyFilter, SampledPhyFilter
from .margins import signal_margins
from .sampled_loop import opened_loop

__all__ = ["FilterPlace"]

# Rate over the sampling rate of the filter that stands in the place while the rest is looked at.
_RATE = 0.1
# Eigenvalues below it are delays, which have no corner.
_DELAY = 1e-12


@dataclass(frozen=True, eq=False)
class FilterPlace:
    """Where a filter stands in a diagram; ``LoopGoal(margins=...)`` takes it.

    Called with a filter it gives :func:`~phyfilter_ctl.margins` of the diagram with that filter. A search tries
    hundreds: the diagram is linearised once, with the loop opened at the signal and behind the filter, and from there
    on the filter is a number at every frequency, with exact slopes.

    Parameters
    ----------
    diagram : callable
        SampledPhyFilter -> control.InterconnectedSystem, the diagram with this filter in it.
    signal : str
        ``block.signal`` at which margins are taken, the command for instance.
    output : str
        ``block.signal`` of the filter's f_hat. The filter is of one channel; f_theta does not depend on the loop.
    u0, settle, params
        As for :func:`~phyfilter_ctl.margins`.

    Notes
    -----
    With F0 in the place and the loop opened at the signal and at f_hat, [[l11, l12], [l21, l22]] is the loop gain.
    The second row is F0 times what the filter measures, so that with F

        Q = 1 + F l22/F0,    P = l11 Q - F l12 l21/F0,    L = P/Q.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> from phyfilter_ctl.blocks import phyfilter_block, sampled_block, wired
    >>> body = ct.ss([[0.0, 0.0], [1.0, 0.0]], [[1.0], [0.0]], np.eye(2), np.zeros((2, 1)),
    ...              inputs="u", outputs=["x", "p"], name="body")
    >>> law = sampled_block(ct.ss([], [], [], [[-6.0, -10.0, -1.0]], dt=0.01,
    ...                     inputs=["x", "p", "f_hat"], outputs="u", name="law"))
    >>> def diagram(filter):
    ...     block = sampled_block(phyfilter_block(filter, 1, name="filter"))
    ...     return wired([block, law, body], {"body.u": "law.u", "filter.x[0]": "body.x", "filter.g[0]": "law.u",
    ...                  "law.x": "body.x", "law.p": "body.p", "law.f_hat": "filter.f_hat[0]"},
    ...                  outputs={"x": "body.x"})
    >>> place = FilterPlace(diagram, "body.u", "filter.f_hat[0]")
    >>> round(place(PhyFilter([20.0]).sampled(0.01)).modulus_margin, 3)
    0.882
    """

    diagram: Callable[[SampledPhyFilter], ct.InputOutputSystem]
    signal: str
    output: str
    u0: ArrayLike | None = None
    settle: float = 0.0
    params: Mapping[str, ArrayLike] | None = None
    _known: dict[object, _Opened] = field(init=False, default_factory=dict, repr=False)

    def __call__(self, filter: SampledPhyFilter) -> SystemMargins:
        """Margins of the diagram with a filter.

        Parameters
        ----------
        filter : SampledPhyFilter

        Returns
        -------
        SystemMargins
        """
        return signal_margins(
            self.diagram(filter), self.signal, u0=self.u0, settle=self.settle, params=self.params
        )

    def loop(self, filter: SampledPhyFilter) -> Surroundings:
        """What is around the filter, for all filters of its sampling.

        Parameters
        ----------
        filter : SampledPhyFilter

        Returns
        -------
        Surroundings

        Raises
        ------
        ValueError
            If the loop is not read and driven at the filter's instants alone, and what
            :func:`~phyfilter_ctl.sampled_open_loop` raises.
        """
        if filter.sampling not in self._known:
            self._known[filter.sampling] = self._opened(filter)
        return self._known[filter.sampling]

    def _opened(self, filter: SampledPhyFilter) -> _Opened:
        some = SampledPhyFilter(PhyFilter([_RATE / filter.dt]), filter.sampling)
        found = opened_loop(
            self.diagram(some), [self.signal, self.output], None, self.u0, self.settle, self.params
        )
        if found.kind == "between" or len(found.grid) != 1 or abs(found.gain.dt / filter.dt - 1.0) > 1e-9:
            raise ValueError(
                f"{self.signal}, {self.output}: expected signals that change or are read once a step of {filter.dt:g} "
                "s, the filter's; take margins by a function of the filter instead, which knows periods and continuous "
                "signals: margins=lambda f: margins(diagram(f), at=signal)"
            )
        return _Opened(found.gain, some)


@dataclass(frozen=True, eq=False)
class _Opened:
    """A diagram opened at a signal and behind its filter: ``Surroundings`` of ``analysis.margins.slopes``."""

    gain: ct.StateSpace
    filter: SampledPhyFilter

    @property
    def dt(self) -> float:
        return self.filter.dt

    @cached_property
    def _parts(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        A, B, C, D = (np.asarray(part, dtype=float) for part in ct.ssdata(self.gain))
        return A, B, C, D

    @property
    def corners(self) -> ComplexArray:
        """Poles of what is around the filter."""
        z = np.linalg.eigvals(self._parts[0]).astype(np.complex128)
        return np.asarray(np.log(z[np.abs(z) > _DELAY]) / self.dt, dtype=np.complex128)

    @property
    def late(self) -> float:
        """Its delays are states of it."""
        return len(self._parts[0]) * self.dt

    @cached_property
    def _first_order(self) -> tuple[float, float]:
        """alpha and beta of w_k = alpha w_(k-1) + beta u_k in the place."""
        dA, equilibrium, C = self.filter.transition
        return 1.0 + float(dA[0, 0]), float(C[0] * (-dA @ equilibrium)[0])

    def surroundings(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """See ``Surroundings``."""
        A, B, C, D = self._parts
        z = np.exp(1j * omega * self.dt)
        drives = np.tile(B.astype(np.complex128), (len(z), 1, 1))
        states = np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, drives)
        L = np.asarray(C @ states + D, dtype=np.complex128)
        alpha, beta = self._first_order
        back = (1.0 - alpha / z) / beta  # 1/F0
        missing = -1.0 - back * L[:, 1, 1]
        through = back * (L[:, 0, 0] * L[:, 1, 1] - L[:, 0, 1] * L[:, 1, 0])
        return missing.astype(np.complex128), through.astype(np.complex128), L[:, 0, 0].copy()

    def is_stable(self, filter: SampledPhyFilter) -> bool:
        """Whether all eigenvalues with the filter are inside the circle; F0 and its inverse leave modes at 0 and its
        pole."""
        A, B, C, D = self._parts
        alpha, beta = self._first_order
        dA, equilibrium, row = filter.transition
        n, m = len(A), len(dA)
        into = -dA @ equilibrium
        size = n + 1 + m
        unit = np.eye(size)
        # Signals in terms of the states [x; F0's last answer; w] and of what the open ends are given.
        first, second = C @ unit[:n]
        measured = (second - alpha * unit[n]) / beta
        given = D[1] / beta
        held = row @ (np.eye(m) + dA) @ unit[n + 1 :] + (row @ into) * measured
        ends = np.stack([first, held])
        direct = np.stack([D[0], (row @ into) * given])
        closed = -np.linalg.solve(np.eye(2) + direct, ends)
        step = np.zeros((size, size))
        step[:n] = A @ unit[:n] + B @ closed
        step[n] = second + D[1] @ closed
        step[n + 1 :] = (np.eye(m) + dA) @ unit[n + 1 :] + np.outer(into, measured + given @ closed)
        return bool(np.all(np.abs(np.linalg.eigvals(step)) < 1.0))
