"""The tests of ``Separation.changes`` beside a filter that runs: jumps begin in turn, each is followed for a while."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from .._sections import FloatArray
from ..estimation.separation.changes import Schedule

__all__ = ["Update", "Watch"]

# Relative: keeps what leaves no signature from dividing nothing by nothing.
_TINY, _LEAST = 1e-14, 1e-300


@dataclass(frozen=True, eq=False)
class Update:
    """One channel's measurement, of a noise of variance 1: row (1, n), P row', innovation and its variance."""

    row: ca.SX
    cross: ca.SX
    variance: ca.SX
    innovation: ca.SX


@dataclass(frozen=True, eq=False)
class Watch:
    """As many jumps at a time as begin before the first has reached the last age.

    Attributes
    ----------
    schedule : Schedule
    own : list of int
        Scalars of the part that is watched.
    n_x, n : int
        Channels, and states of the filter.
    restart : bool
    """

    schedule: Schedule
    own: list[int]
    n_x: int
    n: int
    restart: bool

    @property
    def places(self) -> int:
        """Jumps at a time."""
        return math.ceil(self.schedule.ages[-1] / self.schedule.every)

    def first(self) -> dict[str, ca.SX]:
        """State at the first sample: nothing is followed yet."""
        p, places = len(self.own), self.places
        return {
            "phase": ca.SX(0),
            "quiet": ca.SX(self.schedule.ages[-1]),
            "jumps": ca.SX(0),
            "trace": ca.SX.zeros(self.n, p * places),
            "score": ca.SX.zeros(p, places),
            "information": ca.SX.zeros(p, p * places),
        }

    def step(
        self,
        before: Mapping[str, ca.SX],
        moved: ca.SX,
        F: ca.SX,
        done: list[Update],
        z: ca.SX,
        P: ca.SX,
        prior: FloatArray,
    ) -> tuple[ca.SX, ca.SX, dict[str, ca.SX], dict[str, ca.SX]]:
        """A step of all tests: the filter's state and covariance, the tests' state, and what is put out.

        Parameters
        ----------
        before : mapping
            State of the tests.
        moved : (n, p)
            What a jump does to the filter's state where it begins.
        F : (n, n)
            Transition of the step.
        done : list of Update
            The measurements at its end.
        z, P : (n,), (n, n)
            State and covariance after them.
        prior : (p,) array
            Variances of the part's scalars.
        """
        D, score, information = self._followed(before, moved, F, done)
        best = self._best(before["phase"], D, score, information)
        over, gap = best["statistic"] > self.schedule.threshold, before["quiet"] + 1.0
        alarm = ca.logic_and(over, gap > self.schedule.ages[-1])
        seen = {
            "phase": ca.if_else(
                before["phase"] + 1.0 < self.places * self.schedule.every, before["phase"] + 1.0, 0.0
            ),
            "quiet": ca.if_else(over, 0.0, gap),
            "jumps": before["jumps"],
            "trace": D,
            "score": score,
            "information": information,
        }
        if self.restart:
            spread = ca.inv(best["information"] + ca.diag(ca.DM(1.0 / prior)))
            size = ca.mtimes(spread, best["score"])
            z = ca.if_else(alarm, z + ca.mtimes(best["trace"], size), z)
            P = ca.if_else(alarm, P + ca.mtimes([best["trace"], spread, best["trace"].T]), P)
            # Jumps that were followed were those of another filter.
            seen |= {key: ca.if_else(alarm, 0.0, seen[key]) for key in ("trace", "score", "information")}
            seen["quiet"] = ca.if_else(alarm, float(self.schedule.ages[-1]), seen["quiet"])
            seen["jumps"] = before["jumps"] + alarm
        return z, P, seen, {"alarm": alarm, **{key: best[key] for key in ("statistic", "age", "jump")}}

    def _followed(
        self, before: Mapping[str, ca.SX], moved: ca.SX, F: ca.SX, done: list[Update]
    ) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Traces in the error of the state, scores and information of all jumps a step later."""
        p = len(self.own)
        begins = [before["phase"] == j * self.schedule.every for j in range(self.places)]
        each = ca.horzcat(*begins)
        wide = ca.horzcat(*(begin for begin in begins for _ in range(p)))
        D = ca.if_else(
            ca.repmat(wide, self.n, 1), ca.repmat(ca.densify(moved), 1, self.places), before["trace"]
        )
        score = ca.if_else(ca.repmat(each, p, 1), 0.0, before["score"])
        information = ca.if_else(ca.repmat(wide, p, 1), 0.0, before["information"])
        D = ca.mtimes(F, D)
        for channel in done:
            seen = ca.mtimes(channel.row, D)
            weighted = seen / channel.variance
            by_jump = ca.reshape(seen, p, self.places)
            score = score + ca.reshape(weighted, p, self.places) * channel.innovation
            information = information + ca.horzcat(
                *(ca.mtimes(by_jump[:, j], weighted[:, j * p : (j + 1) * p]) for j in range(self.places))
            )
            D = D - ca.mtimes(channel.cross, weighted)
        return D, score, information

    def _best(self, phase: ca.SX, D: ca.SX, score: ca.SX, information: ca.SX) -> dict[str, ca.SX]:
        """Of the jumps that are tested now the one of the largest statistic."""
        p, every, cycle = len(self.own), self.schedule.every, self.places * self.schedule.every
        best = {
            "statistic": ca.SX(0),
            "age": ca.SX(0),
            "jump": ca.SX.zeros(p, 1),
            "trace": ca.SX.zeros(self.n, p),
            "score": ca.SX.zeros(p, 1),
            "information": ca.SX.zeros(p, p),
        }
        for j in range(self.places):
            own = slice(j * p, (j + 1) * p)
            A = information[:, own]
            jump = ca.mtimes(ca.inv(A + (_TINY * ca.trace(A) + _LEAST) * ca.SX.eye(p)), score[:, j])
            age = ca.if_else(phase >= j * every, phase - j * every, phase - j * every + cycle) + 1.0
            tested = ca.sum1(ca.vertcat(*(age == value for value in self.schedule.ages)))
            values = {
                "statistic": tested * ca.dot(score[:, j], jump),
                "age": age,
                "jump": jump,
                "trace": D[:, own],
                "score": score[:, j],
                "information": A,
            }
            larger = values["statistic"] > best["statistic"]
            best = {key: ca.if_else(larger, values[key], best[key]) for key in best}
        return best
