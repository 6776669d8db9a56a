"""PhyFilter: the filter F = N/D that the learning residual passes through, continuous and on sampled data.

    f_hat = f_theta + F(s) [M x' - g - f_theta],    F = N/D,
    D = s^n + a_{n-1} s^{n-1} + ... + a_0,          N = b_{n-1} s^{n-1} + ... + b_0

With N = a_0 this is the low-pass form (Eqs. (3) to (5) of the paper), with a general N the form of its
supplement "Filtering learning residual with more general form". On samples it is one recursion for records, for loops
and for every discretisation:

    u_k = M_k' (x_k - x_{k-1}) / h - mean of (g + f_theta) over [t_{k-1}, t_k]    (M_k': mean of M_hat at both ends)
    w_k = w_{k-1} + dA (w_{k-1} - equilibrium u_k)
    f_hat_k = f_theta_k + C w_k

This is exactly F driven by the step average of the measured residual, which costs the zeros of 1 - F a little, all but
the first at s = 0; method="matched" gives them back by another C (``matching``). No state grows, x is never
differentiated, and the chain of sections (unit gain each) with dA = e^{Ah} - I formed in delta form keeps its digits at
any pole and rate. Forward Euler (the paper's choice) is the same recursion with dA = A h, Tustin with
dA = (I - A h/2)^{-1} A h.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .. import _sections
from .._sections import FloatArray
from . import matching, retuning
from .live import LiveFilter
from .live_rules import LiveRules
from .loop import FilterState
from .matrices import channel_counts, continuous_state_space
from .rational import Rational
from .recursion import Chain, Recursion, transition
from .sampled_form import SampledForm
from .sampling import InertiaInput, Method, NonFinite, Precision, Rule, Sampling, SamplingOptions

__all__ = ["PhyFilter", "SampledPhyFilter", "chain_of", "sampling_of"]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class PhyFilter(Rational):
    """The filter F(s) = N(s)/D(s) that the learning residual passes through.

    Parameters
    ----------
    a : array_like, shape (n,)
        Ascending coefficients a_0 ... a_{n-1} of D = s^n + a_{n-1} s^{n-1} + ... + a_0; a_i in (rad/s)^(n-i).
    b : array_like, shape (n,), optional
        Ascending coefficients b_0 ... b_{n-1} of N. None means the low-pass form N = a_0.
    poles : array_like, shape (n,), optional
        The roots of D where they are known exactly (repeated ones cannot be recovered from ``a`` to full
        precision). They must agree with ``a`` to 1e-6. Where they agree no better than typed digits do, the poles
        count: ``a`` becomes their product, and ``b`` follows it, b_i / a_i kept.

    Attributes
    ----------
    a, b : (n,) read-only arrays
    poles : (n,) read-only complex array, slowest first

    Raises
    ------
    TypeError
        If ``a`` or ``b`` are no real numbers.
    ValueError
        If D is empty, has a pole that is not in the open left half plane (the pole is named) or a coefficient that is
        not positive, if ``b`` has another length than ``a``, if a coefficient is not finite, or if ``poles`` do not
        belong to ``a``.

    Notes
    -----
    Low-pass form: Eq. (3) of the paper. General form: its supplement, "Filtering learning residual with more
    general form".

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> second = PhyFilter([400.0, 40.0])
    >>> second
    PhyFilter(a=[400.0, 40.0])
    >>> second.poles.real.tolist()
    [-20.0, -20.0]
    >>> second.type, second.dc_gain
    (1, 1.0)
    """

    def state_space(self, channels: int = 1) -> ct.StateSpace:
        """The filter as a python-control state-space system, one chain of sections per channel.

            z' = A z + A B x - B (g + f_theta),    f_hat = C z + C B x + f_theta    (z = w - B x)

        so that x is never differentiated. Its start is bumpless from z = -B x(0).

        Parameters
        ----------
        channels : int
            Number n_x of channels.

        Returns
        -------
        control.StateSpace
            Inputs x[i], g[i], f_theta[i] (all x first, then all g, then all f_theta), outputs f_hat[i], states
            w[i,j]: channel i, section state j.

        Raises
        ------
        ValueError
            If ``channels`` is below 1.

        Examples
        --------
        >>> PhyFilter([20.0]).state_space(2).input_labels
        ['x[0]', 'x[1]', 'g[0]', 'g[1]', 'f_theta[0]', 'f_theta[1]']
        """
        if channels < 1:
            raise ValueError(f"channels: expected at least 1, got {channels}")
        return continuous_state_space([self.sections] * channels)

    def sampled(
        self,
        dt: float | Sampling,
        method: Method | None = None,
        g: Rule = "hold",
        f_theta: Rule = "average",
        *,
        precision: Precision = "float64",
        E: ArrayLike | None = None,
        delay: float = 0.0,
        limit: ArrayLike | None = None,
        g_limit: tuple[ArrayLike, ArrayLike] | ArrayLike | None = None,
        nonfinite: NonFinite = "raise",
        channels: int | Sequence[str] | None = None,
        inertia: ArrayLike | InertiaInput | None = None,
        units: Mapping[str, str] | None = None,
    ) -> SampledPhyFilter:
        """The filter on sampled data.

        Parameters
        ----------
        dt : float or Sampling
            Sampling interval in seconds; or all options at once, with nothing but E beside it.
        method : {"exact", "matched", "euler", "tustin"}, optional
            As for :class:`Sampling`. None chooses "matched" where exact sampling would lose what F promises, that is
            for a type of 2 and more and for zeros of 1 - F at +-j w, else "exact"; what was chosen is in ``sampling``.
        g, f_theta, precision, delay, limit, g_limit, nonfinite, channels, inertia, units
            As for :class:`Sampling`, which says what each means and raises.
        E
            As for :class:`Sampling`.

        Examples
        --------
        >>> PhyFilter([20.0]).sampled(0.002)
        PhyFilter(a=[20.0]).sampled(0.002)
        >>> PhyFilter([400.0, 40.0], [400.0, 40.0]).sampled(0.002)  # of type 2
        PhyFilter(a=[400.0, 40.0], b=[400.0, 40.0]).sampled(0.002, method='matched')

        With the inertia 2 kg a force of 6 N is found as such, on every road that the filter takes:

        >>> force = PhyFilter([20.0]).sampled(0.5, inertia=2.0, units={"x": "m/s", "f": "N"})
        >>> force.run([[0.0], [1.5], [3.0]]).ravel().round(3).tolist()
        [0.0, 6.0, 6.0]
        """
        options: SamplingOptions = {
            "precision": precision,
            "delay": delay,
            "limit": limit,
            "g_limit": g_limit,
            "nonfinite": nonfinite,
            "channels": channels,
            "inertia": inertia,
            "units": units,
        }
        return SampledPhyFilter(self, sampling_of([self], dt, method, g, f_theta, options), E=E)


def sampling_of(
    filters: Sequence[PhyFilter],
    dt: float | Sampling,
    method: Method | None,
    g: Rule,
    f_theta: Rule,
    options: SamplingOptions,
) -> Sampling:
    """The options that :meth:`PhyFilter.sampled` is given, with the method that these filters need.

    Raises
    ------
    ValueError
        As :class:`Sampling`, and for options beside a Sampling, which has them already.
    """
    if isinstance(dt, Sampling):
        beside = Sampling(dt.dt, method or "exact", g, f_theta, **options).unusual
        if beside or method:
            given = ", ".join(beside) or "method"
            raise ValueError(f"{given}: expected no options beside a Sampling; give them to the Sampling")
        return dt
    sampling = Sampling(dt, method or "exact", g, f_theta, **options)
    return sampling if method else _keeping_zeros(filters, sampling)


@dataclass(frozen=True, init=False, eq=False, repr=False)
class SampledPhyFilter(SampledForm):
    """A :class:`PhyFilter` on sampled data.

    Parameters
    ----------
    filters : PhyFilter or sequence of PhyFilter
        One filter for every channel, or one per channel (see :func:`stack`).
    sampling : Sampling or float
        Interval, discretisation and the other options; a number stands for those of :meth:`PhyFilter.sampled`.
    E : array_like, shape (n_x, n_f), optional
        As for :class:`Sampling`, instead of the one it has.

    Attributes
    ----------
    filters : tuple of PhyFilter
    sampling : Sampling
    recursion : Recursion
        The numbers and rules that it runs on.

    Raises
    ------
    ValueError
        For forward Euler that would diverge (pole and largest step named), E without full column rank, or numbers of
        filters, limits and columns of E that contradict each other.

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
    sampling: Sampling

    def __init__(
        self,
        filters: PhyFilter | Sequence[PhyFilter],
        sampling: Sampling | float,
        *,
        E: ArrayLike | None = None,
    ) -> None:
        filters = (filters,) if isinstance(filters, PhyFilter) else tuple(filters)
        if not filters or not all(isinstance(entry, PhyFilter) for entry in filters):
            raise TypeError(f"filters: expected a PhyFilter or a non-empty sequence of them, got {filters!r}")
        if not isinstance(sampling, Sampling):
            sampling = _keeping_zeros(filters, Sampling(sampling))
        if E is not None:
            sampling = replace(sampling, E=E)
        object.__setattr__(self, "filters", filters)
        object.__setattr__(self, "sampling", sampling)
        recursion = Recursion(tuple(chain_of(entry, sampling) for entry in filters), sampling)
        object.__setattr__(self, "recursion", recursion)

    # -- what it is ---------------------------------------------------------------------------------------------

    @property
    def E(self) -> FloatArray | None:
        """Direction in which f acts, (n_x, n_f), as ``sampling`` has it."""
        return self.sampling.E

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
    def by_channel(self) -> tuple[SampledPhyFilter, ...]:
        """Each filter by itself, with the limits of its channel; one entry where all channels share a filter."""
        if len(self.filters) == 1:
            return (SampledPhyFilter(self.filters, self.sampling),)
        if self.E is not None:
            limit = self.sampling.limit
            own = [
                replace(self.sampling, limit=limit[i] if limit is not None and limit.ndim else limit)
                for i in range(len(self.filters))
            ]
        else:
            own = [self.sampling.alone(i) for i in range(len(self.filters))]
        return tuple(SampledPhyFilter(F, one) for F, one in zip(self.filters, own, strict=True))

    @property
    def order(self) -> int:
        """Largest order of the filters."""
        return max(entry.order for entry in self.filters)

    @cached_property
    def transition(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(dA (n, n), equilibrium (n,), C (n,)) of the shared filter at the nominal step, in double.

        w_k = w_{k-1} + dA (w_{k-1} - equilibrium u_k), f_hat_k = f_theta_k + C w_k.
        """
        _, A, equilibrium, C = chain_of(self.filter, self.sampling)
        dA = transition(A, self.sampling.method, self.dt)
        dA.flags.writeable = False
        return dA, equilibrium, C

    @property
    def realised(self) -> tuple[PhyFilter, ...]:
        """The filters whose exact sampling this is: of a matched one those with its numerators, else ``filters``."""
        if self.sampling.method != "matched":
            return self.filters
        return tuple(
            entry
            if np.array_equal(chain.C, entry.sections[2])
            else PhyFilter(
                entry.a, _sections.chain_numerator(chain.poles, entry.a, chain.C), poles=entry.poles
            )
            for entry, chain in zip(self.filters, self.recursion.chains, strict=True)
        )

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
        >>> PhyFilter([20.0]).sampled(0.002, g="average").with_filter(PhyFilter([5.0])).sampling.g
        'average'
        """
        return replace(self, filters=filters)  # through __init__, so checked again

    def retune(
        self, state: FilterState, new_filter: SampledPhyFilter | PhyFilter | Sequence[PhyFilter]
    ) -> FilterState:
        """State with which another filter goes on from here: f_hat does not jump, and rest stays rest.

        Parameters
        ----------
        state : FilterState
            Of this filter.
        new_filter : SampledPhyFilter, PhyFilter or sequence of PhyFilter
            The filter to go on with, of any order, step and method; what is not sampled stands for
            ``self.with_filter(new_filter)``.

        Returns
        -------
        FilterState
            For ``new_filter.step`` (or ``self.with_filter(new_filter).step``).

        Raises
        ------
        ValueError
            If the state is not of a filter like this one (order, channels, precision), the new filter has another
            number of channels.

        Notes
        -----
        The new filter goes on from the state in which it would most likely be, had it run all the time, where the
        residual is a random walk with white noise on it, as strong as the walk at the slowest pole of the new filter;
        of another order, from a mean of that state and rest on the present output that makes f_hat calmest then.
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
        new = new_filter if isinstance(new_filter, SampledPhyFilter) else self.with_filter(new_filter)
        return retuning.retune(self.recursion, state, new.recursion)

    def live(self, channels: int | None = None, rules: LiveRules | None = None) -> LiveFilter:
        """A loop's object that takes samples as they come: with time stamps, jitter, gaps, bad values, restarts.

        Parameters
        ----------
        channels : int, optional
            Number n_x of channels of x; needed where neither ``sampling``, E nor one filter per channel tells it.
        rules : LiveRules, optional
            What it does about samples that are no good; by default it keeps f_hat - f_theta for 20 nominal steps, then
            lets it decay as fast as the filter forgets.

        Returns
        -------
        LiveFilter

        Raises
        ------
        ValueError
            For a number of channels that does not fit, or times of the rules that do not.

        Examples
        --------
        >>> live = PhyFilter([20.0]).sampled(0.002).live(3)
        >>> live.step(0.0, [0.0, 0.0, 0.0]).tolist()
        [0.0, 0.0, 0.0]
        """
        n_x, _ = channel_counts(len(self.filters), self.E, self.sampling.channels_or(channels))
        return LiveFilter(self, n_x, LiveRules() if rules is None else rules)

    # -- equality and text --------------------------------------------------------------------------------------

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SampledPhyFilter):
            return NotImplemented
        return self.filters == other.filters and self.sampling == other.sampling

    def __hash__(self) -> int:
        return hash((self.filters, self.sampling))

    def __repr__(self) -> str:
        if len(self.filters) == 1:
            changed = "".join(f", {name}={value!r}" for name, value in self.sampling.unusual.items())
            return f"{self.filters[0]!r}.sampled({self.dt:g}{changed})"
        return f"SampledPhyFilter([{', '.join(map(repr, self.filters))}], {self.sampling!r})"


def chain_of(filter: PhyFilter, sampling: Sampling) -> Chain:
    """The chain that a sampled filter runs on: of a matched one with its own output row.

    Parameters
    ----------
    filter : PhyFilter
    sampling : Sampling
    """
    if sampling.method != "matched":
        return filter.chain
    return filter.chain._replace(C=matching.matched_output(filter, sampling.dt))


def _keeping_zeros(filters: Sequence[PhyFilter], sampling: Sampling) -> Sampling:
    """Exact sampling, matched where that keeps more of what the filters promise."""
    kept = [matching.kept(entry, sampling.dt) for entry in filters]
    return replace(sampling, method="matched") if any(kept) and None not in kept else sampling
