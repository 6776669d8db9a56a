"""Learning in the background: a live cost curve, and an end at any time."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from typing import Literal

from numpy.linalg import LinAlgError

from ..design.learning import Form, LearnEvent, LearnResult, Search, learn
from ..filter import Sampling
from ..recording import Recording
from .designs import Design

__all__ = ["LearningJob"]

State = Literal["running", "done", "cancelled", "failed"]

_CURVE = 400  # points of the curve that a reply holds
# Unequal steps are summed sample by sample: beyond this many a descent would not hear of a cancel in time.
_MOST_UNEQUAL = 40_000
_DIGITS = 12  # times of a recording rarely give the interval to the last bit


class LearningJob:
    """One run of :func:`phyfilter_ctl.learn` in a thread of its own.

    Parameters
    ----------
    number : int
        Name of the job in messages.
    log : Recording
        With a label.
    order : int
    form : {"lowpass", "general"}
    like : Design
        Gives the method, and sampling and assumptions of the learned design.
    """

    def __init__(self, number: int, log: Recording, order: int, *, form: Form, like: Design) -> None:
        self.number = number
        self._order, self._like = order, like
        self._form: Form = form
        self._log, self._note = log, ""
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._state: State = "running"
        self._message = f"learning up to order {order}"
        self._design: Design | None = None
        self._wiener: tuple[float, ...] | None = None
        self._curve: list[tuple[int, float]] = []
        self._steps = 0
        self._thread = threading.Thread(target=self._work, name=f"phyfilter-learn-{number}", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the thread still computes."""
        return self._thread.is_alive()

    @property
    def log(self) -> Recording:
        """What is learned from."""
        return self._log

    @property
    def wiener(self) -> tuple[float, ...] | None:
        """RMSE of the causal Wiener filter for each channel; None until the job is done.

        On all samples, each block of them by a response fitted without it: what was fitted to them, too, may be below.
        """
        with self._lock:
            return self._wiener

    def cancel(self, wait: float = 0.0) -> None:
        """Ask the job to stop, and wait for it at most so long.

        Parameters
        ----------
        wait : float
            Seconds.
        """
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(wait)

    def wait(self, seconds: float) -> bool:
        """Wait for the end at most so long; whether it came.

        Parameters
        ----------
        seconds : float
        """
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def snapshot(self) -> dict[str, object]:
        """The reply to op "job".

        Returns
        -------
        dict
            state, curve of [steps that lowered a cost, least RMSE so far], message, and the learned design.
        """
        with self._lock:
            curve, state, message, design = list(self._curve), self._state, self._message, self._design
        stride = max(1, math.ceil(len(curve) / _CURVE))
        kept = curve[::stride]
        if curve and kept[-1] != curve[-1]:
            kept.append(curve[-1])
        reply: dict[str, object] = {
            "state": state,
            "curve": [list(each) for each in kept],
            "message": message,
        }
        return reply if design is None else reply | {"design": design.as_json()}

    # -- in the thread ----------------------------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            log = self._even(self._log)
            result = learn(
                log,
                self._order,
                shape=self._form,
                sampling=Sampling(method=self._like.method),
                search=Search(callback=self._report),
            )
            if self._stop.is_set():
                self._end("cancelled", "cancelled")
                return
            self._finish(result, self._floors(log))
        except Exception as error:  # the thread must not die in silence
            if self._stop.is_set():  # before any start had a cost
                self._end("cancelled", "cancelled")
            elif isinstance(error, ValueError | TypeError) and not isinstance(error, LinAlgError):
                self._end("failed", str(error))
            else:
                self._end("failed", f"learning failed ({type(error).__name__}): try another order or form")

    def _even(self, log: Recording) -> Recording:
        if log.is_uniform or log.n <= _MOST_UNEQUAL:
            return log
        self._note = f"; the log was resampled evenly, every {log.dt:.4g} s"
        return log.resample(log.dt)

    def _report(self, event: LearnEvent) -> bool:
        """Called after every step that lowered a cost; True stops the search."""
        rmse = math.sqrt(max(event.cost, 0.0))
        with self._lock:
            self._steps += 1
            if not self._curve or rmse < self._curve[-1][1]:
                self._curve.append((self._steps, rmse))
                self._message = f"order {event.order}: RMSE {rmse:.4g}"
        return self._stop.is_set()

    def _floors(self, log: Recording) -> tuple[float, ...] | None:
        """The Wiener filter of every channel; it does not depend on the filter that is learned beside it."""
        found: list[float] = []
        for channel in range(log.n_x):
            if self._stop.is_set():
                return None
            try:
                floor = learn(
                    log,
                    1,
                    channels=[channel],
                    sampling=Sampling(method=self._like.method),
                    search=Search(starts=0, max_iterations=1),
                ).wiener
            except (ValueError, LinAlgError):  # a channel with nothing to learn, or too short for blocks
                return None
            if floor is None or not math.isfinite(floor.rmse):
                return None
            found.append(floor.rmse)
        return tuple(found)

    def _finish(self, result: LearnResult, wiener: tuple[float, ...] | None) -> None:
        dt = float(f"{result.dt:.{_DIGITS}g}")
        try:
            design = replace(self._like.with_filter(result.filter), dt=dt)
        except ValueError as error:
            self._end("failed", f"the learned filter cannot be shown: {error}; try a lower order")
            return
        with self._lock:
            self._design, self._wiener = design, wiener
            self._curve.append((self._steps, result.rmse))
        said = result.message.removeprefix(f"order {result.order_used}: ")
        notes = "".join(f"; {note}" for note in result.notes)
        over = _over(self._log)
        self._end(
            "done", f"RMSE {result.rmse:.4g} {over}, order {result.order_used}: {said}{self._note}{notes}"
        )

    def _end(self, state: State, message: str) -> None:
        with self._lock:
            self._state, self._message = state, message


def _over(log: Recording) -> str:
    """Which samples an RMSE of learning is over, in words."""
    channels = f"all {log.n_x} channels" if log.n_x > 1 else log.channels[0]
    part = f"{log.n} samples, {log.times[0]:.6g} s to {log.times[-1]:.6g} s"
    return f"over {channels} of the part learned from (the whole log, {part}; nothing held out)"
