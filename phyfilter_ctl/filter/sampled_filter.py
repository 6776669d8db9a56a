"""The filter on sampled data: one recursion for whole records, for loops and for every discretisation.

    u_k = M_k' (x_k - x_{k-1}) / h - mean of (g + f_theta) over [t_{k-1}, t_k]    (M_k': mean of M_hat at both ends)
    w_k = w_{k-1} + dA (w_{k-1} - equilibrium u_k)
    f_hat_k = f_theta_k + C w_k

This is exactly F driven by the step average of the measured residual. No state grows, x is never differentiated, and
the chain of sections (unit gain each) with dA = e^{Ah} - I formed in delta form keeps its digits at any pole and rate.
Forward Euler (the paper's choice) is the same recursion with dA = A h, Tustin with dA = (I - A h/2)^{-1} A h.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._samples import LARGEST, interval
from .._sections import FloatArray
from . import loop, record, retuning
from .coefficients import Coefficients, Method, Precision, checked_direction, checked_limit, transition
from .loop import FilterState
from .phyfilter import PhyFilter

__all__ = ["SampledPhyFilter", "stack"]

Rule = Literal["hold", "average"]
Realisation = Literal["sections", "paper"]
NonFinite = Literal["raise", "hold"]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class SampledPhyFilter:
    """A :class:`PhyFilter` on sampled data.

    Parameters
    ----------
    filters : PhyFilter or sequence of PhyFilter
        One filter for every channel, or one per channel (see :func:`stack`).
    dt : float
        Nominal sampling interval h in seconds; a timedelta64 has its unit with it.
    method : {"exact", "euler", "tustin"}
        "exact": zero-order hold of the step-averaged residual, exact for x linear between samples. "euler": forward
        Euler, as in the paper; refused where it diverges, |1 + p h| >= 1. "tustin": the trapezoidal rule.
    g, f_theta : {"hold", "average"}
        What the signal does between samples: "hold" (a command held by an actuator) or "average" (a smooth signal
        known at both ends of the step).
    precision : {"float64", "float32"}
        Arithmetic of ``step``. In float32 every state carries a compensation word, so that nothing is lost over
        days; ``run`` rounds inputs, coefficients and outputs alike and carries the states in double.
    realisation : {"sections", "paper"}
        "paper" is Eq. (5) as printed, 4n - 3 states of which all but n grow without bound: for comparison only. It
        is forward Euler with held inputs by itself; ``method`` and the holds follow.
    E : array_like, shape (n_x, n_f), optional
        Known direction in which f acts, M x' = g + E f, of full column rank. f_theta and f_hat then have n_f channels.
    delay : float
        Known delay of the measurement x in seconds; g, f_theta and the inertia are delayed alike inside F.
    limit : float or array_like, shape (n_f,), optional
        Bound on |f_hat|. It clamps the output, never the state, so nothing winds up.
    nonfinite : {"raise", "hold"}
        What a sample does that is NaN, infinite, masked or beyond 1e150. It never enters the state: "raise" refuses
        it, "hold" returns f_theta for that sample, says so, and takes the gap as one longer step.

    Raises
    ------
    ValueError
        For options out of range, forward Euler that would diverge (pole and largest step named), E without full
        column rank, or options that the paper's realisation does not have.

    Notes
    -----
    Cost of ``run``: two matrix products per block of 32 samples and a banded solve, linear in the samples; of
    ``step``: about a dozen numpy calls, independent of the record.

    Examples
    --------
    Constant residual 2 under x' = f, f_theta = 0: the first-order filter closes in on it as 1 - exp(-20 t).

    >>> import numpy as np
    >>> sampled = PhyFilter([20.0]).sampled(0.002)
    >>> t = 0.002 * np.arange(501)
    >>> f_hat = sampled.run(2.0 * t[:, None])
    >>> bool(np.allclose(f_hat[:, 0], 2.0 * (1.0 - np.exp(-20.0 * t)), atol=1e-12))
    True
    """

    filters: tuple[PhyFilter, ...]
    dt: float
    method: Method
    g: Rule
    f_theta: Rule
    precision: Precision
    realisation: Realisation
    E: FloatArray | None
    delay: float
    limit: FloatArray | None
    nonfinite: NonFinite

    def __init__(
        self,
        filters: PhyFilter | Sequence[PhyFilter],
        dt: float,
        *,
        method: Method = "exact",
        g: Rule = "hold",
        f_theta: Rule = "average",
        precision: Precision = "float64",
        realisation: Realisation = "sections",
        E: ArrayLike | None = None,
        delay: float = 0.0,
        limit: ArrayLike | None = None,
        nonfinite: NonFinite = "raise",
    ) -> None:
        filters = (filters,) if isinstance(filters, PhyFilter) else tuple(filters)
        if not filters or not all(isinstance(entry, PhyFilter) for entry in filters):
            raise TypeError(f"filters: expected a PhyFilter or a non-empty sequence of them, got {filters!r}")
        dt, delay = float(interval("dt", dt)), float(interval("delay", delay))
        if not 1.0 / LARGEST < dt < LARGEST:
            raise ValueError(f"dt: expected a positive sampling interval in seconds, got {dt}")
        if not 0.0 <= delay < LARGEST:
            raise ValueError(f"delay: expected a delay of 0 s or more, got {delay}")
        for name, value, choices in (
            ("method", method, Method),
            ("g", g, Rule),
            ("f_theta", f_theta, Rule),
            ("precision", precision, Precision),
            ("realisation", realisation, Realisation),
            ("nonfinite", nonfinite, NonFinite),
        ):
            if value not in get_args(choices):
                raise ValueError(f"{name}: expected one of {', '.join(get_args(choices))}, got {value!r}")
        if realisation == "paper":
            if method == "tustin" or len(filters) > 1 or E is not None or delay or nonfinite != "raise":
                raise ValueError(
                    "realisation='paper' is Eq. (5) as printed: forward Euler, held inputs, one filter, no E, delay or "
                    "nonfinite='hold'; leave those options out or use realisation='sections'"
                )
            method, g, f_theta = "euler", "hold", "hold"
        direction = None if E is None else checked_direction(E)
        n_f = direction.shape[1] if direction is not None else None
        if n_f is not None and len(filters) not in (1, n_f):
            raise ValueError(
                f"{len(filters)} filters for the {n_f} columns of E: expected one, or one per column"
            )
        bound = None if limit is None else checked_limit(limit, n_f if len(filters) == 1 else len(filters))
        values = (filters, dt, method, g, f_theta, precision, realisation, direction, delay, bound, nonfinite)
        for entry, value in zip(fields(self), values, strict=True):
            object.__setattr__(self, entry.name, value)
        self._coefficients.check_step(dt)

    # -- what it is ---------------------------------------------------------------------------------------------

    @property
    def filter(self) -> PhyFilter:
        """The filter that all channels share.

        Raises
        ------
        ValueError
            If each channel has its own; see ``filters``.
        """
        if len(self.filters) != 1:
            raise ValueError(f"each of the {len(self.filters)} channels has its own filter: use .filters[i]")
        (shared,) = self.filters
        return shared

    @property
    def order(self) -> int:
        """Largest order of the filters."""
        return max(entry.order for entry in self.filters)

    @property
    def transition(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(dA (n, n), equilibrium (n,), C (n,)) of the shared filter at the nominal step, in double.

        w_k = w_{k-1} + dA (w_{k-1} - equilibrium u_k), f_hat_k = f_theta_k + C w_k.
        """
        A, equilibrium, C = self.filter.sections
        return transition(A, self.method, self.dt), equilibrium, C

    @property
    def transitions(self) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
        """:attr:`transition` of every filter, rounded to the precision of the recursion."""
        bank = zip(self.filters, *self._coefficients.bank, strict=True)
        return tuple((dA[:n, :n], rest[:n], C[:n]) for entry, dA, rest, C in bank if (n := entry.order))

    @cached_property
    def _coefficients(self) -> Coefficients:
        return Coefficients(self.filters, self.method, self.dt, self.precision)

    @cached_property
    def E_left(self) -> FloatArray:
        """Left inverse of E, shape (n_f, n_x): what the residual of M x' says of f."""
        if self.E is None:
            raise ValueError("without E every channel of x has its own f")
        return np.asarray(np.linalg.pinv(self.E), dtype=float)

    def with_filter(self, filters: PhyFilter | Sequence[PhyFilter]) -> SampledPhyFilter:
        """The same options around other coefficients.

        Parameters
        ----------
        filters : PhyFilter or sequence of PhyFilter
            As for the class.

        Returns
        -------
        SampledPhyFilter

        Examples
        --------
        >>> PhyFilter([20.0]).sampled(0.002, g="average").with_filter(PhyFilter([5.0])).g
        'average'
        """
        return replace(self, filters=filters)  # through __init__, so checked again

    # -- whole records ------------------------------------------------------------------------------------------

    def run(
        self,
        x: ArrayLike,
        g: ArrayLike | None = None,
        f_theta: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
        times: ArrayLike | None = None,
    ) -> NDArray[np.floating]:
        """f_hat over a whole record.

        Parameters
        ----------
        x : (N, n_x) array
            Measured state; (N,) for one channel.
        g : (N, n_x) array, optional
            Known part of M x'; row k is its value from sample k on. None means 0.
        f_theta : (N, n_f) array, optional
            Learned model of f; None means 0.
        inertia : float, (n_x,), (n_x, n_x), (N, n_x) or (N, n_x, n_x) array, optional
            Model M_hat of the inertia: scalar, diagonal or full, constant or per sample; None means I.
        times : (N,) array, optional
            Sampling instants where they are not every ``dt``: seconds, timedelta64, or datetime64 counted from the
            first.

        Returns
        -------
        (N, n_f) array
            f_hat in the precision of the filter; row 0 is f_theta.

        Raises
        ------
        ValueError
            For wrong shapes, an ambiguous inertia (2-D with N == n_x), times that stand still or run back (row
            named) or are whole numbers that count no seconds, a sample that is not finite, is masked or is beyond
            1e150 under ``nonfinite="raise"`` (row and signal named), or a step at which forward Euler diverges.

        Examples
        --------
        >>> PhyFilter([20.0]).sampled(0.01).run([[0.0], [0.01], [0.02]], f_theta=[[1.0], [1.0], [1.0]]).ravel()
        array([1., 1., 1.])
        """
        return record.run(self, x, g, f_theta, inertia, times)

    def held(
        self,
        x: ArrayLike,
        g: ArrayLike | None = None,
        f_theta: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
    ) -> NDArray[np.bool_]:
        """Which samples of a record ``run`` holds because they are not finite.

        Parameters
        ----------
        x, g, f_theta, inertia
            As for :meth:`run`.

        Returns
        -------
        (N,) bool array

        Raises
        ------
        ValueError
            For wrong shapes.

        Examples
        --------
        >>> PhyFilter([20.0]).sampled(0.01, nonfinite="hold").held([[0.0], [float("nan")], [0.0]])
        array([False,  True, False])
        """
        return record.held_samples(self, *record.checked_signals(self, x, g, f_theta, inertia))

    # -- loops --------------------------------------------------------------------------------------------------

    def start(
        self,
        x0: ArrayLike,
        *,
        f_hat0: ArrayLike | None = None,
        f_theta0: ArrayLike | None = None,
        inertia0: ArrayLike | None = None,
        g0: ArrayLike | None = None,
    ) -> FilterState:
        """State at the first sample, from which f_hat starts bumplessly.

        Parameters
        ----------
        x0 : (n_x,) array
            First measurement.
        f_hat0 : (n_f,) array, optional
            Estimate to start from (the filter at rest on the constant residual that gives it); None means f_theta0.
        f_theta0 : (n_f,) array, optional
            f_theta at the first sample; None means 0.
        inertia0 : float, (n_x,) or (n_x, n_x) array, optional
            Inertia at the first sample, kept until ``step`` is given another; None means I.
        g0 : (n_x,) array, optional
            g at the first sample, used by ``g="average"``; None takes the g of the first step.

        Returns
        -------
        FilterState
            Immutable; hand it to ``step``.

        Raises
        ------
        ValueError
            For wrong shapes or non-finite values, or where F(0) = 0 and no constant residual gives f_hat0.

        Examples
        --------
        >>> sampled = PhyFilter([20.0]).sampled(0.002)
        >>> state = sampled.start([0.0, 0.0], f_hat0=[1.0, -1.0])
        >>> state, f_hat = sampled.step(state, [0.002, -0.002], [0.0, 0.0], [0.0, 0.0])
        >>> f_hat.round(12).tolist()
        [1.0, -1.0]
        """
        return loop.start(self, x0, f_hat0=f_hat0, f_theta0=f_theta0, inertia0=inertia0, g0=g0)

    def step(
        self,
        state: FilterState,
        x: ArrayLike,
        g: ArrayLike | None = None,
        f_theta: ArrayLike | None = None,
        *,
        inertia: ArrayLike | None = None,
        dt: float | None = None,
    ) -> tuple[FilterState, NDArray[np.floating]]:
        """Advance by one sample. Pure: the state given is not changed.

        Parameters
        ----------
        state : FilterState
        x : (n_x,) array
            Measurement now.
        g : (n_x,) array, optional
            ``g="hold"``: the value held over the step that ends now, that is the command sent at the sample before;
            so the command of this sample may depend on the f_hat returned here. ``g="average"``: the value now.
            None means 0.
        f_theta : (n_f,) array, optional
            Learned model now; None means 0.
        inertia : float, (n_x,) or (n_x, n_x) array, optional
            Inertia now; None keeps the last one.
        dt : float, optional
            Length of the step that ends now; None means the nominal one.

        Returns
        -------
        state : FilterState
            ``state.held`` tells whether this sample was held (``nonfinite="hold"``).
        f_hat : (n_f,) array

        Raises
        ------
        ValueError
            For wrong shapes, a step that is not positive or at which forward Euler diverges, or a non-finite
            sample under ``nonfinite="raise"``.

        Examples
        --------
        ``run`` is this loop:

        >>> import numpy as np
        >>> rng = np.random.default_rng(1)
        >>> x, g, f_theta = rng.standard_normal((3, 50, 2))
        >>> sampled = PhyFilter([400.0, 40.0]).sampled(0.002)
        >>> state = sampled.start(x[0], f_theta0=f_theta[0])
        >>> for k in range(1, 50):
        ...     state, f_hat = sampled.step(state, x[k], g[k - 1], f_theta[k])
        >>> bool(np.allclose(f_hat, sampled.run(x, g, f_theta)[-1], rtol=1e-12))
        True
        """
        return loop.step(self, state, x, g, f_theta, inertia=inertia, dt=dt)

    def shift_x(self, state: FilterState, dx: ArrayLike) -> FilterState:
        """Tell the filter that the estimate of x jumped by dx (n_x,): a reset, not an acceleration.

        Examples
        --------
        >>> sampled = PhyFilter([20.0]).sampled(0.002)
        >>> state = sampled.shift_x(sampled.start([0.0]), [0.5])
        >>> sampled.step(state, [0.5])[1].tolist()
        [0.0]
        """
        return loop.shift_x(self, state, dx)

    def retune(self, state: FilterState, new_filter: SampledPhyFilter | PhyFilter) -> FilterState:
        """State with which another filter goes on from here: f_hat does not jump, and rest stays rest.

        Parameters
        ----------
        state : FilterState
            Of this filter.
        new_filter : SampledPhyFilter or PhyFilter
            The filter to go on with, of any order, step and method; a PhyFilter stands for
            ``self.with_filter(new_filter)``.

        Returns
        -------
        FilterState
            For ``new_filter.step`` (or ``self.with_filter(new_filter).step``).

        Raises
        ------
        ValueError
            If the state is not of a filter like this one (order, channels, precision), the new filter has another
            number of channels, or either is the paper's realisation.

        Notes
        -----
        The new filter goes on from the state in which it would most likely be, had it run all the time, where the
        residual is a random walk with white noise on it, as strong as the walk at the slowest pole of the new filter.
        So the estimate of a constant residual stays as it is for every change of poles, zeros, order or step, and a
        filter retuned to itself goes on as if nothing had been. The output is then brought back to where it was;
        what that takes dies away and is never larger than at first. Where F(0) changes, f_hat stays at the instant of
        the change only, and goes from there to the new F(0) times the residual as the new filter settles; from and to
        F(0) = 0 (band-pass) too. With N = 0 there is no output to keep.

        Examples
        --------
        >>> slow, fast = PhyFilter([2.0]).sampled(0.01), PhyFilter([400.0, 40.0]).sampled(0.01)
        >>> state, before = slow.step(slow.start([0.0]), [1.0])
        >>> state = slow.retune(state, fast)
        >>> bool(abs(state.w[0, -1] - before[0]) < 1e-12)
        True

        At rest on the residual 5 nothing moves any more:

        >>> butterworth = PhyFilter([400.0, 800.0**0.5]).sampled(0.01)
        >>> state = butterworth.retune(butterworth.start([0.0], f_hat0=[5.0]), fast)
        >>> abs(float(fast.step(state, [0.05])[1][0]) - 5.0) < 1e-12
        True
        """
        new = self.with_filter(new_filter) if isinstance(new_filter, PhyFilter) else new_filter
        return retuning.retune(self, state, new)

    # -- equality and text --------------------------------------------------------------------------------------

    def _options(self) -> dict[str, object]:
        """Everything but the coefficients."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.name != "filters"}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SampledPhyFilter):
            return NotImplemented
        return self.filters == other.filters and not _differences(self, other)

    def __hash__(self) -> int:
        return hash((self.filters, self.dt, self.method, self.g, self.f_theta, self.precision, self.delay))

    def __repr__(self) -> str:
        usual = {
            "method": "exact",
            "g": "hold",
            "f_theta": "average",
            "precision": "float64",
            "nonfinite": "raise",
        }
        usual |= {"realisation": "sections", "E": None, "delay": 0.0, "limit": None, "dt": self.dt}
        changed = "".join(
            f", {name}={value.tolist() if isinstance(value, np.ndarray) else value!r}"
            for name, value in self._options().items()
            if isinstance(value, np.ndarray) or value != usual[name]
        )
        if len(self.filters) == 1:
            return f"{self.filters[0]!r}.sampled({self.dt:g}{changed})"
        return f"SampledPhyFilter([{', '.join(map(repr, self.filters))}], {self.dt:g}{changed})"


def _differences(one: SampledPhyFilter, other: SampledPhyFilter) -> list[str]:
    """Names of the options that differ."""
    mine, theirs = one._options(), other._options()
    return [name for name in mine if not np.array_equal(np.asarray(mine[name]), np.asarray(theirs[name]))]


def stack(filters: Sequence[SampledPhyFilter]) -> SampledPhyFilter:
    """A filter of its own for each channel.

    Parameters
    ----------
    filters : sequence of SampledPhyFilter
        One per channel, in the order of the channels; orders may differ, options must not.

    Returns
    -------
    SampledPhyFilter

    Raises
    ------
    TypeError
        If one of them is not sampled.
    ValueError
        If the sequence is empty or the options differ (the option is named).

    Examples
    --------
    >>> slow, fast = PhyFilter([2.0]).sampled(0.01), PhyFilter([400.0, 40.0]).sampled(0.01)
    >>> stack([slow, slow, fast]).run([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])[1].round(3).tolist()
    [1.98, 1.98, 1.752]
    """
    filters = tuple(filters)
    if not filters:
        raise ValueError("stack: expected at least one sampled filter, got none")
    for i, entry in enumerate(filters):
        if not isinstance(entry, SampledPhyFilter):
            raise TypeError(
                f"stack: channel {i} is {entry!r}, expected a SampledPhyFilter; sample each first, F.sampled(dt), or "
                "give them all to SampledPhyFilter([F, ...], dt)"
            )
    reference = filters[0]
    for i, entry in enumerate(filters):
        for name in _differences(entry, reference):
            raise ValueError(
                f"stack: channel {i} has {name}={getattr(entry, name)!r} but channel 0 has "
                f"{getattr(reference, name)!r}: all options must agree; only the coefficients may differ"
            )
    return reference.with_filter([part for entry in filters for part in entry.filters])
