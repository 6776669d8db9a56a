"""An independent solver: hybrid systems given mode by mode, smooth within each, integrated by SciPy.

It shares nothing with the package: a system is written down here a second time by hand, as its modes, their smooth
rates and what ends them. Nothing is traced, and no switch is read off a function of NumPy. On a switching surface that
attracts from both sides the rates are Filippov's: those of the equivalent control, which keeps the state on the
surface, until that control is beyond its bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import DOP853, Radau
from scipy.optimize import brentq

Array = NDArray[np.float64]
Mode = Hashable
SOLVERS = {"DOP853": DOP853, "Radau": Radau}
# Tolerances of SciPy's solvers, a thousandth and less of those asked of the package.
RTOL, ATOL = 1e-11, 1e-13
# Places of a step at which guards are looked at; steps are a hundredth of the run at most.
LOOKS, SHORTEST_RUN_IN_STEPS = 16, 100.0
# A guard that is above this at the start of a mode has been passed by a jump.
PASSED = 1e-10
# Changes of mode in a run; more are a mistake in the modes.
MOST_CHANGES = 20_000


class Exit(NamedTuple):
    """The end of a mode: where ``guard`` comes above 0.

    Parameters
    ----------
    guard : callable
        (t, x) -> number.
    to : mode or callable
        What follows, or (t, x) -> what follows, from the state after the reset.
    reset : callable, optional
        (t, x) -> state afterwards.
    """

    guard: Callable[[float, Array], float]
    to: Any
    reset: Callable[[float, Array], ArrayLike] | None = None


@dataclass(frozen=True)
class Hybrid:
    """A system by its modes.

    Parameters
    ----------
    rates : callable
        (t, x, mode) -> x'.
    exits : callable
        mode -> its exits.
    start : callable
        (t, x) -> mode, at the start and after an instant.
    outputs : callable, optional
        (t, x, mode) -> outputs; None: the states.
    instants : sequence of (period, update)
        Every so many seconds, from the start on, x becomes update(t, x).
    solver : {"DOP853", "Radau"}
    """

    rates: Callable[[float, Array, Any], ArrayLike]
    exits: Callable[[Any], Sequence[Exit]] = field(default=lambda mode: ())
    start: Callable[[float, Array], Any] = field(default=lambda t, x: "")
    outputs: Callable[[float, Array, Any], ArrayLike] | None = None
    instants: Sequence[tuple[float, Callable[[float, Array], ArrayLike]]] = ()
    solver: str = "DOP853"

    def __call__(self, times: Array, x0: ArrayLike) -> Array:
        """Outputs (n_y, N) at the times."""
        return _Run(self, np.asarray(times, dtype=float), np.array(x0, dtype=float)).outputs()


class _Run:
    def __init__(self, system: Hybrid, times: Array, x: Array) -> None:
        self.system, self.times, self.x = system, times, x
        self.t = float(times[0])
        self.rows: list[Array] = []
        self.changes = 0
        self.mode: Any = None

    def outputs(self) -> Array:
        for end in self._ends():
            self._instant()
            self._integrate(end)
        self._instant()
        self._record_until(self.t, None)
        assert len(self.rows) == len(self.times)
        return np.array(self.rows).T

    def _ends(self) -> list[float]:
        start, end = self.times[0], self.times[-1]
        found = {float(end)}
        for period, _ in self.system.instants:
            found |= {float(start + k * period) for k in range(1, int((end - start) / period + 1e-9) + 1)}
        if self.system.solver == "Radau":  # whose dense output is of third order only
            found |= {float(time) for time in self.times[1:]}
        ends: list[float] = []
        for time in sorted(found):
            if not ends or time - ends[-1] > 1e-9 * (end - start):
                ends.append(time)
        return ends

    def _instant(self) -> None:
        """What happens at this time: updates, then the mode that they lead to."""
        since = self.t - self.times[0]
        updated = self.mode is None
        for period, update in self.system.instants:
            if abs(since / period - round(since / period)) < 1e-6:
                self.x = np.array(update(self.t, self.x), dtype=float)
                updated = True
        if updated:
            self.mode = self.system.start(self.t, self.x)
            self._settle()

    def _settle(self) -> None:
        """Leave modes whose guards have been passed by a jump."""
        while True:
            passed = [e for e in self.system.exits(self.mode) if e.guard(self.t, self.x) > PASSED]
            if not passed:
                return
            self._change(passed[0])

    def _change(self, leaving: Exit) -> None:
        self.changes += 1
        if self.changes > MOST_CHANGES:
            raise RuntimeError(f"the reference changes its mode without end at t = {self.t}")
        if leaving.reset is not None:
            self.x = np.array(leaving.reset(self.t, self.x), dtype=float)
        self.mode = leaving.to(self.t, self.x) if callable(leaving.to) else leaving.to

    def _integrate(self, end: float) -> None:
        while self.t < end:
            mode = self.mode
            solver = SOLVERS[self.system.solver](
                lambda t, x, mode=mode: np.asarray(self.system.rates(t, x, mode), dtype=float),
                self.t, self.x, end, rtol=RTOL, atol=ATOL,
                max_step=(self.times[-1] - self.times[0]) / SHORTEST_RUN_IN_STEPS,
            )  # fmt: skip
            exits = self.system.exits(mode)
            # Where the mode begins on a guard, rounding alone is not to end it.
            offsets = [PASSED if abs(e.guard(self.t, self.x)) < PASSED else 0.0 for e in exits]
            while solver.status == "running" and self.mode == mode:
                message = solver.step()
                if solver.status == "failed":
                    raise RuntimeError(f"the reference fails at t = {solver.t}: {message}")
                dense = solver.dense_output()
                found = _first(exits, offsets, dense, solver.t_old, solver.t)
                if found is None:
                    self._record_until(solver.t, dense)
                    self.t, self.x = float(solver.t), solver.y.copy()
                    continue
                self.t, leaving = found
                self._record_until(self.t, dense)
                self.x = dense(self.t)
                self._change(leaving)
                self._settle()
                break

    def _record_until(self, t: float, dense: Callable[[float], Array] | None) -> None:
        """Outputs at times before t (with dense), or up to it."""
        while len(self.rows) < len(self.times):
            time = self.times[len(self.rows)]
            if time > t or (dense is not None and time >= t):
                return
            x = self.x if dense is None else dense(time)
            output = self.system.outputs
            self.rows.append(
                np.asarray(x if output is None else output(time, x, self.mode), dtype=float).ravel()
            )


def _first(
    exits: Sequence[Exit], offsets: list[float], dense: Callable[[Any], Array], begin: float, end: float
) -> tuple[float, Exit] | None:
    """The first exit inside a step and its time; ``offsets`` are cleared where a guard has left its zero."""
    if not exits:
        return None
    places = np.linspace(begin, end, LOOKS + 1)
    states = dense(places).T
    best: tuple[float, Exit] | None = None
    for i, leaving in enumerate(exits):
        values = [leaving.guard(time, x) for time, x in zip(places, states, strict=True)]
        for k in range(LOOKS):
            if values[k] < -PASSED:
                offsets[i] = 0.0
            if values[k] <= offsets[i] < values[k + 1]:
                time = _root(leaving.guard, offsets[i], dense, places[k], places[k + 1])
                if best is None or time < best[0]:
                    best = time, leaving
                break
    return best


def _root(
    guard: Callable[[float, Array], float],
    offset: float,
    dense: Callable[[float], Array],
    low: float,
    high: float,
) -> float:
    if guard(low, dense(low)) >= offset:
        return float(low)
    return float(brentq(lambda time: guard(time, dense(time)) - offset, low, high, xtol=1e-15, rtol=1e-14))


def smooth(rates: Callable[[float, Array], ArrayLike], **options: Any) -> Hybrid:
    """A system of one mode."""
    return Hybrid(lambda t, x, mode: rates(t, x), **options)


def switched(
    surface: Callable[[float, Array], float],
    above: Callable[[float, Array], ArrayLike],
    below: Callable[[float, Array], ArrayLike],
    **options: Any,
) -> Hybrid:
    """Two modes on the two sides of a surface that is crossed."""
    exits = {
        True: (Exit(lambda t, x: -surface(t, x), False),),
        False: (Exit(surface, True),),
    }
    return Hybrid(
        lambda t, x, mode: above(t, x) if mode else below(t, x),
        exits.__getitem__,
        lambda t, x: surface(t, x) >= 0.0,
        **options,
    )


def filippov(
    rates: Callable[[float, Array, Array], ArrayLike],
    surfaces: Callable[[float, Array], Sequence[float]],
    surface_rates: Callable[[float, Array, Array], Sequence[float]],
    outputs: Callable[[float, Array, Array], ArrayLike] | None = None,
    **options: Any,
) -> Hybrid:
    """A system with signs s_i of surfaces in its rates, that slides or sticks where they attract.

    Parameters
    ----------
    rates : callable
        (t, x, s) -> x', affine in s.
    surfaces : callable
        (t, x) -> what the signs are of.
    surface_rates : callable
        (t, x, s) -> their derivatives along the rates, affine in s.
    outputs : callable, optional
        (t, x, s) -> outputs.

    Returns
    -------
    Hybrid
        A mode is a tuple of +1, -1, or 0 where it slides.
    """

    def signs(t: float, x: Array, mode: tuple[int, ...]) -> Array:
        s = np.array(mode, dtype=float)
        sliding = [i for i, side in enumerate(mode) if side == 0]
        if sliding:
            base = np.asarray(surface_rates(t, x, s), dtype=float)[sliding]
            columns = []
            for i in sliding:
                one = s.copy()
                one[i] = 1.0
                columns.append(np.asarray(surface_rates(t, x, one), dtype=float)[sliding] - base)
            s[sliding] = np.linalg.solve(np.array(columns).T, -base)
        return s

    def decided(t: float, x: Array, mode: tuple[int, ...], i: int, beyond: int) -> tuple[int, ...]:
        sticks, one = (*mode[:i], 0, *mode[i + 1 :]), (*mode[:i], 1, *mode[i + 1 :])
        without, with_it = (surface_rates(t, x, np.array(m, dtype=float))[i] for m in (sticks, one))
        if without == with_it:  # the sign does not act on its surface at once: it is crossed
            return (*mode[:i], beyond or int(np.sign(without)), *mode[i + 1 :])
        value = signs(t, x, sticks)[i]
        return sticks if abs(value) <= 1.0 else (*mode[:i], beyond or int(np.sign(value)), *mode[i + 1 :])

    def start(t: float, x: Array) -> tuple[int, ...]:
        values = np.asarray(surfaces(t, x), dtype=float)
        mode = tuple(0 if abs(value) < PASSED else int(np.sign(value)) for value in values)
        for i, side in enumerate(mode):
            if side == 0:
                mode = decided(t, x, mode, i, 0)
        return mode

    def exits(mode: tuple[int, ...]) -> list[Exit]:
        found = []
        for i, side in enumerate(mode):
            if side:
                found.append(
                    Exit(
                        lambda t, x, i=i, side=side: -side * surfaces(t, x)[i],
                        lambda t, x, i=i, side=side: decided(t, x, mode, i, -side),
                    )
                )
            else:
                found += [
                    Exit(
                        lambda t, x, i=i, way=way: way * signs(t, x, mode)[i] - 1.0,
                        (*mode[:i], way, *mode[i + 1 :]),
                    )
                    for way in (1, -1)
                ]
        return found

    return Hybrid(
        lambda t, x, mode: rates(t, x, signs(t, x, mode)),
        exits,
        start,
        None if outputs is None else lambda t, x, mode: outputs(t, x, signs(t, x, mode)),
        **options,
    )


def stepped(
    value: Callable[[float, Array], float], rates: Callable[[float, Array, int], ArrayLike], **options: Any
) -> Hybrid:
    """A mode for each whole number k with k <= value < k + 1."""

    def exits(k: int) -> tuple[Exit, Exit]:
        return Exit(lambda t, x: value(t, x) - k - 1, k + 1), Exit(lambda t, x: k - value(t, x), k - 1)

    return Hybrid(rates, exits, lambda t, x: int(np.floor(value(t, x) + PASSED)), **options)


def relay(
    value: Callable[[float, Array], float],
    low: float,
    high: float,
    rates: Callable[[float, Array, int], ArrayLike],
    begin: Callable[[Array], int],
    **options: Any,
) -> Hybrid:
    """Hysteresis: mode 1 from where the value comes above ``high``, -1 from where it falls below ``low``."""
    exits = {1: (Exit(lambda t, x: low - value(t, x), -1),), -1: (Exit(lambda t, x: value(t, x) - high, 1),)}
    return Hybrid(rates, exits.__getitem__, lambda t, x: begin(x), **options)


def scheduled(
    switches: Sequence[float], rates: Callable[[float, Array, int], ArrayLike], **options: Any
) -> Hybrid:
    """Rates that change at times known beforehand: mode k from the k-th on."""

    def exits(k: int) -> tuple[Exit, ...]:
        return (Exit(lambda t, x: t - switches[k], k + 1),) if k < len(switches) else ()

    def start(t: float, x: Array) -> int:
        return int(np.searchsorted(switches, t + PASSED))

    return Hybrid(rates, exits, start, **options)
