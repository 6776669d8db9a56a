"""How far a loop with the filter in it strays from its reference: tubes from bounds, bands from variances.

For a linear loop p = sum of kernels over what disturbs it, and with each of these bounded

    |p| <= sum_i ||K_i||_L1 sup |d_i|

whatever they do, and some course of each reaches its term (C. A. Desoer, M. Vidyasagar, "Feedback Systems:
Input-Output Properties", 1975, section II.4). For stationary Gaussian ones p is Gaussian, of a variance that a Lyapunov
equation gives; its band holds at each time by itself, not along a whole flight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast, get_args, overload

import control as ct
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_discrete_lyapunov
from scipy.stats import norm

from .. import _signals
from .._sections import FloatArray
from ..filter import PhyFilter, SampledBank, SampledPhyFilter
from ..results import PerChannel, Result, in_lines, with_unit
from ..values import Bounded, Bounds, Gaussian, Loop
from ..values.disturbance import bounded, shaping
from .channels import Filter, per_channel
from .margins.filter_margins import build_loop, checked_loop
from .margins.sampled import SampledLoop
from .options import assumed, inertia_of, units_of
from .tracking_loop import Noisy, Output, Source, TrackingLoop

__all__ = ["TrackingDeviation", "TrackingTube", "tracking_error"]

_SOURCES: tuple[Source, ...] = get_args(Source)
_NOISY: tuple[Noisy, ...] = get_args(Noisy)


@dataclass(frozen=True, eq=False, repr=False)
class TrackingTube(Result):
    """Largest error of position that bounded disturbances force; made by :func:`tracking_error`.

    Parameters
    ----------
    parts, command_parts : dict of str to float
        What each of residual, actuation, noise and position_noise adds to ``radius`` and ``command``.
    derivatives : dict of str to list of int
        Which derivative of each part of residual and actuation counts: of several bounds, the one that gives least.
    estimate_parts : dict of str to float
        What each of them adds to ``estimate``.
    command_limit, estimate_limit : float
        Of the part of the command that is fed back, and of f_hat.
    assumptions : tuple of str
        What is taken for granted of the options of the filter.
    given : dict of str to list of dict of int to float
        Bounds on the derivatives of each part, per unit of M_hat.
    _loop : TrackingLoop
        The sampled loop and its kernels.
    """

    _figures = (
        "radius",
        "is_linear",
        "parts",
        "derivatives",
        "command",
        "command_parts",
        "command_limit",
        "estimate",
        "estimate_limit",
        "assumptions",
    )
    _answer = ("radius",)

    parts: dict[str, float]
    derivatives: dict[str, list[int]]
    command_parts: dict[str, float]
    estimate_parts: dict[str, float]
    command_limit: float
    estimate_limit: float
    assumptions: tuple[str, ...]
    given: dict[Source, list[dict[int, float]]] = field(repr=False)
    _loop: TrackingLoop = field(repr=False)

    @property
    def radius(self) -> float:
        """Largest error of position at the samples, once the start is forgotten; inf where nothing is proved, since the
        command or f_hat may meet a limit."""
        return float(sum(self.parts.values())) if self.is_linear else float("inf")

    @property
    def command(self) -> float:
        """Largest part of the command that is fed back, in units of f."""
        return float(sum(self.command_parts.values()))

    @property
    def estimate(self) -> float:
        """Largest |f_hat|, in units of f."""
        return float(sum(self.estimate_parts.values()))

    @property
    def is_linear(self) -> bool:
        """Whether command and f_hat stay within their limits, so that the loop is the linear one and the tube is
        proved."""
        return self.command <= self.command_limit and self.estimate <= self.estimate_limit

    def envelope(
        self, times: ArrayLike, *, position: float = 0.0, velocity: float = 0.0, residual: float = 0.0
    ) -> FloatArray:
        """Bound on the error of position over time after a start at rest, at the samples at or after each time.

        Parameters
        ----------
        times : (N,) array
            Seconds since the start.
        position, velocity, residual : float
            Bounds on the errors at the start and on |f| then, which the filter does not know yet.

        Returns
        -------
        (N,) array
            It tends to ``radius``.
        """
        loop, h = self._loop, self._loop.sampled.dt
        steps = np.ceil(np.maximum(_signals.array("times", times, ("N",)), 0.0) / h - 1e-9).astype(int)
        count = int(steps.max()) + 1
        bound = np.full(count, self.radius - sum(self.parts.get(s, 0.0) for s in _SOURCES))
        for source, parts in self.given.items():
            for k, sizes in zip(self.derivatives[source], parts, strict=True):
                bound += loop.running(source, k, count) * sizes[k]
        bound += position * loop.released("position", count) + velocity * loop.released("velocity", count)
        if residual:
            c, pieces = loop.row("position"), loop.pieces("residual", 1)[0]
            bound += residual / loop.inertia * np.abs(loop.powers(c, count) @ pieces)
        return bound[steps]

    def _unit_of(self, name: str) -> str:
        units = units_of(self._loop.sampled)
        if name in ("radius", "parts"):
            return _position_unit(units)
        return units.get("f", "") if name in ("command", "command_parts", "command_limit", "estimate") else ""

    def describe(self) -> str:
        """The tube as text, one line each.

        Returns
        -------
        str
        """
        units = units_of(self._loop.sampled)
        position, f = _position_unit(units), units.get("f", "")
        lines = {"radius": with_unit(self.radius, position) if self.is_linear else "not proved"}
        lines |= {f"  {n.replace('_', ' ')}": with_unit(value, position) for n, value in self.parts.items()}
        for name in ("command", "estimate"):
            most, limit = getattr(self, name), getattr(self, f"{name}_limit")
            lines[name] = with_unit(most, f)
            if np.isfinite(limit):
                lines[f"  limit of {name}"] = f"{with_unit(limit, f)}, {self._met(most, limit)}"
        return in_lines(lines | {"taken for granted": "; ".join(self.assumptions)})

    @staticmethod
    def _met(most: float, limit: float) -> str:
        if most <= limit:
            return "kept"
        if np.isfinite(most):
            return "which the bound exceeds: the tube is not proved; see saturation_margin"
        return "with no bound on f itself: the tube is not proved; give residual and actuation with 0: ..."


@overload
def tracking_error(
    filter: Filter,
    loop: Loop,
    disturbance: Gaussian,
    *,
    inertia: float | None = None,
    dt: float | None = None,
) -> TrackingDeviation: ...


@overload
def tracking_error(
    filter: Filter,
    loop: Loop,
    disturbance: Bounded | Mapping[int, float],
    *,
    inertia: float | None = None,
    dt: float | None = None,
) -> TrackingTube: ...


@overload
def tracking_error(
    filter: SampledBank | Sequence[Filter],
    loop: Loop | Sequence[Loop],
    disturbance: Gaussian | Sequence[Gaussian],
    *,
    inertia: float | None = None,
    dt: float | None = None,
) -> PerChannel[TrackingDeviation]: ...


@overload
def tracking_error(
    filter: SampledBank | Sequence[Filter],
    loop: Loop | Sequence[Loop],
    disturbance: Bounded | Mapping[int, float] | Sequence[Bounded | Mapping[int, float]],
    *,
    inertia: float | None = None,
    dt: float | None = None,
) -> PerChannel[TrackingTube]: ...


def tracking_error(
    filter: Filter | SampledBank | Sequence[Filter],
    loop: Loop | Sequence[Loop],
    disturbance: Bounded
    | Gaussian
    | Mapping[int, float]
    | Sequence[Bounded | Gaussian | Mapping[int, float]],
    *,
    inertia: float | None = None,
    dt: float | None = None,
) -> TrackingTube | TrackingDeviation | PerChannel[TrackingTube | TrackingDeviation]:
    """Error of position of the complete sampled loop: the largest for bounds, standard deviations for spectra.

        M x' = a + f + d,    a = Act v(t - delay),    v = -M_hat (kp p + kd x) - f_hat,    p' = x

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter or several
        A continuous one with ``dt``. With ``g="hold"``; a delay of the measurement with the command as g only. Several:
        the answer is a ``PerChannel``, and every other argument one for all or a list.
    loop : Loop
        With kp above 0. ``command_limit`` is what the actuator has for v: the tube is that of a linear loop, proved
        while v stays within this and f_hat within the ``limit`` of the filter, both by their own bounds (which need a
        bound on f itself), and ``is_linear`` says whether they do. None: the ``g_limit`` of the filter for v alone,
        else no limit. Deviations take it for granted.
    disturbance : Bounded, Gaussian, or mapping of int to float
        Bounds: residual is f, \\|f\\| (0), \\|f'\\| (1), ..., measured (:func:`estimate`), or what a learned model says
        of itself, two or three of its standard deviations. Of several orders the one that gives least counts. What a
        learned f_theta has of f is part of it here: a delayed actuator answers it as late as the rest. Actuation is d.
        A mapping is the bounds of the residual alone. Gaussian: spectra of f and d, deviations of the samples of x and
        position.
    inertia : float, optional
        M_hat: d and v are in its unit times that of x'. None: the filter's own, else 1.
    dt : float, optional
        Sampling interval in seconds of a continuous filter.

    Returns
    -------
    TrackingTube for bounds, TrackingDeviation for Gaussian disturbances, or PerChannel of it

    Raises
    ------
    TypeError
        If an argument is of another kind.
    ValueError
        As for :func:`~phyfilter_ctl.margins`; for a loop that is not stable, or a derivative of which no bound alone
        bounds the error: 2 and above, since a held command stays half a step behind a ramp; 1 of a d that the filter is
        told; for an E of several rows; for a ``g_limit`` with ``g="applied"`` or without 0 in it and no
        ``command_limit``; for what only :func:`error_bound` counts: inertia_error, rate, implementation.

    Notes
    -----
    At the instants that the samples show, earlier by a delay of the measurement; f and d go on in between. Exact for
    each term alone, to 1e-6: some course of it reaches the radius.
    With a filter of one channel and E, f counts as E f, and f_hat goes back as E f_hat.

    Examples
    --------
    1 kg, a force that changes by up to 2 N/s; and gusts of 1 N that forget within half a second:

    >>> loop = Loop(10.0, 6.0)
    >>> slow, fast = (tracking_error(PhyFilter([pole]), loop, {1: 2.0}, dt=0.01) for pole in (2.0, 20.0))
    >>> round(slow.radius, 3), round(fast.radius, 4)
    (0.101, 0.011)
    >>> from phyfilter_ctl import gauss_markov
    >>> found = tracking_error(PhyFilter([8.0]), loop, Gaussian(gauss_markov(1.0, 0.5)), dt=0.01)
    >>> round(found.band(0.95), 3)
    0.027
    """
    return _any(cast(Any, filter), cast(Any, loop), cast(Any, disturbance), inertia=inertia, dt=dt)


@per_channel
def _any(
    filter: Filter,
    loop: Loop,
    disturbance: Bounded | Gaussian | Mapping[int, float],
    *,
    inertia: float | None,
    dt: float | None,
) -> TrackingTube | TrackingDeviation:
    if isinstance(disturbance, Gaussian):
        return _deviation(filter, checked_loop(loop), disturbance, inertia, dt)
    return _tube(filter, checked_loop(loop), bounded(disturbance), inertia, dt)


def _tube(
    filter: PhyFilter | SampledPhyFilter,
    around: Loop,
    bounds: Bounded,
    inertia: float | None,
    dt: float | None,
) -> TrackingTube:
    if bounds.inertia_error or bounds.rate or bounds.implementation is not None:
        raise ValueError(
            "inertia_error, rate, implementation: a tube does not count them; see error_bound, and inertia_ratio of "
            "the Loop for an inertia that is wrong"
        )
    noises = bounds.noise, bounds.position_noise
    loop = _loop(filter, around, inertia, dt)
    assumptions = assumed(loop.sampled, counted=("limit", "g_limit"))
    limits, more = _limits(loop, around.command_limit)
    M, direction = loop.inertia, _direction(loop.sampled)
    given: dict[Source, list[dict[int, float]]] = {}
    parts: dict[str, float] = {}
    used: dict[str, list[int]] = {}
    others: dict[Output, dict[str, float]] = {"command": {}, "estimate": {}}
    for source, parts_of, scale in zip(
        _SOURCES, (bounds.residual, bounds.actuation), (direction, 1.0), strict=True
    ):
        given[source] = _per_inertia(parts_of, M / scale)
        used[source] = [_least(loop, source, one) for one in given[source]]
        if given[source]:
            pairs = list(zip(used[source], given[source], strict=True))
            parts[source] = sum(loop.gain(source, k, "position") * one[k] for k, one in pairs)
            # Command and f_hat follow f itself, of which a bound on a derivative says nothing.
            sizes = [one.get(0, np.inf) for one in given[source]]
            for output, into in others.items():
                into[source] = M * loop.gain(source, 0, output) * sum(sizes)
    for name, of, size in zip(("noise", "position_noise"), _NOISY, noises, strict=True):
        if size:
            parts[name] = loop.noise_gain(of, "position") * size
            for output, into in others.items():
                into[name] = M * loop.noise_gain(of, output) * size
    estimate = {name: value / direction for name, value in others["estimate"].items()}
    return TrackingTube(parts, used, others["command"], estimate, *limits, (*assumptions, *more), given, loop)


def _limits(loop: TrackingLoop, command: float | None) -> tuple[tuple[float, float], tuple[str, ...]]:
    """Of the command that is fed back and of f_hat, and what is taken for granted of them."""
    sampling, said = loop.sampled.sampling, ()
    estimate = np.inf if sampling.limit is None else float(np.min(sampling.limit))
    if command is not None:
        most = float(command)
    elif sampling.g_limit is None:
        most = np.inf
    elif loop.told == "applied":
        raise ValueError(
            "g_limit: clips what the filter is told, which is a measured force here; leave it out"
        )
    else:
        low, high = sampling.g_limit
        most = float(min(np.min(high), np.min(-low)))
        said = ("g is the command that is fed back alone",)
        if most <= 0.0:
            raise ValueError(
                f"g_limit: expected 0 between its ends, got {low} and {high}: say with command_limit how much of it "
                "the feedback has"
            )
    return (most, estimate), said


def _direction(sampled: SampledPhyFilter) -> float:
    """|E| of one channel: f counts as E f."""
    if sampled.E is None:
        return 1.0
    if sampled.E.shape[0] != 1:
        raise ValueError(
            f"E: expected one channel, got {sampled.E.shape[0]}: what E does not span is not fed back; give the filter "
            "of the channel without E"
        )
    return float(np.linalg.norm(sampled.E, 2))


@dataclass(frozen=True, repr=False)
class TrackingDeviation(Result):
    """Standard deviations at the samples; made by :func:`tracking_error`.

    Parameters
    ----------
    residual, actuation, noise : float
        Of the error of position, from each of them.
    command : float
        Of the part of the command that is fed back, from all.
    assumptions : tuple of str
        What is taken for granted of the options of the filter.
    units : dict of str to str
        Of x and f, where the filter knows them; position is in that of x times s.
    """

    _figures = ("position", "residual", "actuation", "noise", "command", "assumptions", "units")
    _answer = ("position",)

    residual: float
    actuation: float
    noise: float
    command: float
    assumptions: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)

    def _unit_of(self, name: str) -> str:
        if name == "command":
            return self.units.get("f", "")
        return _position_unit(self.units) if name in ("position", "residual", "actuation", "noise") else ""

    def describe(self) -> str:
        """The standard deviations as text, one line each.

        Returns
        -------
        str

        Examples
        --------
        >>> from phyfilter_ctl import Gaussian, Loop, PhyFilter, tracking_error
        >>> filter = PhyFilter([5.0]).sampled(0.01, units={"x": "m/s", "f": "N"})
        >>> print(tracking_error(filter, Loop(10.0, 6.0), Gaussian(noise=0.01)).describe())
        position            0.0006435 m (1 sigma)
          residual          0 m
          actuation         0 m
          noise             0.0006435 m
        command             0.1117 N (1 sigma)
        """
        position = _position_unit(self.units)
        figures = {
            "position": self.position,
            "  residual": self.residual,
            "  actuation": self.actuation,
            "  noise": self.noise,
        }
        lines = {name: with_unit(value, position) for name, value in figures.items()}
        lines["position"] += " (1 sigma)"
        lines["command"] = f"{with_unit(self.command, self.units.get('f', ''))} (1 sigma)"
        return in_lines(lines | {"taken for granted": "; ".join(self.assumptions)})

    @property
    def position(self) -> float:
        """Of the error of position, from all: they are independent."""
        return float(np.sqrt(self.residual**2 + self.actuation**2 + self.noise**2))

    def band(self, probability: float = 0.95) -> float:
        """Half the width of the band in which the error is at any one time with this probability.

        Parameters
        ----------
        probability : float
            Between 0 and 1.

        Notes
        -----
        Pointwise. That a whole flight stays within is less probable: over T seconds of errors that forget within tau
        seconds there are about T/tau chances to leave it.
        """
        if not 0.0 < probability < 1.0:
            raise ValueError(f"probability: expected one between 0 and 1, got {probability}")
        return float(norm.ppf(0.5 + 0.5 * probability)) * self.position


def _deviation(
    filter: PhyFilter | SampledPhyFilter,
    around: Loop,
    gaussian: Gaussian,
    inertia: float | None,
    dt: float | None,
) -> TrackingDeviation:
    if not isinstance(gaussian.noise, float):
        raise ValueError("noise: expected a standard deviation of the samples, got a system")
    loop = _loop(filter, around, inertia, dt)
    rows = np.stack([loop.row("position"), loop.row("command")])
    totals = {}
    for source, shape, scale in zip(
        _SOURCES, (gaussian.residual, gaussian.actuation), (_direction(loop.sampled), 1.0), strict=True
    ):
        if shape is None:
            totals[source] = np.zeros(2)
        elif isinstance(shape, ct.StateSpace | ct.TransferFunction):
            totals[source] = loop.shaped(source, shaping(source, shape), rows)
        else:
            covariance = _signals.array(source, shape, ("L",))
            totals[source] = np.array([loop.covered(source, covariance, c) for c in rows])
        totals[source] *= (scale / loop.inertia) ** 2
    totals["noise"] = np.zeros(2)
    for of, size in zip(_NOISY, (gaussian.noise, gaussian.position_noise), strict=True):
        first, then = loop.noise(of)
        drive = loop.A @ first + then
        P = solve_discrete_lyapunov(loop.A, np.outer(drive, drive))
        totals["noise"] += size**2 * ((rows @ first) ** 2 + np.einsum("ij,jk,ik->i", rows, P, rows))
    deviations = {name: float(np.sqrt(max(value[0], 0.0))) for name, value in totals.items()}
    command = loop.inertia * float(np.sqrt(sum(max(value[1], 0.0) for value in totals.values())))
    granted = () if around.command_limit is None else ("the command stays within its limit",)
    return TrackingDeviation(
        **deviations,
        command=command,
        assumptions=(*assumed(loop.sampled), *granted),
        units=units_of(loop.sampled),
    )


def _position_unit(units: Mapping[str, str]) -> str:
    """That of x times s."""
    x = units.get("x", "")
    return x.removesuffix("/s") if x.endswith("/s") else f"{x} s" if x else ""


def _loop(
    filter: PhyFilter | SampledPhyFilter, around: Loop, inertia: float | None, dt: float | None
) -> TrackingLoop:
    # The filter is told what it is told by the tracking loop itself.
    sampled, loop = build_loop(filter, replace(around, g="commanded"), dt)
    if not isinstance(sampled, SampledPhyFilter) or not isinstance(loop, SampledLoop):
        raise ValueError(
            "dt: expected the sampling interval of the filter, got None; or give a sampled filter"
        )
    if sampled.sampling.delay and around.g == "applied":
        raise ValueError("delay: a force that is measured on time beside an x that is late is not covered")
    if not around.kp > 0.0:
        raise ValueError(
            f"kp: expected a positive gain, got {around.kp}: without it nothing holds the position"
        )
    found = TrackingLoop(sampled, loop, around.inertia_ratio, inertia_of(sampled, inertia), around.g)
    radius = float(np.abs(np.linalg.eigvals(found.A)).max())
    if radius >= 1.0:
        raise ValueError(
            f"the loop is not stable: a pole of magnitude {radius:.6g}; lower the bandwidth, see margins"
        )
    return found


def _per_inertia(bounds: Bounds, inertia: float) -> list[dict[int, float]]:
    """Bounds of the parts per unit of M_hat."""
    parts = [bounds] if isinstance(bounds, Mapping) else bounds
    return [{k: bound / inertia for k, bound in part.items()} for part in parts if part]


def _least(loop: TrackingLoop, source: Source, bounds: Mapping[int, float]) -> int:
    """The derivative whose bound gives the least error."""
    found = [k for k in bounds if loop.bounds(source, k, "position")]
    if not found:
        raise ValueError(
            f"{source}: no bound on its derivative {min(bounds)} alone bounds the error: what is constant or a ramp "
            "leaves one; give a bound on a lower derivative (0: on itself)"
        )
    return min(found, key=lambda k: loop.gain(source, k, "position") * bounds[k])
