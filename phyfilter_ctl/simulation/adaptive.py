"""Integration with error control, from one discontinuity to the next: explicit, for stiff diagrams, or as measured."""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..diagram import FlatModel
from ..diagram.fixed_step import rates
from .chains import BASE, LEVELS, Call, Chain
from .dormand_prince import dormand_prince
from .events import EndlessEventsError, EventWatch, RunEndedError
from .limits import LOOKED_AT, Budget, chattering
from .pair import Pair, sizes
from .rosenbrock import rosenbrock
from .steps import KEPT, SYMBOLS, Layout, Results, at_node, compose, cut, kinds_of, renewed

__all__ = ["Control", "Integrator", "Leaps", "StepError"]

Control = Literal["adaptive", "stiff", "auto"]

# Accepted steps between two looks at where a run is going, and looks in a row that must say it goes nowhere: it would
# take so many times the steps that are left.
_FORESEEN_AFTER, _DOUBTS, _HOPELESS = 512, 4, 10.0
# Accepted steps between two measurements of stiffness, and the h abs(lambda) of a decaying mode at which stability and
# not accuracy bounds an explicit step (Dormand and Prince's 8(5,3) pair is stable up to about 6 on the real axis). Two
# in a row make a diagram stiff.
_MEASURED_AFTER, _STIFF = 25, 3.5
# The largest h abs(lambda) of steps whose inside is wanted to the tolerance.
_INSIDE = 5.0
_TIME_ROUNDING, _LEAST_STEP = 10 * np.finfo(float).eps, 1e-250


class StepError(Exception):
    """The step became too small, or the derivative is not finite.

    Parameters
    ----------
    message : str
    time : float
        Where, in seconds.
    inside : (k, n_x) array
        States at the times before.
    advice : str, optional
        What to try; None leaves it to who knows more. The message then lacks the time.
    """

    def __init__(self, message: str, time: float, inside: FloatArray, advice: str | None = None) -> None:
        super().__init__(f"{message} at t = {time:.9g} s" if advice is None else message)
        self.advice = advice
        self.time = time
        self.inside = inside


@lru_cache(maxsize=KEPT)
def _renewed(flat: FlatModel) -> ca.Function:
    return compose(
        "pf_renewed",
        sizes(flat),
        lambda x, q, u, rate, p, z: (renewed(flat, q[0], x, u, p, z),),
        kinds_of(flat),
    )


@lru_cache(maxsize=KEPT)
def _dense(flat: FlatModel) -> ca.Function:
    """(t, x, u, p, z) -> x' with its zeros."""
    if flat.dynamics.sparsity_out(0).is_dense():
        return flat.dynamics
    lengths = [flat.dynamics.size1_in(i) for i in range(5)]
    return compose("pf_slope", lengths, lambda t, x, u, p, z: (flat.dynamics(t, x, u, p, z),))


class Integrator:
    """Integrates the continuous part from one discontinuity to the next, keeping its step length.

    Parameters
    ----------
    flat : FlatModel
    p : (n_p,) array
    limits : Budget
    control : {"adaptive", "stiff", "auto"}
        Dormand and Prince's explicit pair, the Rosenbrock pair, or the first until the diagram proves stiff.
    rtol, atol : float
        Error of a step and inside it, root mean square over the states of error / (atol + rtol abs(x)), below 1.
    max_step : float, optional
        Longest step in seconds.
    until : float
        Where the whole run ends, in seconds.
    """

    def __init__(
        self,
        flat: FlatModel,
        p: FloatArray,
        limits: Budget,
        *,
        control: Control = "adaptive",
        rtol: float,
        atol: float,
        max_step: float | None = None,
        until: float = np.inf,
    ) -> None:
        n_x, n_u = len(flat.states), len(flat.inputs)
        self._flat, self._limits, self._until = flat, limits, until
        self._tolerance = np.array([rtol, atol])
        self._x, self._q = np.zeros(n_x), np.zeros(4)
        self._u, self._rate = np.zeros(n_u), np.zeros(n_u)
        self._z, self._first = np.zeros(len(flat.held)), np.zeros(n_x)
        self._given = [self._x, self._q, self._u, self._rate, np.array(p, dtype=float), self._z]
        t, p = self._q[:1], self._given[4]
        self._slope = Call(_dense(flat), [t, self._x, self._u, p, self._z])
        self._renewed = None if flat.unknowns is None else Call(_renewed(flat), self._given)
        self._max_step = np.inf if max_step is None else max_step
        self._h, self._accepted = 0.0, 0
        self._slopes, self._counts = np.full((LOOKED_AT, n_x), np.nan), np.zeros(LOOKED_AT, dtype=np.int64)
        self._mark, self._doubts = (0.0, 0), 0
        self._logged, self._busy = 0, ""
        self._undecided, self._stiff = control == "auto", 0
        # An explicit method that was asked for: how long its steps may be for the polynomial inside.
        self._bounded, self._longest = control == "adaptive" and not flat.callbacks, np.inf
        self.steps: int = 0
        # z at the times inside the last interval
        self.held_inside: FloatArray = np.zeros((0, len(flat.held)))
        self.watch: EventWatch | None = EventWatch(flat, self._given, self._renew) if flat.events else None
        # Blocks that keep something beside x have outputs of their own time only: y at the times inside.
        self.outputs_inside: FloatArray | None = np.zeros((0, len(flat.outputs))) if flat.memories else None
        self._use(rosenbrock(flat) if control == "stiff" else dormand_prince(flat))

    def _use(self, pair: Pair) -> None:
        self.pair = pair
        self._q[2:] = pair.inside * self._tolerance
        self._trial = Call(pair.trial, [*self._given, self._first])
        self._dense: Call | None = None

    @property
    def longest(self) -> float:
        """Of the steps, in seconds."""
        return self._max_step

    @property
    def tolerance(self) -> FloatArray:
        """rtol and atol that a step gets."""
        return self._q[2:].copy()

    def spent(self, steps: int) -> bool:
        """Counts steps that are made elsewhere; False where they may not be made."""
        if steps > self._limits.left or self._limits.spend(steps):
            return False
        self.steps += steps
        return True

    @property
    def chattering(self) -> str:
        """What chatters, by the events and the derivatives after the last accepted steps; "" for nothing."""
        if self._busy:
            return self._busy
        newest, oldest = (
            self._counts[(self._accepted - 1) % LOOKED_AT],
            self._counts[self._accepted % LOOKED_AT],
        )
        return chattering(self._flat, np.roll(self._slopes, -self._accepted, axis=0), int(newest - oldest))

    def _note(self, t: float) -> bool:
        """Keeps what the accepted step tells of chattering; whether that will outlast the run's limits."""
        place = self._accepted % LOOKED_AT
        self._slopes[place], self._counts[place] = self._first, self.steps
        self._accepted += 1
        if self._accepted % _FORESEEN_AFTER:
            return False
        (since, count), self._mark = self._mark, (t, self.steps)
        needed = (self.steps - count) * (self._until - t) / max(t - since, 1e-300)
        events = [] if self.watch is None else self.watch.log[self._logged :]
        self._logged += len(events)
        self._busy = ""
        if 2 * len(events) > _FORESEEN_AFTER:
            names = ", ".join(dict.fromkeys(name for _, name in events))
            self._busy = (
                f"{len(events)} of the last {_FORESEEN_AFTER} steps were cut short by {names}: a switch that chatters. "
                "Give it hysteresis, or sample it"
            )
        hopeless = needed > _HOPELESS * self._limits.left and self.chattering
        self._doubts = self._doubts + 1 if hopeless else 0
        return self._doubts >= _DOUBTS

    def _bound(self) -> None:
        """Keeps steps where the method is stable: beside a mode that has died out the end of a longer one may pass."""
        x, q, u, _, p, z = self._given
        self._longest = _INSIDE / max(rates(self._flat, float(q[0]), x, u, p, z)[1], 1e-300)

    def _measure(self, h: float) -> None:
        """Goes over to the stiff method where stability bounds the explicit steps."""
        x, q, u, _, p, z = self._given
        stiff = h * rates(self._flat, float(q[0]), x, u, p, z, below=_STIFF / h)[0] > _STIFF
        self._stiff = self._stiff + 1 if stiff else 0
        if self._stiff == 2:
            self._undecided = False
            self._use(rosenbrock(self._flat))

    def run(
        self,
        x: FloatArray,
        z: FloatArray,
        interval: tuple[float, float],
        u: tuple[FloatArray, FloatArray],
        times: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """x at the end of an interval on which u runs straight, and at ``times`` inside it, (len(times), n_x).

        Raises
        ------
        StepError
            See there.
        """
        t, end = interval
        inside = np.zeros((len(times), len(x)))
        self._x[:], self._z[:] = x, z
        self._rate[:] = (u[1] - u[0]) / (end - t)
        self._move(t, interval[0], u[0])
        self.held_inside = np.zeros((len(times), len(self._z)))
        remembers = self.outputs_inside is not None
        if remembers:
            self.outputs_inside = np.full((len(times), len(self._flat.outputs)), np.nan)
        self._settle(None, inside[:0])
        self.held_inside[:] = self._z
        done = self._note_outputs(t, inside, times, 0)
        if not self._h:
            self._h = self._first_step(end - t)
        rejected = False
        while t < end:
            known = end if self.watch is None else min(end, self.watch.next_event)
            left = known - t
            wanted = min(self._h, self._max_step, self._longest)
            h = left if wanted >= left * (1 - 1e-9) else left / 2 if wanted > left / 2 else wanted
            refusal = self._limits.spend(1)
            if refusal:
                raise StepError(refusal, t, inside[:done])
            self._q[1] = h
            after, error, _, slope = self._trial()
            self.steps += 1
            norm = float(error[0, 0])
            if not norm < 1.0:  # NaN included
                self._h, rejected = h * self._shorter(norm), True
                if self._h < max(_TIME_ROUNDING * abs(t), _LEAST_STEP):
                    what = (
                        "became smaller than rounding"
                        if np.isfinite(norm)
                        else "meets values that are not finite"
                    )
                    raise StepError(f"the step {what}", t, inside[:done])
                continue
            later = known if h == left else t + h
            try:
                crossing = None if self.watch is None else self.watch.crossing(h, self._states)
            except EndlessEventsError as error:
                raise StepError(str(error), t, inside[:done], "") from error
            if crossing is not None:
                later = min(t + crossing.part * h, later)
            # A time that is that of an event but for rounding is taken down after it.
            before = later - _TIME_ROUNDING * abs(later)
            stop = int(
                np.searchsorted(times, before) if remembers else np.searchsorted(times, later, side="right")
            )
            if stop > done:
                before_end = (
                    done + int(np.searchsorted(times[done:stop], later)) if crossing is None else stop
                )
                if before_end > done:
                    inside[done:before_end] = self._states((times[done:before_end] - t) / h)
                inside[before_end:stop] = after[0]
                for row in range(done, stop) if remembers else ():
                    at = self._u + (times[row] - t) * self._rate
                    self.outputs_inside[row] = self.output(times[row], inside[row], self._z, at)
                done = stop
            grown = h * (min(1.0, self._longer(norm)) if rejected else self._longer(norm))
            # A step cut short by the end of the interval says nothing against the longer one.
            self._h = grown if h >= wanted * (1 - 1e-9) else max(self._h, grown)
            rejected = False
            self._first[:] = slope[0]
            self._x[:] = after[0] if crossing is None else self._states(np.array([crossing.part]))[0]
            t = later
            if self._note(t):
                raise StepError("the steps left would not do: given up", t, inside[:done])
            self._move(t, interval[0], u[0])
            due = self._asked(inside[:done]) or (self.watch is not None and self.watch.is_due(later))
            if crossing is not None or due:
                self._settle(None if crossing is None else crossing.fired, inside[:done])
            self.held_inside[stop:] = self._z
            done = self._note_outputs(t, inside, times, done)
            if self._undecided and len(self._x) and self._accepted % _MEASURED_AFTER == 0:
                self._measure(h)
            elif self._bounded and len(self._x) and (self._accepted - 1) % _MEASURED_AFTER == 0:
                self._bound()
        return self._x.copy(), inside

    def begin(self, x: FloatArray, z: FloatArray, t: float, u: FloatArray) -> FloatArray:
        """Starts blocks that keep something beside their states; returns x where they start."""
        if self.watch is not None and self._flat.memories:
            self._x[:], self._z[:], self._u[:], self._q[0] = x, z, u, t
            try:
                self.watch.begin()
            except RunEndedError as error:
                raise StepError(str(error), t, np.zeros((0, len(x))), "") from error
        return self._x.copy() if self._flat.memories else x

    @property
    def state(self) -> object:
        """What the next interval hangs on beside x and z, to be put back."""
        return self._h, None if self.watch is None else self.watch.state

    @state.setter
    def state(self, value: object) -> None:
        assert isinstance(value, tuple)
        self._h = value[0]
        if self.watch is not None:
            self.watch.state = value[1]

    def happen(self, x: FloatArray, z: FloatArray, t: float, u: FloatArray) -> FloatArray:
        """Events that are due at a point; returns x after them.

        Raises
        ------
        StepError
        """
        self._x[:], self._z[:], self._rate[:] = x, z, 0.0
        self._move(t, t, u)
        self._settle(None, np.zeros((0, len(x))))
        return self._x.copy()

    def output(self, t: float, x: FloatArray, z: FloatArray, u: FloatArray) -> FloatArray:
        """y at a point, with what blocks keep now."""
        value = self._flat.output(t, x, u, self._given[4], z)
        return np.asarray(value, dtype=float).ravel()

    def _note_outputs(self, t: float, inside: FloatArray, times: FloatArray, done: int) -> int:
        """Takes down x and y at times that have just been reached, after the events there."""
        if self.outputs_inside is None:
            return done
        stop = int(np.searchsorted(times, t, side="right"))
        for row in range(done, stop):
            inside[row] = self._x
            self.outputs_inside[row] = self.output(t, self._x, self._z, self._u)
        return max(done, stop)

    def _asked(self, inside: FloatArray) -> bool:
        """Whether a block wants an event after the step that was just made."""
        try:
            return self.watch is not None and self.watch.completed()
        except RunEndedError as error:
            raise StepError(str(error), float(self._q[0]), inside, "") from error

    @property
    def x(self) -> FloatArray:
        """x where the run stands."""
        return self._x.copy()

    @property
    def last_outputs(self) -> FloatArray | None:
        """y where a block asked to end the run, which it still knows; None where none did."""
        if not any(memory.ended for memory in self._flat.memories):
            return None
        return self.output(float(self._q[0]), self._x, self._z, self._u)

    @property
    def held(self) -> FloatArray:
        """z as it is now."""
        return self._z.copy()

    def _settle(self, fired: NDArray[np.bool_] | None, inside: FloatArray) -> None:
        """Events at the point, and the slope after them."""
        if self.watch is not None:
            try:
                self.watch.settle(fired)
            except (EndlessEventsError, RunEndedError) as error:
                raise StepError(str(error), float(self._q[0]), inside, "") from error
        self._first[:] = self._slope()[0].ravel()
        if not np.all(np.isfinite(self._first)):
            raise StepError("a derivative is not finite", float(self._q[0]), inside)

    def _move(self, t: float, begin: float, u: FloatArray) -> None:
        """Time and the inputs then; algebraic loops start from their solution there."""
        self._q[0] = t
        self._u[:] = u + (t - begin) * self._rate
        self._renew()

    def _renew(self) -> None:
        if self._renewed is not None:
            self._z[:] = self._renewed()[0].ravel()

    def _shorter(self, norm: float) -> float:
        safety, least, _ = self.pair.factors
        return max(least, safety * norm ** (-1 / self.pair.order)) if np.isfinite(norm) else 0.1

    def _longer(self, norm: float) -> float:
        safety, _, most = self.pair.factors
        return min(most, safety * norm ** (-1 / self.pair.order)) if norm else most

    def _states(self, part: FloatArray) -> FloatArray:
        """x at parts (k,) of the step tried last, (k, n_x)."""
        if self._dense is None:
            after, _, stages, _ = self._trial.results
            self._dense = Call(self.pair.dense(), [*self._given, after, stages])
        return self._x + self.pair.evaluate(self._dense()[0], part)

    def _first_step(self, length: float) -> float:
        """Hairer, Norsett, Wanner I, II.4, without the second evaluation."""
        if not len(self._x):  # nothing but events
            return length
        scale = self._q[3] + self._q[2] * np.abs(self._x)
        size, speed = np.sqrt(np.mean((self._x / scale) ** 2)), np.sqrt(np.mean((self._first / scale) ** 2))
        h = 0.01 * size / speed if size > 1e-5 and speed > 1e-5 else 1e-6
        return float(min(h, length))


@lru_cache(maxsize=KEPT)
def _leap(flat: FlatModel, trial: ca.Function) -> ca.Function:
    """From a node to the next in one step: (state, data, p and tolerances) -> state, (state at the node, error)."""
    layout, n_p = Layout(flat), len(flat.parameters)
    n_x, _, n_z = layout.sizes
    node = at_node(flat) if flat.tasks or flat.unknowns is not None else None

    def body(state: ca.SX, data: ca.SX, p: ca.SX) -> Results:
        given, tolerance = cut(p, slice(n_p)), cut(p, slice(n_p, None))
        if node is not None:
            state, _ = node(state, data, given)
        x, s, z = (
            cut(state, part)
            for part in (slice(n_x), slice(n_x, -n_z or None), slice(layout.state - n_z, None))
        )
        t, h, begin, end = data[0], data[1], cut(data, layout.input(0)), cut(data, layout.input(2))
        first = flat.dynamics(t, x, begin, given, z)
        after, error, *_ = trial(x, ca.vertcat(t, h, tolerance), begin, (end - begin) / h, given, z, first)
        later = renewed(flat, t + h, after, end, given, z)
        return ca.vertcat(after, s, later), ca.vertcat(state, error)

    return compose("pf_leap", [layout.state, layout.data, n_p + 2], body, SYMBOLS[1:])


class Leaps:
    """Steps from node to node, many in one call, as long as error control accepts each of them.

    Where nodes are close, such as kinks of inputs and instants of sampled blocks, one step leads from each to the next.

    Parameters
    ----------
    flat : FlatModel
        Without events.
    integrator : Integrator
        Whose method and tolerances they take.
    p : (n_p,) array
    """

    MOST = BASE ** (LEVELS - 1)

    def __init__(self, flat: FlatModel, integrator: Integrator, p: FloatArray) -> None:
        self._flat, self._integrator, self._p = flat, integrator, p
        self._chain: Chain | None = None
        self.size: int = 0
        """Steps to try next; 0 until a single one has passed an interval."""

    def encourage(self) -> None:
        """A step has passed an interval at its first trial."""
        self.size = max(self.size, BASE)

    def run(self, state: FloatArray, data: FloatArray) -> tuple[int, FloatArray]:
        """How many steps were accepted, and the states at their nodes and at the one after, (accepted + 1, n)."""
        trial = self._integrator.pair.trial
        if not len(data) or not self._integrator.spent(len(data)):
            self.size = 0
            return 0, state[None]
        leap = _leap(self._flat, trial)
        if self._chain is None or self._chain.step is not leap:
            self._chain = Chain(leap, state, np.concatenate([self._p, self._integrator.tolerance]))
        self._chain.state = state
        found = self._chain.run(data)
        good = int(np.argmin(np.append(found[:, -1] < 1.0, False)))
        self.size = min(BASE * self.size, self.MOST) if good == len(data) else 0
        return good, np.vstack([found[:, :-1], self._chain.state])[: good + 1]
