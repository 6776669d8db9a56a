"""A recording in the designer: the estimate on it, thinned for drawing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._sections import FloatArray
from ..recording import Recording
from ..recording.checks import is_jump
from ..results import plain
from .checking import MessageError, shown
from .designs import Design
from .views import Peaks, Views, at_once, run

__all__ = ["estimate", "summary"]

_DRAWN = 1500
_SAME_STEP = 1e-3
_GAP = 3.0  # medians: lines break at a longer step


def summary(log: Recording) -> dict[str, object]:
    """What a reply says of a log.

    Parameters
    ----------
    log : Recording

    Returns
    -------
    dict
    """
    held = [key for key in ("label", "g", "f_theta", "inertia") if getattr(log, key) is not None]
    return {
        "name": log.name,
        "samples": log.n,
        "dt": log.dt,
        "channels": list(log.channels),
        "has_label": log.label is not None,
        "has_f_theta": log.f_theta is not None,
        "columns": ["times", "x", *held],
    }


def estimate(
    log: Recording,
    design: Design,
    channel: int,
    wiener: Sequence[float] | None,
    *,
    window: Sequence[float] | None = None,
    views: Views,
) -> dict[str, object]:
    """The reply to op "estimate": the filter run on one channel of the log, at the log's own rate.

    Of a long log a part is run over with what comes before it, as far as it matters; the whole in the background:
    until that is done ``f_hat`` is null and ``pending`` true.

    Parameters
    ----------
    log : Recording
    design : Design
    channel : int
    wiener : sequence of float, optional
        RMSE of the causal Wiener filter for each channel, where known. It is over the samples of ``rmse``, each block
        of them by a response fitted without it; a filter fitted to the block as well may have a lower ``rmse``.
    window : (2,) sequence of float, optional
        First and last time in s that is drawn; None means all of them. The errors are over the samples that the reply
        says in ``over``: the whole log where the filter has run over it.
    views : Views
        What has been computed of the log.

    Raises
    ------
    MessageError
        If there is no such channel, or the window begins after its end.
    ValueError
        If forward Euler diverges at the log's step.
    """
    if channel >= log.n_x:
        raise MessageError(
            "channel", f"expected 0 to {log.n_x - 1} of {_some(list(log.channels))}, got {channel}"
        )
    seen = _seen(log.times, window)
    most = at_once(log)
    mine, over = None, slice(0, log.n)
    if log.n <= most:
        mine = run(log, design, channel, over)
    elif (peaks := views.ready(log, design, channel)) is not None:
        mine = peaks.values
    elif seen.stop - seen.start <= most:
        mine, over = run(log, design, channel, seen), seen
    else:
        peaks = views.whole(log, design, channel)
        mine = None if peaks is None else peaks.values
    f_theta = None if log.f_theta is None else log.f_theta[:, channel]
    label = None if log.label is None else log.label[:, channel]
    if log.n <= most:
        keep = seen.start + _drawn([each[seen] for each in (mine, f_theta, label) if each is not None])
    else:
        keep = _kept(log, channel, seen, mine, over, views, design)
    messages = []
    gaps = np.flatnonzero(np.diff(log.times) > _GAP * log.dt)
    messages += _jumps(log, gaps)
    if abs(log.dt - design.dt) > _SAME_STEP * design.dt:
        messages.append(
            f"The log has a step of {log.dt:.4g} s, which the estimate takes; the design has {design.dt:.4g} s."
        )
    errors = _errors(log, design, channel, mine, over, views)
    # Between two samples that are drawn lies a gap: a point without a value breaks the lines there.
    breaks = np.flatnonzero(np.diff(np.searchsorted(gaps, keep))) + 1
    t = np.insert(log.times[keep], breaks, 0.5 * (log.times[keep[breaks - 1]] + log.times[keep[breaks]]))

    def drawn(values: FloatArray) -> object:
        return plain(np.insert(np.asarray(values, dtype=float), breaks, np.nan))

    return {
        "t": plain(t),
        "f_hat": None if mine is None else drawn(mine[keep - over.start]),
        "f_theta": None if f_theta is None else drawn(f_theta[keep]),
        "label": None if label is None else drawn(label[keep]),
        "rmse": errors[0],
        "rmse_model": errors[1],
        "wiener": None if wiener is None or over != slice(0, log.n) else wiener[channel],
        "over": _over(log, over),
        "pending": mine is None,
        "messages": messages,
    }


def _jumps(log: Recording, gaps: np.ndarray) -> list[str]:
    """What is said of a clock that was set."""
    steps = np.diff(log.times)[gaps]
    jumped = is_jump(steps, log.dt)
    if not jumped.any():
        return []
    k = int(np.argmax(jumped))
    return [
        f"The clock jumps ahead by {steps[k]:.6g} s after {log.times[gaps[k]]:.6g} s: the estimate goes on from the "
        "next sample. Draw a part to see more."
    ]


def _kept(
    log: Recording,
    channel: int,
    seen: slice,
    mine: FloatArray | None,
    over: slice,
    views: Views,
    design: Design,
) -> np.ndarray:
    """Samples of a long log that are drawn."""
    held = [name for name in ("label", "f_theta") if getattr(log, name) is not None]
    most = _DRAWN // (len(held) + (mine is not None) or 1)
    kept = [views.peaks(log, name, channel).drawn(seen.start, seen.stop, most) for name in held]
    if mine is not None and over == seen:
        kept.append(seen.start + Peaks.of(mine).drawn(0, len(mine), most))
    elif mine is not None and (whole := views.ready(log, design, channel)) is not None:
        kept.append(whole.drawn(seen.start, seen.stop, most))
    return np.unique(np.concatenate(kept)) if kept else np.array([seen.start, seen.stop - 1])


def _errors(
    log: Recording, design: Design, channel: int, mine: FloatArray | None, over: slice, views: Views
) -> tuple[float | None, float | None]:
    """RMSE of f_hat and of the model alone; those over a whole log are computed once."""
    if log.label is None or mine is None:
        return None, None
    label, f_hat = log.label[over, channel], mine
    f_theta = 0.0 if log.f_theta is None else log.f_theta[over, channel]

    def found() -> tuple[float | None, float | None]:
        return _rms(label - f_hat), _rms(label - f_theta)

    return views.errors(log, design, channel, found) if len(f_hat) == log.n else found()


def _over(log: Recording, samples: slice) -> str:
    """In words, which samples an error is over; the first has none, f_hat is f_theta there."""
    first, last = log.times[samples.start], log.times[samples.stop - 1]
    count = f"{samples.stop - samples.start - 1:,}".replace(",", "\u202f")
    what = "the whole log" if samples == slice(0, log.n) else "the part drawn"
    return f"over {what}, {count} samples after {first:.6g} s, up to {last:.6g} s"


def _rms(error: FloatArray) -> float | None:
    """Without the first sample, where f_hat = f_theta."""
    value = float(np.sqrt(np.mean(error[1:] ** 2)))
    return value if np.isfinite(value) else None


def _seen(times: FloatArray, window: Sequence[float] | None) -> slice:
    """Samples of the window, and one to either side so that lines reach its edges; two at least."""
    if window is None:
        return slice(0, len(times))
    low, high = window
    if not low < high:
        raise MessageError("window", f"expected a first time before the last, got {low:g} and {high:g} s")
    first, last = np.searchsorted(times, [low, high]).tolist()
    first = min(max(first - 1, 0), len(times) - 2)
    return slice(first, max(min(last + 1, len(times)), first + 2))


def _drawn(series: Sequence[FloatArray]) -> np.ndarray:
    """Samples to draw: in every interval the least and the largest of each series, so no peak is lost."""
    n = len(series[0])
    if n <= _DRAWN:
        return np.arange(n)
    edges = np.linspace(0, n, _DRAWN // (2 * len(series)) + 1).astype(np.intp)
    kept: list[int] = []
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        for values in series:
            part = values[first:last]
            kept += [first + int(np.argmin(part)), first + int(np.argmax(part))]
    return np.unique(kept)


def _some(names: Sequence[str]) -> str:
    more = ", ..." if len(names) > 6 else ""
    return ", ".join(shown(name) for name in names[:6]) + more
