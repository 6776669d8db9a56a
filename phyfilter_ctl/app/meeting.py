"""Filters that meet the drawn limits: a search in the background, with its progress and an end at any time."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Literal, cast

from numpy.linalg import LinAlgError

from ..design.learning import Form
from ..design.optimal import LimitsFront, Trade, limits_front
from ..plots import FrequencyLimit
from ..results import Status, plain
from .checking import Fields
from .designs import FASTEST, SLOWEST, Design, read_design

__all__ = ["Meetings", "drawn_limits"]

State = Literal["running", "done", "cancelled", "failed"]

_POINTS = 9
_HIGHEST_ORDER = 6
_LEAST_LEVEL, _LARGEST_LEVEL = 1e-6, 1e6
_LARGEST_ID = 2**53
_WAIT = 0.5  # s for a search to hear of its end


@dataclass(frozen=True)
class _Wish:
    """What a message asks for."""

    design: Design
    limits: tuple[FrequencyLimit, ...]
    form: Form
    trade: Trade
    delay_margin: float
    ratios: tuple[float, float]


class Meetings:
    """The searches of one session, of which one runs at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last: _Search | None = None
        self._count = 0

    def begin(self, fields: Fields) -> dict[str, object]:
        """The reply to op "meet".

        Parameters
        ----------
        fields : Fields
            design, and where they count trade, form, delay_margin and ratios.

        Raises
        ------
        MessageError, ValueError
            If a field is wrong, or a search still runs.
        """
        wish = _read(fields)
        with self._lock:
            if self._last is not None and self._last.running:
                raise ValueError("a search still runs: cancel it, or wait for its end")
            self._count += 1
            self._last = _Search(self._count, wish)
            self._last.start()
            return {"job": self._count}

    def look(self, fields: Fields, *, end: bool = False) -> dict[str, object]:
        """The reply to op "front", and to op "unmeet", which ends the search first.

        Parameters
        ----------
        fields : Fields
            job.
        end : bool

        Raises
        ------
        MessageError
            If there is no such search.
        """
        number = fields.integer("job", 0, _LARGEST_ID)
        with self._lock:
            search = self._last
        if search is None or search.number != number:
            raise fields.error("job", f"there is no search {number}; start one first")
        if end:
            search.cancel()
        return search.snapshot()

    def close(self) -> None:
        """End the search, if one runs."""
        with self._lock:
            search = self._last
        if search is not None:
            search.cancel()


def _read(fields: Fields) -> _Wish:
    design = read_design(fields)
    if len(design.poles) > _HIGHEST_ORDER:
        raise fields.error(
            "design", f"a search takes at most {_HIGHEST_ORDER} poles, got {len(design.poles)}"
        )
    trade = fields.choice("trade", ("noise", "margin")) if "trade" in fields else "noise"
    form = fields.choice("form", ("lowpass", "general")) if "form" in fields else "lowpass"
    delay_margin = fields.number("delay_margin", 0.0, 10.0, unit="s") if "delay_margin" in fields else 0.0
    low, high = fields.numbers("ratios", 2, 2, size=1e3) if "ratios" in fields else (1.0, 1.0)
    if not 1e-3 <= low <= 1.0 <= high:
        raise fields.error(
            "ratios", f"expected a range of M_hat/M around 1, such as 0.5 to 2, got {low:g} to {high:g}"
        )
    limits = drawn_limits(design)
    if not limits and delay_margin == 0.0 and low == high:
        raise ValueError("Nothing is asked for: draw a limit in the frequency panel, or ask for a margin.")
    ratio = design.assume.ratio
    return _Wish(
        design,
        limits,
        cast(Form, form),
        cast(Trade, trade),
        delay_margin,
        (min(low, ratio), max(high, ratio)),
    )


def drawn_limits(design: Design) -> tuple[FrequencyLimit, ...]:
    """Those that the front end draws: |1 - F| up to a frequency, |F| from one on.

    Parameters
    ----------
    design : Design

    Raises
    ------
    MessageError
        If one has another form.
    """
    found: list[FrequencyLimit] = []
    for key, value in (design.limits or {}).items():
        if key not in ("error", "estimate") or value is None:
            continue
        corner = Fields.of(value, f"design.limits.{key}")
        omega = corner.number("omega", SLOWEST, FASTEST, unit="rad/s")
        level = corner.number("level", _LEAST_LEVEL, _LARGEST_LEVEL)
        below = FrequencyLimit("error", level, high=omega)
        found.append(below if key == "error" else FrequencyLimit("F", level, low=omega))
    return tuple(found)


class _Search:
    """One run of ``limits_front`` in a thread of its own."""

    def __init__(self, number: int, wish: _Wish) -> None:
        self.number, self._wish = number, wish
        self._lock, self._stop = threading.Lock(), threading.Event()
        self._state: State = "running"
        self._message = "looking for filters"
        self._done, self._steps = 0, 1
        self._front: LimitsFront | None = None
        self._thread = threading.Thread(target=self._work, name=f"phyfilter-meet-{number}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    def cancel(self) -> None:
        self._stop.set()
        self._thread.join(_WAIT)

    def snapshot(self) -> dict[str, object]:
        with self._lock:
            front, design = self._front, self._wish.design
            reply: dict[str, object] = {
                "state": self._state,
                "message": self._message,
                "done": self._done / self._steps,
                "certain": front is not None and front.certain,
            }
        points: list[dict[str, object]] = []
        for i, filter in enumerate(front.filters if front is not None else ()):
            try:
                shown = design.with_filter(filter)
            except ValueError:  # too slow or too fast for the page
                continue
            assume = design.assume
            points.append(
                {
                    "design": shown.as_json(),
                    "noise": plain(front.noise[i] * assume.noise) if front is not None else None,
                    "bound": plain(front.bound[i] * assume.slope) if front is not None else None,
                    "bandwidth": plain(front.bandwidth[i]) if front is not None else None,
                    "delay_margin": plain(front.delay_margin[i]) if front is not None else None,
                }
            )
        return reply | {"front": points}

    # -- in the thread ----------------------------------------------------------------------------------------------

    def _work(self) -> None:
        wish = self._wish
        assume, kind = wish.design.assume, wish.design.filter.type
        try:
            found = limits_front(
                len(wish.design.poles),
                dt=wish.design.dt,
                limits=wish.limits,
                type=max(kind, 1),
                form=wish.form,
                actuator_lag=assume.lag,
                delay=assume.delay,
                delay_margin=wish.delay_margin,
                inertia_ratios=wish.ratios,
                trade=wish.trade,
                points=_POINTS,
                callback=self._report,
            )
        except Exception as error:  # the thread must not die in silence
            plainly = isinstance(error, ValueError) and not isinstance(error, LinAlgError)
            self._end(
                "failed",
                str(error) if plainly else "the search failed: change a limit a little and try again",
            )
            return
        with self._lock:
            self._front = found
        self._end("cancelled" if found.status is Status.CANCELLED else "done", found.message)

    def _report(self, done: int, steps: int) -> bool:
        with self._lock:
            self._done, self._steps = done, steps
        return self._stop.is_set()

    def _end(self, state: State, message: str) -> None:
        with self._lock:
            self._done = self._steps
            self._state, self._message = state, f"{message[:1].upper()}{message[1:]}."
