"""The front: recordings in, the force that the model missed out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import control as ct
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..filter import FilterBank, PhyFilter, SampledPhyFilter, stack
from ..filter.sampling import NonFinite, Rule
from ..recording import Recording
from ..recording.agreement import lag_sums, late_g, late_text
from ..results import Interval, Result
from .levels import separate
from .noise import Noise, given_noise
from .prediction import Prediction, prediction
from .spectrum import ResidualSpectrum
from .steps import Steps, mean_g, steps_of
from .suggestion import Search, Suggestion, Unlabelled, suggest

__all__ = ["Estimate", "checked_logs", "estimate", "sampled_for"]

_SAME_RATE = 0.02  # share by which a filter's step may differ from the recordings'
_NEARER = 0.5  # of the horizon: f held over the whole of it favours filters too slow for gusts
_APART = 4.0  # the two figures for a bandwidth disagree beyond this factor


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Result):
    """What the model missed in recordings; made by :func:`estimate`.

    Attributes
    ----------
    recordings : tuple of Recording
    filter : SampledPhyFilter
        The one given, else the one suggested.
    f_hat : tuple of (N, n_x) arrays
        The estimate of f for each recording.
    noise : Noise
        Of M x.
    noise_deviation : (n_x,) array
        Standard deviation of f_hat that comes from that noise: its noise band. What f_hat lags behind comes on top.
    error : Interval
        Root of the expected mean square of f - f_hat, noise and lag together, over time and channels. No label is used.
        The interval is a jackknife over recordings or stretches, with the noise found anew without each one; it counts
        on a residual that, above the frequency at which noise and residual cross, falls on as it does there. From 0 to
        inf where the two cannot be told apart: ``noise.message`` says why.
    missed : (n_x,) array
        Rms of what the model misses, f - f_theta, the noise taken out.
    explained : float
        Share of the mean square of f that f_hat explains: 1 - error^2 over that; 0 where all is noise.
    explained_by_model : float
        The same of f_theta alone; 0 where there is none.
    spectrum : ResidualSpectrum
    suggestion : Suggestion
        The filter of least expected error, beside a filter that is given.
    prediction : Prediction
    notes : tuple of str
        What to look at before trusting the figures.
    """

    _figures = (
        "names",
        "filter",
        "noise",
        "noise_deviation",
        "error",
        "missed",
        "explained",
        "explained_by_model",
        "spectrum",
        "suggestion",
        "prediction",
        "notes",
    )

    recordings: tuple[Recording, ...] = field(repr=False)
    filter: SampledPhyFilter
    f_hat: tuple[FloatArray, ...] = field(repr=False)
    noise: Noise
    noise_deviation: FloatArray
    error: Interval
    missed: FloatArray
    explained: float
    explained_by_model: float
    spectrum: ResidualSpectrum
    suggestion: Suggestion
    prediction: Prediction
    notes: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the recordings."""
        return tuple(log.name for log in self.recordings)

    def plot(
        self, recording: int = 0, *, ax: Sequence[Axes] | None = None, Hz: bool | None = None
    ) -> ct.ControlPlot:
        """f_hat of each channel with its noise band (95 %), f_theta and label where there are any, and the spectrum.

        Parameters
        ----------
        recording : int
            Which one.
        ax : n_x + 1 Axes, optional
            One for each channel and one for the spectrum; None makes a new figure.
        Hz : bool, optional
            The spectrum over Hz, its densities per Hz; None: python-control's setting ``freqplot.Hz``.

        Returns
        -------
        control.ControlPlot

        Raises
        ------
        ValueError
            If ``ax`` does not hold n_x + 1 axes.
        """
        from ..plots.missed import missed_plot

        log = self.recordings[recording]
        beside = {"f_theta": log.f_theta, "label": log.label}
        return missed_plot(
            log.times,
            self.f_hat[recording],
            1.96 * self.noise_deviation,
            {name: values for name, values in beside.items() if values is not None},
            (self.spectrum.omega, self.spectrum.residual.sum(axis=1), self.spectrum.noise.sum(axis=1)),
            channels=log.channels,
            title=log.name,
            ax=ax,
            Hz=Hz,
        )


def estimate(
    recordings: Recording | Sequence[Recording],
    filter: PhyFilter | FilterBank | SampledPhyFilter | None = None,
    *,
    orders: Sequence[int] = (1, 2),
    horizon: float = 0.2,
    confidence: float = 0.95,
    noise: Noise | ArrayLike | None = None,
    dt: float | None = None,
    g: Rule = "hold",
    f_theta: Rule = "average",
) -> Estimate:
    """The force that a model missed, how sure that is, and which filter shows it best: no label is needed.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        Of one robot: x, and what is known of M x' = g + f. Steps may differ, gaps are longer steps.
    filter : PhyFilter, FilterBank or SampledPhyFilter, optional
        None takes the one suggested. What is not sampled is sampled at ``dt``, with ``nonfinite="hold"`` where a
        recording misses samples.
    orders : sequence of int
        Orders to suggest from.
    horizon : float
        Of the prediction test, s; a filter that has to be chosen by prediction is by half of it.
    confidence : float
        Of all intervals. They are over the recordings where these are five or more, else over 12 stretches of them.
    noise : Noise, float or (n_x,) array, optional
        Of M x, by :meth:`Noise.at_rest` (a stretch at rest) or :meth:`Noise.known` (covariance, spectrum), or the
        deviation of white noise, such as ``smooth_label(log).noise``. None finds it in the recordings: white, else an
        autoregression.
    dt : float, optional
        Step in s of a filter that is not sampled yet. None takes that of the recordings, the median one of each, which
        must agree to 2 %.
    g, f_theta : {"hold", "average"}
        Between samples, as for :class:`Sampling`; a SampledPhyFilter has its own.

    Returns
    -------
    Estimate

    Raises
    ------
    TypeError
        If an argument is of another kind.
    ValueError
        If there are fewer than 100 steps in all, the recordings have different channels, the filter has a direction E
        or it or the noise another number of channels, the recordings have steps of their own and the filter none, or an
        option is out of range.

    Notes
    -----
    The noise is white where its spectrum is, above the frequency at which it crosses the residual; else it is an
    autoregression of order 1 or 2, if one fits and its filter predicts x no worse than any other. Otherwise, as where
    both share a band, ``noise.status`` is NOT_IDENTIFIED, and the suggestion is the filter that predicts x best.

    f_hat is meant for the end of each step, delays of x included (``filter`` sampled with ``delay``). A g that acts
    later than it is recorded is part of f, and no figure here counts that: ``notes`` say how late it seems. That g
    reacts to the noise of x does no harm.

    Examples
    --------
    A force of 2 sin(t), and velocity with noise of 5 mm/s at 100 Hz:

    >>> t = 0.01 * np.arange(6000)[:, None]
    >>> v = 2.0 * (1.0 - np.cos(t)) + 0.005 * np.random.default_rng(0).standard_normal(t.shape)
    >>> found = estimate(Recording.from_arrays(x=v, dt=0.01))
    >>> found.noise.value.round(3).tolist(), bool(found.missed[0].round(1) == 1.4)
    ([0.005], True)
    >>> truth = 2.0 * np.sin(t)
    >>> bool(found.error.low < np.sqrt(np.mean((truth - found.f_hat[0]) ** 2)) < found.error.high)
    True
    >>> found.prediction.improves
    True
    """
    logs = checked_logs(recordings)
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: expected a number between 0 and 1, got {confidence}")
    orders = [_signals.count("orders", order) for order in orders]
    if not orders:
        raise ValueError("orders: expected at least one, got none")
    horizon = _signals.duration("horizon", horizon)
    sampled = sampled_for(filter, logs, g, f_theta, dt)
    parts = steps_of(logs, sampled)
    several = separate(parts, given_noise(noise, logs), confidence)
    shared = sampled.with_filter(sampled.filters[0])  # the suggestion is one filter for all channels
    data, suggestion = suggest(several, Search(shared, parts, orders, _NEARER * horizon, confidence))
    level, spectrum = data.separated.noise, data.separated.spectrum
    if filter is None:
        sampled = sampled.with_filter(suggestion.filter)
    sampled.recursion.channels(logs[0].n_x)
    test = prediction(sampled, parts, horizon, confidence)
    missed, whole = _missed(data, logs)
    error = data.interval(sampled, confidence)
    return Estimate(
        tuple(logs),
        sampled,
        tuple(_run(sampled, log) for log in logs),
        level,
        data.noise_deviation(sampled, _step(logs)),
        error,
        missed,
        1.0 - error.value**2 / whole if spectrum.crossing > 0.0 else 0.0,
        1.0 - float(np.mean(missed**2)) / whole if any(log.f_theta is not None for log in logs) else 0.0,
        spectrum,
        suggestion,
        test,
        (
            *_late(logs, sampled, parts, missed),
            *_rate(sampled, logs),
            *_notes(level, suggestion, spectrum, test, error, given=filter is not None),
        ),
    )


def checked_logs(recordings: Recording | Sequence[Recording]) -> list[Recording]:
    """Recordings of one robot."""
    logs = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not logs:
        raise ValueError("recordings: expected at least one, got none")
    for i, log in enumerate(logs):
        if not isinstance(log, Recording):
            raise TypeError(f"recordings: expected Recordings, got {type(log).__name__} at place {i}")
        if log.channels != logs[0].channels:
            raise ValueError(
                f"recordings: expected one robot's, with the channels {', '.join(logs[0].channels)}, got "
                f"{', '.join(log.channels)} at place {i}"
            )
    return logs


def sampled_for(
    filter: PhyFilter | FilterBank | SampledPhyFilter | None,
    logs: Sequence[Recording],
    g: Rule,
    f_theta: Rule,
    dt: float | None = None,
) -> SampledPhyFilter:
    """The filter at the rate of the recordings; any one where there is none yet, for its sampling."""
    if isinstance(filter, SampledPhyFilter):
        if dt is not None:
            raise ValueError(
                "dt: expected it without a sampled filter, which has its own; leave one of the two out"
            )
        if filter.E is not None:
            raise ValueError(
                "filter: expected one without a direction E, for f has as many channels as x here"
            )
        return filter
    if filter is not None and not isinstance(filter, PhyFilter | FilterBank):
        raise TypeError(f"filter: expected a PhyFilter or a SampledPhyFilter, got {type(filter).__name__}")
    if dt is None:
        dt = _step(logs)
        if other := [log.dt for log in logs if abs(log.dt / dt - 1.0) > _SAME_RATE]:
            raise ValueError(
                f"recordings: their steps differ, {min(log.dt for log in logs):.6g} s to "
                f"{max(log.dt for log in logs):.6g} s ({len(other)} of {len(logs)} are off the median): at which step "
                "will the filter run? Give estimate(..., dt=), a filter that is sampled, or recordings by "
                "log.resample(dt)"
            )
    # It runs on the log that it came from: where that misses samples, it holds.
    hold: NonFinite = "hold" if any(log.missing.any() for log in logs) else "raise"
    if isinstance(filter, FilterBank):
        return stack([entry.sampled(dt, g=g, f_theta=f_theta, nonfinite=hold) for entry in filter])
    return (filter or PhyFilter([1.0])).sampled(dt, g=g, f_theta=f_theta, nonfinite=hold)


def _run(sampled: SampledPhyFilter, log: Recording) -> FloatArray:
    """f_hat; across missing samples the estimate of the residual stays."""
    over_gaps = replace(sampled, sampling=replace(sampled.sampling, nonfinite="hold"))
    return np.asarray(over_gaps.run(log.x, log.g, log.f_theta, log.inertia, log.times), dtype=float)


def _step(logs: Sequence[Recording]) -> float:
    """Of the recordings, to twelve digits: times rarely give it to the last bit, and people read a filter's file."""
    return float(f"{np.median([log.dt for log in logs]):.12g}")


def _late(
    logs: Sequence[Recording], sampled: SampledPhyFilter, parts: Sequence[Steps], missed: FloatArray
) -> list[str]:
    """Channels whose g acts later than it is recorded."""
    sums = []
    for log, part in zip(logs, parts, strict=True):
        if (g := mean_g(log, sampled, part)) is not None:
            sums.append(lag_sums(part.u, g, part.dt, None if part.uniform else part.h[:, 0]))
    found = []
    for j, name in enumerate(logs[0].channels):
        if late := late_g([own[j] for own in sums if own], float(missed[j])):
            found.append(late_text(late, name))
    return found


def _rate(sampled: SampledPhyFilter, logs: Sequence[Recording]) -> list[str]:
    """A filter made for other steps is told, since figures are of the steps that the recordings have."""
    if abs(sampled.dt / _step(logs) - 1.0) <= _SAME_RATE:
        return []
    return [
        f"the filter is made for steps of {sampled.dt:g} s and the recordings have {_step(logs):g} s: all figures are "
        "of F at the recordings' steps; at its own its noise is another"
    ]


def _missed(data: Unlabelled, logs: Sequence[Recording]) -> tuple[FloatArray, float]:
    """Rms of f - f_theta by channel, and the mean square of f, both without the noise."""
    squares, whole = np.maximum(data.mean(None), 0.0), 0.0
    total = sum(part.dt * len(u) for part, u in zip(data.parts, data.signals, strict=True))
    for k, (part, u, log) in enumerate(zip(data.parts, data.signals, logs, strict=True)):
        model = np.zeros_like(u)
        if log.f_theta is not None:
            middle = part.times[0] + part.dt * (np.arange(len(u)) + 0.5)
            known = log.f_theta[part.samples]
            model = np.stack([np.interp(middle, part.grid_times, column) for column in known.T], axis=1)
        beside = data.correction(k, None, [data.separated.levels])[0]
        power = (u + data.passed(model, part.dt)) ** 2 + beside
        whole += part.dt * float(power.mean(axis=1).sum()) / total
    return np.sqrt(squares), max(whole, 1e-300)


def _notes(
    noise: Noise,
    suggestion: Suggestion,
    spectrum: ResidualSpectrum,
    test: Prediction,
    error: Interval,
    *,
    given: bool,
) -> list[str]:
    found = []
    if not noise.is_white and noise.source == "flight":
        worst = float(noise.colour[np.argmax(np.abs(np.log(np.maximum(noise.colour, 1e-300))))])
        found.append(
            f"the noise is not white above half of the Nyquist frequency (power ratio {worst:.2g}, expected 1): x "
            "comes out of an estimator, or the force reaches up there; noise level and bandwidth are less sure"
        )
    if noise.message != "converged":
        found.append(noise.message)
    if suggestion.status == "converged" and suggestion.message != "converged":
        found.append(f"the suggested filter: {suggestion.message}")
    if suggestion.status != "converged":
        found.append(suggestion.message)
    else:
        bandwidth = suggestion.bandwidth
        if not 1.0 / _APART < bandwidth / spectrum.crossing < _APART and spectrum.crossing < math.inf:
            found.append(
                f"the suggested bandwidth ({bandwidth:.3g} rad/s) and the one at which noise and residual cross "
                f"({spectrum.crossing:.3g} rad/s) differ by more than {_APART:g} times: try both"
            )
    if not test.improves:
        found.append(
            f"f_hat does not predict x {test.horizon:g} s ahead better than the model alone: there may be nothing to "
            "estimate, or not at this bandwidth"
        )
    if given and suggestion.error.value < 0.9 * error.value:
        found.append(
            f"the suggested filter is expected to err {100.0 * (1.0 - suggestion.error.value / error.value):.0f} % less"
        )
    return found
