"""What a live filter does about samples that are no good (``LiveRules``), and what it met (``LiveHealth``)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from .. import _signals
from ..results import Result
from .recursion import Recursion

__all__ = ["MEANING", "LiveHealth", "LiveRules", "completed"]

After = Literal["decay", "keep", "reset"]


@dataclass(frozen=True)
class LiveRules:
    """What a live filter does about samples that are no good.

    Parameters
    ----------
    longest_gap : float, optional
        Seconds without a good sample for which f_hat - f_theta is kept and after which a gap is no longer closed by one
        step. None means 20 nominal steps; with forward Euler fewer, as many as are stable as one.
    decay_time : float, optional
        Time constant in seconds with which f_hat goes to f_theta after the longest gap. None means 1/|p| of the slowest
        pole: the filter forgets as fast as it learns.
    missing, stuck : {"decay", "keep", "reset"}
        What f_hat - f_theta does beyond the longest gap where samples are missing, lost or not finite, and where a
        sensor is stuck: decay to 0, stay, or be 0 at once.
    clock : {"keep", "reset"}
        What it does where the clock jumps: the time that passed is not known. The filter goes on from the new sample
        either way.
    stuck_after : int, optional
        So many equal values of a channel of x in a row are a stuck sensor: the repetitions are taken back and count as
        missing until the value changes. None: never, for a robot at rest may well give equal values.
    clock_jump : float
        A stamp so many seconds ahead of the last one is a clock that was set; anything less is a gap.

    Raises
    ------
    ValueError
        For times that are not positive, a clock jump that is no longer than the longest gap, fewer than 2 equal
        values, or an unknown word.

    Examples
    --------
    >>> LiveRules(longest_gap=0.1, decay_time=0.5).missing
    'decay'
    """

    longest_gap: float | None = None
    decay_time: float | None = None
    missing: After = "decay"
    stuck: After = "decay"
    clock: Literal["keep", "reset"] = "keep"
    stuck_after: int | None = None
    clock_jump: float = 60.0

    def __post_init__(self) -> None:
        for name in ("longest_gap", "decay_time", "clock_jump"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, _signals.number(name, value, "s", above=0.0))
        if self.longest_gap is not None and self.clock_jump <= self.longest_gap:
            raise ValueError(
                f"clock_jump: expected more than longest_gap = {self.longest_gap:g} s, got {self.clock_jump:g} s"
            )
        if self.stuck_after is not None:
            _signals.count("stuck_after", self.stuck_after, 2)
        for name in ("missing", "stuck", "clock"):
            words = ("keep", "reset") if name == "clock" else get_args(After)
            if (value := getattr(self, name)) not in words:
                raise ValueError(f"{name}: expected one of {', '.join(words)}, got {value!r}")

    def share(self, kind: str, gap: float) -> float:
        """What is left of f_hat - f_theta after a gap.

        Parameters
        ----------
        kind : str
            "stuck"; anything else is missing.
        gap : float
            Seconds since the last good sample.
        """
        longest, decay = self.longest_gap or 0.0, self.decay_time or 1.0
        after = self.stuck if kind == "stuck" else self.missing
        if gap <= longest or after == "keep":
            return 1.0
        return 0.0 if after == "reset" else math.exp(-(gap - longest) / decay)


def completed(rules: LiveRules, recursion: Recursion) -> LiveRules:
    """The rules with the times that it left open."""
    dt, longest, decay = recursion.sampling.dt, rules.longest_gap, rules.decay_time
    if longest is None:
        longest = recursion.longest_gap
    if longest < 2.0 * dt:
        raise ValueError(f"longest_gap: expected at least two nominal steps, {2.0 * dt:g} s, got {longest:g}")
    recursion.check_step(longest)
    decay = 1.0 / recursion.slowest if decay is None else decay
    jump = max(rules.clock_jump, 10.0 * longest)
    return replace(rules, longest_gap=longest, decay_time=decay, clock_jump=jump)


MEANING = {
    "missing": "calls without a measurement",
    "nonfinite": "samples with NaN, infinite or huge numbers",
    "stuck": "samples of a sensor that repeats itself",
    "lost": "samples that never came, by the time stamps",
    "late": "samples older than one already used: dropped",
    "duplicate": "samples of a time already used: dropped",
    "stamp": "samples whose time is not finite: dropped",
    "gap": "gaps longer than the longest",
    "clock_ahead": "jumps of the clock ahead",
    "clock_back": "jumps of the clock back",
}


@dataclass(frozen=True, repr=False)
class LiveHealth(Result):
    """What a live filter met so far.

    Attributes
    ----------
    accepted : int
        Good samples that entered the filter.
    counts : dict of str to int
        By kind: missing, nonfinite, stuck, lost, late, duplicate, stamp, gap, clock_ahead, clock_back.
    last : dict of str to float
        Time stamp at which each kind was met last.
    worst_gap : float
        Longest time between two good samples in seconds; with an open gap, that one's so far.
    time : float
        Last time stamp that was used; NaN before the first.
    """

    accepted: int = 0
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(MEANING, 0))
    last: dict[str, float] = field(default_factory=dict)
    worst_gap: float = 0.0
    time: float = math.nan

    def describe(self) -> str:
        """In words, one kind of event a line.

        Examples
        --------
        >>> print(LiveHealth(accepted=500, worst_gap=0.0021, time=1.0).describe())
        500 samples accepted up to 1 s, at most 0.0021 s apart; nothing else happened
        """
        head = f"{self.accepted} samples accepted up to {self.time:g} s, at most {self.worst_gap:.3g} s apart"
        met = [kind for kind, count in self.counts.items() if count]
        if not met:
            return head + "; nothing else happened"
        rows = [
            f"  {self.counts[kind]:6d} {MEANING[kind]}, last at {self.last.get(kind, math.nan):.6g} s"
            for kind in met
        ]
        return "\n".join([head, *rows])
