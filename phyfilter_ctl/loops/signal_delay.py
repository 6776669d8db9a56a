"""The least delay of a sampled diagram's signals that makes it unstable, exact within a step too.

A delayed signal is what it was: it is read off (captured) at some times and acts (is released) later by the delay. Held
signals are captured where they change, those that sampled blocks read are released where they are read.
"""

from __future__ import annotations

from typing import NamedTuple

import control as ct
import numpy as np

from .._sections import ComplexArray, FloatArray
from ..analysis.margins.matrix_search import MatrixSearch
from ..analysis.margins.scalar_search import Bound
from .periodic import Matrix, Wired, replaced
from .sampled_loop import OpenedLoop

__all__ = ["delay_margin", "delayed"]

# Parts of a step at which the search looks, and to which share of the delay it halves what it found.
_PARTS = 4
_RESOLUTION = 1e-6
# Up to so many steps the eigenvalues of the delayed loop are cheaper than frequency responses.
_FEW = 24
# Times that agree to this share of a hyperperiod are one.
_SAME = 1e-11


_RELEASE, _INSTANT, _CAPTURE = range(3)


class _Event(NamedTuple):
    what: int
    which: int
    instant: int  # that was last
    length: float  # seconds to the next event


def delay_margin(loop: OpenedLoop) -> Bound:
    """The margin in seconds, and the frequency of the pole that is lost.

    Looked for at every quarter of a step up to 24 steps, then where an eigenvalue of L has modulus 1, by whole
    hyperperiods; halved down to 1e-6 of it.
    """
    wired, H = _opened(loop), loop.model.instants.period
    step = H / len(loop.grid)

    def lost_at(delay: float) -> bool:
        return bool(np.max(np.abs(_roots(wired, loop, delay))) >= 1.0)

    few = (step * i / _PARTS for i in range(1, _PARTS * _FEW + 1))
    lost = next((delay for delay in few if lost_at(delay)), None)
    if lost is None:
        parts = H * np.arange(_PARTS * min(len(loop.grid), 4)) / (_PARTS * min(len(loop.grid), 4))
        lost = min(part + _periods(wired, loop, part) * H for part in parts)
        if np.isinf(lost):
            return Bound(lost, float("nan"))
        step = float(parts[1]) * _PARTS
    kept = lost - step / _PARTS
    while lost - kept > _RESOLUTION * lost and lost > _RESOLUTION * step:
        middle = 0.5 * (kept + lost)
        kept, lost = (kept, middle) if lost_at(middle) else (middle, lost)
    roots = _roots(wired, loop, lost)
    omega = abs(float(np.angle(roots[np.argmax(np.abs(roots))]))) / H
    return Bound(0.0 if kept <= _RESOLUTION * step else kept, omega)


def delayed(loop: OpenedLoop, delay: float) -> Matrix:
    """State matrix over a hyperperiod with the opened signals late by some seconds; the states of the delay follow.

    Parameters
    ----------
    loop : OpenedLoop
    delay : float
        Above 0.
    """
    return _delayed(_opened(loop), loop, delay)


def _opened(loop: OpenedLoop) -> Wired:
    last = slice(-loop.count, None)
    return loop.model.wired(last, last, replaced)


def _roots(wired: Wired, loop: OpenedLoop, delay: float) -> ComplexArray:
    return np.linalg.eigvals(_delayed(wired, loop, delay)).astype(np.complex128)


def _captures(loop: OpenedLoop, delay: float) -> FloatArray:
    """When what is released later was captured, in the hyperperiod."""
    instants = loop.model.instants
    return _within(instants.times[list(loop.grid)] - (delay if loop.kind == "read" else 0.0), instants.period)


def _within(times: FloatArray, H: float) -> FloatArray:
    inside = np.mod(times, H)
    return np.where(H - inside <= _SAME * H, 0.0, inside)


def _events(loop: OpenedLoop, delay: float) -> list[_Event]:
    """Releases, instants and captures in their order."""
    instants, captures = loop.model.instants, _captures(loop, delay)
    H = instants.period
    releases = _within(captures + delay, H)
    found = [(float(t), what, i) for what, times in enumerate((releases, instants.times, captures))
             for i, t in enumerate(times)]  # fmt: skip
    found.sort()
    # What coincides but for rounding happens at one time, in the order of release, instant, capture.
    events: list[tuple[float, int, int]] = []
    now = 0.0
    for time, what, which in found:
        now = now if time - now <= _SAME * H else time
        events.append((now, what, which))
    events.sort()
    ends = [event[0] for event in events[1:]] + [H]
    instant, steps = 0, []
    for (time, what, which), end in zip(events, ends, strict=True):
        instant = which if what == _INSTANT else instant
        steps.append(_Event(what, which, instant, end - time))
    return steps


def _delayed(wired: Wired, loop: OpenedLoop, delay: float) -> Matrix:
    n, p, H = wired.order, wired.width, wired.instants.period
    captures = _captures(loop, delay)
    # How many captures there are between one and its release.
    ends = (captures[:, None] - captures + delay) / H, (captures[:, None] - captures) / H
    behind = (np.ceil(ends[0] - _SAME) - np.floor(ends[1] + _SAME) - 1.0).sum(axis=1).astype(int)
    kept = int(behind.max()) + 1
    rows: Matrix = np.eye(n + p * (1 + kept))
    state, w, line = rows[:n], rows[n : n + p], list(rows[n + p :].reshape(kept, p, -1))
    for event in _events(loop, delay):
        if event.what == _RELEASE:
            w = line[behind[event.which]]
        elif event.what == _INSTANT:
            A, B, _, _ = wired.at[event.which]
            state = A @ state + B @ w
        else:
            line = [wired.flows[event.instant][1] @ np.concatenate([state, w]), *line[:-1]]
        state = wired.passed(state, w, event.instant, event.length)
    return np.concatenate([state, w, *line])


def _periods(wired: Wired, loop: OpenedLoop, part: float) -> float:
    """Hyperperiods of delay, beside a part of one, at which stability is first lost: each turns every eigenvalue of L
    by its frequency."""
    n, p, H = wired.order, wired.width, wired.instants.period
    count = len(loop.grid)
    size = n + p + p * count
    rows: Matrix = np.eye(size)
    state, w, y = rows[:n], rows[n : n + p], [rows[:0]] * count
    for event in _events(loop, part):
        if event.what == _RELEASE:
            w = rows[n + p + p * event.which :][:p]
        elif event.what == _INSTANT:
            A, B, _, _ = wired.at[event.which]
            state = A @ state + B @ w
        else:
            y[event.which] = wired.flows[event.instant][1] @ np.concatenate([state, w])
        state = wired.passed(state, w, event.instant, event.length)
    after, out = np.concatenate([state, w]), -np.concatenate(y)
    n += p
    # What is released in the next hyperperiod waits as a state.
    late = np.repeat(_captures(loop, part) + part >= H * (1.0 - _SAME), p)
    B, D, wait = after[:, n:], out[:, n:], np.eye(p * count)[late]
    A = np.block([[after[:, :n], B[:, late]], [np.zeros((len(wait), n + len(wait)))]])
    L = ct.StateSpace(
        A,
        np.vstack([B * ~late, wait]),
        np.hstack([out[:, :n], D[:, late]]),
        D * ~late,
        H,
        remove_useless_states=False,
    )
    omega, lag = MatrixSearch.of(L).lags()
    return float(np.ceil(np.min(lag / (omega * H), initial=np.inf)))
