"""From what a robot file says to recordings of its logs."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import numpy as np

from .._intake import LARGEST
from .._sections import FloatArray
from ..recording import Recording, checks
from .clocks import Evaluated, Track, step_means, values_at
from .document import RobotSignal
from .expressions import Expression, Functions, constant
from .tracks import track_of

if TYPE_CHECKING:
    from ..logfiles import LogFile

__all__ = ["Constant", "Reading"]

Constant = float | list[float] | list[list[float]]


@dataclass(frozen=True, eq=False, repr=False)
class Reading:
    """What a robot file says, and how a log is read by it; see :class:`Robot`, which documents it."""

    path: Path
    preset: str
    name: str
    time_unit: str
    time: str
    constants: Mapping[str, Constant]
    clocks: Mapping[str, float]
    signals: Mapping[str, RobotSignal]
    expressions: Mapping[str, str]
    model: Mapping[str, str | tuple[str, ...]]
    functions: Functions

    def __call__(self, log: str | os.PathLike[str] | LogFile) -> Recording:
        """As :meth:`read`: a robot is a function from a log to a recording."""
        return self.read(log)

    def read(self, log: str | os.PathLike[str] | LogFile) -> Recording:
        """A log as a recording on the clock of x.

        Row k of g is the mean of g over the step from sample k to k + 1, made of all signals on their own clocks: for
        ``Sampling`` with g="hold" and f_theta="average", the usual ones, with which the residual of every step is exact
        where g is piecewise constant or linear. f_theta is read at the samples, where the filter adds it; what its mean
        over a step differs from the mean of its ends is put into g. Vectors are in world ENU and body FLU.

        Samples before and after everything is known are left out. Between them, what is not known is NaN
        (``Recording.missing``, ``nonfinite="keep"``): run it by a filter with ``nonfinite="hold"``, learn from
        ``pieces()``.

        Parameters
        ----------
        log : str, path-like or LogFile
            A file that ``open_log`` reads, or what it gave.

        Returns
        -------
        Recording

        Raises
        ------
        OSError
            If a file cannot be read.
        ValueError
            If a topic, field or unit is missing or wrong, a clock runs back, shapes do not go together, or the signals
            have no two samples of x in common.
        """
        log = self.opened(log)
        tracks = self._tracks(log)
        try:
            return self._recording(tracks, Path(log.path).stem)
        except ValueError as error:
            if str(self.path) in str(error):
                raise
            raise ValueError(f"{self.path}: {error}") from error

    @cached_property
    def _texts(self) -> dict[str, str]:
        """All expressions by where they stand."""
        kinds = ("x", "M", "g", "f_theta", "features", "label")
        return {f"expressions.{k}": text for k, text in self.expressions.items()} | {
            f"model.{k}": self._text(k) for k in kinds if k in self.model
        }

    def _text(self, key: str) -> str:
        text = self.model[key]
        return text if isinstance(text, str) else ""

    @cached_property
    def _needs(self) -> dict[str, frozenset[str]]:
        return {name: Expression(text, self.functions).names for name, text in self.expressions.items()}

    def _bases(self, texts: Iterable[str]) -> list[str]:
        """Signals that expressions rest on, in order of the file."""
        waiting = [name for text in texts for name in Expression(text, self.functions).names]
        seen: set[str] = set()
        while waiting:
            if (name := waiting.pop()) not in seen:
                seen.add(name)
                waiting += self._needs.get(name, ())
        return [name for name in self.signals if name in seen]

    def _evaluated(self, key: str) -> Evaluated:
        """What a part of the model says, as a function of the values of the signals."""

        def of(signals: Mapping[str, FloatArray]) -> FloatArray:
            values = {name: constant(value) for name, value in self.constants.items()} | dict(signals)
            waiting = [(self._text(key), "")]
            while waiting:
                current, name = waiting[-1]
                needed = [n for n in Expression(current, self.functions).names if n not in values]
                if needed:
                    waiting += [(self.expressions[n], n) for n in needed]
                    continue
                waiting.pop()
                try:
                    result = Expression(current, self.functions)(values)
                except ValueError as error:
                    where = f"expressions.{name}" if name else f"model.{key}"
                    raise ValueError(f"{self.path}: {where}: {error}") from error
                if not name:
                    return result
                values[name] = result
            raise AssertionError("no expression")

        return of

    # -- reading ------------------------------------------------------------------------------------------------

    def opened(self, log: str | os.PathLike[str] | LogFile, largest: int = LARGEST) -> LogFile:
        """The log itself, or the one in a file, of which a reading may take ``largest`` bytes of memory."""
        if isinstance(log, str | os.PathLike):
            from ..logfiles import open_log
            from ..logfiles.clock import TimeUnit

            unit = next((u for u in get_args(TimeUnit) if u == self.time_unit), None)
            return open_log(log, time_unit=unit, time=self.time or None, largest=largest)
        return log

    def _tracks(self, log: LogFile) -> dict[str, Track]:
        used = self._bases(text for where, text in self._texts.items() if where.startswith("model."))
        return {name: track_of(self.path, name, self.signals[name], log, self.clocks) for name in used}

    def _recording(self, tracks: Mapping[str, Track], name: str) -> Recording:
        times = self._clock(tracks).times
        x = self._sampled(tracks, times, "x")
        n_x = x.shape[1]
        found: dict[str, FloatArray | None] = {"x": x, "g": None}
        found["inertia"] = self._inertia(tracks, times, n_x) if "M" in self.model else None
        if "g" in self.model:
            found["g"] = self._means(tracks, times, "g", n_x)
        if "f_theta" in self.model or "f_theta_file" in self.model:
            f_theta = found["f_theta"] = self._wide("f_theta", self._sampled(tracks, times, "f_theta"), n_x)
            means = self._means(tracks, times, "f_theta", n_x)
            extra = means - 0.5 * (f_theta + np.concatenate([f_theta[1:], f_theta[-1:]]))
            extra[-1] = 0.0
            found["g"] = extra if found["g"] is None else found["g"] + extra
        for key in ("label", "features"):
            if key in self.model:
                values = self._sampled(tracks, times, key)
                found[key] = values if key == "features" else self._wide(key, values, n_x)
        return self._trimmed(tracks, times, found, name)

    def _clock(self, tracks: Mapping[str, Track]) -> Track:
        names = self._bases([self._text("x")])
        if "clock" in self.model:
            if (clock := self._text("clock")) not in tracks:
                raise ValueError(
                    f"{self.path}: model.clock: expected one of {', '.join(tracks)}, got {clock!r}"
                )
            return tracks[clock]
        first = tracks[names[0]]
        for name in names[1:]:
            if not np.array_equal(tracks[name].times, first.times):
                raise ValueError(
                    f"{self.path}: model.x is made of {names[0]} and {name}, which have different clocks; say by "
                    f'model.clock whose samples count, such as clock = "{names[0]}"'
                )
        return first

    def _function(self, key: str) -> tuple[list[str], Evaluated]:
        """The signals that a part of the model rests on, and what makes it of them."""
        if key == "f_theta" and "f_theta_file" in self.model:
            from ..learned import learned_model

            path = self.path.parent / self._text("f_theta_file")
            features, model = self._evaluated("features"), learned_model(path)

            def predicted(signals: Mapping[str, FloatArray]) -> FloatArray:
                z = _columned(features(signals))
                good = np.isfinite(z).all(axis=1)
                f_theta = model.predict(z[good] if good.any() else np.zeros((1, z.shape[1])))
                found = np.full((len(z), f_theta.shape[1]), np.nan)
                found[good] = f_theta[: int(good.sum())]
                return found

            return self._bases([self._text("features")]), predicted
        return self._bases([self._text(key)]), self._evaluated(key)

    def _sampled(self, tracks: Mapping[str, Track], times: FloatArray, key: str) -> FloatArray:
        names, evaluate = self._function(key)
        return _columned(values_at({name: tracks[name] for name in names}, evaluate, times))

    def _means(self, tracks: Mapping[str, Track], times: FloatArray, key: str, n_x: int) -> FloatArray:
        """Means over the steps (N, n_x); the last row, after which there is no step, repeats the one before."""
        names, evaluate = self._function(key)
        used = {name: tracks[name] for name in names}
        means = self._wide(key, _columned(step_means(used, evaluate, times)), n_x)
        return np.concatenate([means, means[-1:]])

    def _wide(self, key: str, values: FloatArray, n_x: int) -> FloatArray:
        if values.shape[1] not in (1, n_x):
            raise ValueError(
                f"{self.path}: model.{key}: expected {n_x} entries, as x has, got {values.shape[1]}"
            )
        return np.array(np.broadcast_to(values, (len(values), n_x)))

    def _inertia(self, tracks: Mapping[str, Track], times: FloatArray, n_x: int) -> FloatArray:
        names, evaluate = self._function("M")
        if not names:
            M = evaluate({})[0]
        else:
            M = np.array(values_at({name: tracks[name] for name in names}, evaluate, times))
            M = np.repeat(M[:, None], n_x, axis=1) if M.ndim == 1 else M
        own = M.shape[1:] if names else M.shape
        if own not in ((), (n_x,), (n_x, n_x)):
            raise ValueError(f"{self.path}: model.M: expected a number, {n_x} or {n_x} x {n_x}, got {own}")
        return M

    def _trimmed(
        self,
        tracks: Mapping[str, Track],
        times: FloatArray,
        found: Mapping[str, FloatArray | None],
        name: str,
    ) -> Recording:
        """From the first sample at which all is known to the last, at the end of a step whose g is."""
        n = len(times)
        g, points = found["g"], np.full(n, True)
        for key, value in found.items():
            if value is not None and key != "g" and (key != "inertia" or checks.inertia_varies(value, n)):
                points &= np.asarray(np.isfinite(value.reshape(n, -1)).all(axis=1))
        steps = np.full(n, True) if g is None else np.asarray(np.isfinite(g).all(axis=1))
        begins, ends = np.flatnonzero(points & steps), np.flatnonzero(points[1:] & steps[:-1]) + 1
        if not (len(begins) and len(ends) and begins[0] < ends[-1]):
            raise ValueError(f"{self.path}: {_nothing_in_common(tracks)}")
        kept = slice(int(begins[0]), int(ends[-1]) + 1)
        if g is not None:
            g[kept.stop - 1] = g[kept.stop - 2]  # no step comes after it
        M = found["inertia"]
        cut = {
            key: None if value is None else value[kept] for key, value in found.items() if key != "inertia"
        }
        if M is not None:
            cut["inertia"] = checks.picked_inertia(M, n, kept.stop - kept.start, lambda values: values[kept])
        whole = points[kept].all() and steps[kept][:-1].all()
        channels = self.model.get("channels")
        return Recording.from_arrays(
            times=times[kept],
            **cut,  # pyright: ignore[reportArgumentType]
            name=name,
            channels=channels if isinstance(channels, tuple) else None,
            unit=self._text("unit") if "unit" in self.model else "",
            nonfinite="raise" if whole else "keep",
        )


def _columned(values: FloatArray) -> FloatArray:
    return values[:, None] if values.ndim == 1 else values


def _nothing_in_common(tracks: Mapping[str, Track]) -> str:
    spans = [
        f"{name} from {track.times[0]:.6g} to {track.end:.6g} s, every {np.median(np.diff(track.times)):.3g} s"
        for name, track in tracks.items()
    ]
    return (
        "expected two samples of x at which everything is known, got none or one; the signals: "
        f"{'; '.join(spans)}; set clocks, delays and gaps, or look for NaN in the log"
    )
