"""What an analysis makes of each option that a filter runs with: counted, refused, or named as an assumption.

The analyses are of a linear filter on good samples. Every field of ``Sampling``, and E, is therefore one of

* counted: it changes the figures, as it changes the filter;
* refused: the figures would be of another system;
* named: it is taken for granted, in ``assumptions`` of the result;
* without effect on what is asked: units; what a bad sample does, of which there are none; rounding in float32, which
  states carry along, but for ``error_bound``, which names it.

``tests/analysis/test_options.py`` goes over all fields and all analyses and finds out which.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from ..filter import PhyFilter, SampledPhyFilter, Sampling
from ..values.loop import Told

__all__ = ["InputGains", "Told", "assumed", "checked_filter", "inertia_of", "input_gains", "units_of"]

# Of a filter that has it; what is not here has no effect where it is not counted.
_TAKEN_FOR_GRANTED = {
    "limit": "f_hat stays within its limit",
    "g_limit": "g stays within its limits",
}


def checked_filter(filter: object) -> PhyFilter | SampledPhyFilter:
    """The filter of an analysis.

    Raises
    ------
    TypeError
        If it is something else.
    """
    if not isinstance(filter, PhyFilter | SampledPhyFilter):
        raise TypeError(f"filter: expected a PhyFilter or a SampledPhyFilter, got {type(filter).__name__}")
    return filter


def assumed(
    filter: PhyFilter | SampledPhyFilter,
    *,
    counted: Collection[str] = (),
    refused: Mapping[str, str] | None = None,
) -> tuple[str, ...]:
    """What an analysis takes for granted of the options of a filter.

    Parameters
    ----------
    filter : PhyFilter or SampledPhyFilter
    counted : collection of str
        Fields of ``Sampling`` that the analysis counts.
    refused : mapping of str to str, optional
        Fields that it refuses where they are not as usual, with the reason.

    Returns
    -------
    tuple of str

    Raises
    ------
    ValueError
        For an option that is refused.

    Examples
    --------
    >>> assumed(PhyFilter([20.0]).sampled(0.01, limit=2.0))
    ('f_hat stays within its limit',)
    """
    if not isinstance(filter, SampledPhyFilter):
        return ()
    said = []
    for name in (entry.name for entry in fields(Sampling)):
        if getattr(filter.sampling, name) is None:
            continue
        if refused and name in refused:
            raise ValueError(f"{name}: {refused[name]}")
        if name in _TAKEN_FOR_GRANTED and name not in counted:
            said.append(_TAKEN_FOR_GRANTED[name])
    return tuple(said)


def units_of(filter: PhyFilter | SampledPhyFilter) -> Mapping[str, str]:
    """Units of x, g and f, those that the filter knows.

    Parameters
    ----------
    filter : PhyFilter or SampledPhyFilter

    Returns
    -------
    mapping of str to str

    Examples
    --------
    >>> dict(units_of(PhyFilter([20.0]).sampled(0.01, units={"f": "N"})))
    {'f': 'N'}
    """
    return filter.sampling.units if isinstance(filter, SampledPhyFilter) else {}


def inertia_of(filter: PhyFilter | SampledPhyFilter, given: ArrayLike | None) -> float:
    """|M_hat| in the spectral norm: what a call is given, else the filter's own, else 1.

    Raises
    ------
    ValueError
        If it is not positive and finite, or comes with every sample and none is given.

    Examples
    --------
    >>> inertia_of(PhyFilter([20.0]).sampled(0.01, inertia=12.0), None)
    12.0
    """
    M = filter.sampling.inertia_or(given) if isinstance(filter, SampledPhyFilter) else given
    values = _signals.real("inertia", 1.0 if M is None else M)
    if not values.size:
        raise ValueError("inertia: expected a number, a diagonal or a matrix, got none")
    if values.ndim != 2:
        _signals.number("inertia", float(np.min(values)), above=0.0)
    size = float(np.linalg.norm(values, 2)) if values.ndim == 2 else float(np.max(values))
    return _signals.number("inertia", size, above=0.0)


class InputGains(NamedTuple):
    """By what x' and g enter the filter, whose residual is E^+ (M_hat x' - g) - f_theta, in the spectral norm.

    Attributes
    ----------
    x : float
        norm2(E^+ M_hat): what of x counts in f, noise included.
    g : float
        norm2(E^+): what of g counts in f, and of all other forces, a wrong inertia's too.
    inertia : float
        norm2(M_hat).
    """

    x: float
    g: float
    inertia: float


def input_gains(
    filter: PhyFilter | SampledPhyFilter, inertia: ArrayLike | None, *, needed: bool = True
) -> InputGains:
    """What M_hat and E make of the signals on their way into the filter.

    Parameters
    ----------
    filter : PhyFilter or SampledPhyFilter
    inertia : float, (n_x,) or (n_x, n_x) array_like, optional
        M_hat; None: the filter's own, else 1.
    needed : bool
        Whether anything counts by M_hat; if not, one that comes with every sample may be left out.

    Returns
    -------
    InputGains

    Raises
    ------
    TypeError, ValueError
        For an inertia that is not of positive size or does not fit E, or that is missing where it is needed.

    Examples
    --------
    >>> sampled = PhyFilter([20.0]).sampled(0.01, E=[[0.1], [0.0]], inertia=[2.0, 3.0])
    >>> tuple(round(gain, 9) for gain in input_gains(sampled, None))
    (20.0, 10.0, 3.0)
    """
    E = filter.E if isinstance(filter, SampledPhyFilter) else None
    if isinstance(filter, SampledPhyFilter) and (needed or not isinstance(filter.sampling.inertia, str)):
        inertia = filter.sampling.inertia_or(inertia)
    M = 1.0 if inertia is None else inertia
    size = inertia_of(filter, M)
    if E is None:
        return InputGains(size, 1.0, size)
    E_left, M = np.linalg.pinv(E), _signals.inertia("inertia", M, len(E))
    # A diagonal scales the columns of E^+.
    heard = E_left @ M if M.ndim == 2 else E_left * M
    return InputGains(float(np.linalg.norm(heard, 2)), float(np.linalg.norm(E_left, 2)), size)
