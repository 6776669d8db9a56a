"""What an analysis makes of each option that a filter runs with: counted, refused, or named as an assumption.

The analyses are of a linear filter on good samples. Every field of ``Sampling``, and E, is therefore one of

* counted: it changes the figures, as it changes the filter;
* refused: the figures would be of another system;
* named: it is taken for granted, in ``assumptions`` of the result;
* without effect on what is asked, such as units.

``tests/analysis/test_options.py`` goes over all fields and all analyses and finds out which.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from ..filter import PhyFilter, SampledPhyFilter, Sampling

__all__ = ["Told", "assumed", "inertia_of"]

# What a filter in a loop is told: the command, or the force that acts, lag and delay of the actuator and all.
Told = Literal["commanded", "applied"]

# Of a filter that has it; what is not here has no effect where it is not counted.
_TAKEN_FOR_GRANTED = {
    "limit": "f_hat stays within its limit",
    "g_limit": "g stays within its limits",
    "precision": "rounding in float32 is left out",
    "nonfinite": "every sample is good",
}
_USUAL = {"precision": "float64", "nonfinite": "raise"}


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
        value = getattr(filter.sampling, name)
        if value is None or (name in _USUAL and value == _USUAL[name]):
            continue
        if refused and name in refused:
            raise ValueError(f"{name}: {refused[name]}")
        if name in _TAKEN_FOR_GRANTED and name not in counted:
            said.append(_TAKEN_FOR_GRANTED[name])
    return tuple(said)


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
    size = float(np.linalg.norm(values, 2)) if values.ndim == 2 else float(np.max(np.abs(values)))
    return _signals.number("inertia", size, "", above=0.0)
