"""Co-simulation FMUs as discrete python-control systems."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from .clock_schedule import ClockTimes
from .importing_blocks import FmuBlock
from .inspect import Kind, Scalar
from .instance import FmuError
from .unpacked import UnpackedFmu

__all__ = ["FmuSteps"]

# A step count that python-control's arithmetic has passed through is an integer to this.
_INTEGER = 1e-9
# States kept for going back: the step that is being evaluated, and the one before it.
_KEPT_STATES = 2


class FmuSteps(FmuBlock):
    """A co-simulation FMU, or one of scheduled execution, as a discrete system; made by :func:`import_fmu`.

    The FMU keeps its state to itself. The one state of this system counts communication steps: x = k at
    t = t_0 + k dt, and the next x is k + 1 after one ``doStep``.

    Parameters
    ----------
    fmu : UnpackedFmu
    name, step, parameters, start_time, tolerance, outputs, kind, clocks
        As for :func:`import_fmu`.

    Notes
    -----
    * Outputs at step k see the inputs at step k where the FMU recomputes them on reading; else those of the step.
    * Clocks that tick at the time of step k, and discrete inputs that changed, come into force as the step from there
      begins, with the inputs of step k: outputs at step k know nothing of them yet. :func:`cosimulate` hands on what
      they change at the instant itself.
    * From step 0 any run can be repeated: x = 0 initialises the FMU. Going back otherwise needs an FMU that can put
      back its state, and reaches one step; anything else raises and says so.
    * Fixed parameters change at x = 0 only, tunable ones at any step.
    * Its linearisation means nothing (the state is a count) and raises.
    """

    def __init__(
        self,
        fmu: UnpackedFmu,
        *,
        name: str,
        step: float,
        parameters: Mapping[str, Scalar] | None = None,
        start_time: float = 0.0,
        tolerance: float | None = None,
        outputs: Sequence[str] | None = None,
        kind: Kind = "cs",
        clocks: ClockTimes | None = None,
    ) -> None:
        super().__init__(
            fmu,
            kind,
            name=name,
            parameters=parameters or {},
            start_time=start_time,
            tolerance=tolerance,
            dt=step,
            states=["step"],
            outputs=outputs,
            clocks=clocks,
        )
        self._h = step
        self._k = 0
        self._last: tuple[int, bytes] = (-1, b"")
        self._saved: dict[int, object] = {}

    def __deepcopy__(self, memo: dict[int, object]) -> FmuSteps:
        return FmuSteps(
            self._fmu,
            name=self.name or "fmu",
            step=self._h,
            parameters=self.values,
            start_time=self._start_time,
            tolerance=self._tolerance,
            outputs=self.patterns,
            kind=self.instance.kind,
            clocks=self.clocks,
        )

    @property
    def steps_done(self) -> int:
        """Communication steps since the start."""
        return self._k

    def restart(
        self, start_time: float | None = None, *, params: Mapping[str, float] | None = None
    ) -> FloatArray:
        """Initialise the FMU; returns its outputs.

        Parameters
        ----------
        start_time : float, optional
            Seconds; the block's own by default.
        params : dict of str to float, optional

        Returns
        -------
        (outputs,) array
        """
        self._begin(self._start_time if start_time is None else start_time, params or {})
        return self._outputs.read(self.instance)

    def step(self, inputs: ArrayLike) -> FloatArray:
        """One communication step, outside any simulation.

        Parameters
        ----------
        inputs : (inputs,) array_like
            Held over the step.

        Returns
        -------
        (outputs,) array
            At the end of the step.
        """
        u = _signals.array("inputs", np.atleast_1d(_signals.real("inputs", inputs)), (len(self._inputs),))
        if not self._running:
            self._begin(self._start_time, {})
        self._inputs.write(self.instance, u)
        self._forget(lambda k: True)  # a run by hand goes forward only
        self._advance(self._start_time + self._k * self._h, u, going_back=False)
        return self._outputs.read(self.instance)

    def _now(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        self._go_to(t, x, params)
        self._inputs.write(self.instance, np.asarray(u, dtype=float).reshape(-1))
        return self._outputs.read(self.instance)

    def _next(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        u = np.asarray(u, dtype=float).reshape(-1)
        asked = (self._count(x), u.tobytes())
        if not (
            self._running and asked == self._last and self._k == asked[0] + 1 and not self._changed(params)
        ):
            self._go_to(t, x, params)
            self._inputs.write(self.instance, u)
            self._advance(t, u, going_back=self.instance.state_is_usable)
        return np.array([self._k], dtype=float)

    def _advance(self, t: float, u: FloatArray, *, going_back: bool) -> None:
        if going_back and self._k not in self._saved:
            self._saved[self._k] = self.instance.save()
            self._forget(lambda k: k <= self._k - _KEPT_STATES)
        self.instance.do_step(t, self._h, final=not going_back)
        self._last = (self._k, u.tobytes())
        self._k += 1

    def _forget(self, which: Callable[[int], bool]) -> None:
        for key in [key for key in self._saved if which(key)]:
            self.instance.forget(self._saved.pop(key))

    def _count(self, x: FloatArray) -> int:
        value = float(np.asarray(x, dtype=float).reshape(-1)[0])
        if abs(value - round(value)) > _INTEGER or value < 0:
            raise ValueError(
                f"{self.name}: the state of a co-simulation FMU counts communication steps; expected 0, 1, 2, ..., got "
                f"{value:g}. It cannot be linearised; use a model-exchange FMU for that"
            )
        return round(value)

    def _go_to(self, t: float, x: FloatArray, params: Mapping[str, float]) -> None:
        k = self._count(x)
        changed = self._changed(params)
        if k == 0 and (not self._running or self._k > 0 or changed or t != self._start_time):
            self._begin(t, params)
            return
        if not self._running:
            raise FmuError(self.instance.name, "step", "refused", f"asked for step {k} before step 0")
        if k != self._k:
            self._go_back(k)
        if changed:
            self._tune(changed)

    def _go_back(self, k: int) -> None:
        if k not in self._saved:
            why = (
                f"it goes back {_KEPT_STATES} steps at most"
                if self._saved
                else "it cannot put back its state"
            )
            raise FmuError(
                self.instance.name,
                "step",
                "refused",
                f"it stands at step {self._k} and was asked for step {k}; {why}. Runs go forward, from state 0",
            )
        self.instance.restore(self._saved[k])
        self._forget(lambda key: key > k)
        self._k = k
        self._last = (-1, b"")

    def _tune(self, changed: Mapping[str, float]) -> None:
        tunable = {
            label: entry.variability == "tunable"
            for entry in self.description.of("parameter")
            for label in entry.labels
        }
        fixed = [key for key in changed if not tunable.get(key, False)]
        if fixed:
            raise ValueError(
                f"{self.name}: {', '.join(fixed)} cannot change during a run, only at its start (state 0)"
            )
        self.instance.set_values(changed)
        self._in_force |= changed

    def _begin(self, time: float, params: Mapping[str, float]) -> None:
        self._start_time = time
        self._saved = {}
        self._k, self._last = 0, (-1, b"")
        self._restart(time, params)
