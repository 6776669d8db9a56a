"""Several channels with a filter of its own for each: :func:`stack` and what it gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import overload

import control as ct
from numpy.typing import ArrayLike

from . import matching
from .matrices import continuous_state_space
from .phyfilter import PhyFilter, SampledPhyFilter, sampling_of
from .sampling import InertiaInput, Method, NonFinite, Precision, Rule, Sampling, SamplingOptions

__all__ = ["FilterBank", "SampledBank", "stack"]


class SampledBank(SampledPhyFilter):
    """A sampled filter with a filter of its own for each channel; made by :func:`stack` and ``FilterBank.sampled``.

    A :class:`SampledPhyFilter` in everything; what analyses it answers channel by channel.

    Parameters
    ----------
    filters, sampling, E
        As there.
    """


class FilterBank(tuple[PhyFilter, ...]):
    """A filter of its own for each channel, continuous: a tuple of them; made by :func:`stack`.

    What takes a filter takes a bank: ``frequency_response``, ``pole_zero_map``, bounds, variances and margins, which
    answer channel by channel, ``phyfilter_block``, ``save``, ``export_fmu``.

    Examples
    --------
    >>> bank = stack([PhyFilter([2.0]), PhyFilter([400.0, 40.0])])
    >>> bank.sampled(0.01)
    SampledPhyFilter([PhyFilter(a=[2.0]), PhyFilter(a=[400.0, 40.0])], Sampling(0.01))
    """

    __slots__ = ()

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
    ) -> SampledBank:
        """The filters on sampled data, all with the same options.

        Parameters
        ----------
        dt, method, g, f_theta, precision, E, delay, limit, g_limit, nonfinite, channels, inertia, units
            As for :meth:`PhyFilter.sampled`.
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
        return SampledBank(self, sampling_of(self, dt, method, g, f_theta, options), E=E)

    def to_ss(self) -> ct.StateSpace:
        """All channels as one python-control state space, as ``PhyFilter.state_space`` has them.

        Returns
        -------
        control.StateSpace
            Inputs x[i], g[i], f_theta[i] (all x first, then all g, then all f_theta), outputs f_hat[i].

        Examples
        --------
        >>> stack([PhyFilter([2.0]), PhyFilter([400.0, 40.0])]).to_ss().state_labels
        ['w[0,0]', 'w[1,0]', 'w[1,1]']
        """
        return continuous_state_space([entry.sections for entry in self])

    def __repr__(self) -> str:
        return f"stack([{', '.join(map(repr, self))}])"


@overload
def stack(filters: Sequence[PhyFilter]) -> FilterBank: ...


@overload
def stack(filters: Sequence[SampledPhyFilter]) -> SampledBank: ...


def stack(filters: Sequence[PhyFilter] | Sequence[SampledPhyFilter]) -> FilterBank | SampledBank:
    """A filter of its own for each channel.

    Parameters
    ----------
    filters : sequence of PhyFilter or of SampledPhyFilter
        One per channel, in the order of the channels; orders may differ, sampling options must not.

    Returns
    -------
    FilterBank or SampledBank

    Raises
    ------
    TypeError
        If they are not all filters, or some are sampled and some are not.
    ValueError
        If the sequence is empty or the options differ (the option is named).

    Examples
    --------
    >>> slow, fast = PhyFilter([2.0]), PhyFilter([400.0, 40.0])
    >>> stack([slow, slow, fast]).sampled(0.01).run([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])[1].round(3).tolist()
    [1.98, 1.98, 1.752]
    >>> stack([slow.sampled(0.01), fast.sampled(0.01)]) == stack([slow, fast]).sampled(0.01)
    True
    """
    given = tuple(filters)
    if not given:
        raise ValueError("stack: expected at least one filter, got none")
    continuous = [entry for entry in given if isinstance(entry, PhyFilter)]
    sampled = [entry for entry in given if isinstance(entry, SampledPhyFilter)]
    if len(given) == len(continuous):
        return FilterBank(continuous)
    if len(given) != len(sampled):
        kind = SampledPhyFilter if isinstance(given[0], SampledPhyFilter) else PhyFilter
        i, odd = next((i, entry) for i, entry in enumerate(given) if not isinstance(entry, kind))
        raise TypeError(
            f"stack: channel {i} is {odd!r}, expected a {kind.__name__} as channel 0 is, or as all should be; sample "
            "all, F.sampled(dt), or none"
        )
    if {entry.sampling.method for entry in sampled} == {"exact", "matched"}:
        sampled = list(map(_as_matched, sampled))
    reference = sampled[0]
    for i, entry in enumerate(sampled):
        usual = reference.sampling.differences(entry.sampling)
        for name, value in entry.sampling.differences(reference.sampling).items():
            raise ValueError(
                f"stack: channel {i} has {name}={value!r} but channel 0 has {usual[name]!r}: all options "
                "must agree; only the coefficients may differ"
            )
    return SampledBank([part for entry in sampled for part in entry.filters], reference.sampling)


def _as_matched(sampled: SampledPhyFilter) -> SampledPhyFilter:
    """A filter whose exact sampling loses nothing under the name "matched"; others as they are."""
    if sampled.sampling.method != "exact" or any(
        matching.kept(f, sampled.dt) is not False for f in sampled.filters
    ):
        return sampled
    return SampledPhyFilter(sampled.filters, replace(sampled.sampling, method="matched"))
