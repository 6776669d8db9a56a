"""The number of a filter's channels as a structural parameter of its FMI 3 FMU."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..filter import PhyFilter, SampledPhyFilter
from .description import FmuInterface, InterfaceVariable

__all__ = ["room_for", "with_channels"]

# What a filter has for each channel, in front of other indices.
_EACH = frozenset({"x", "g", "f_theta", "f_hat", "w", "der(w)", "limit", "g_low", "g_high", "M"})


def with_channels(interface: FmuInterface, channels: int) -> FmuInterface:
    """A filter's FMU whose importers may choose the number of channels, up to those that the model has room for.

    Parameters
    ----------
    interface : FmuInterface
        Of a filter with one F for all channels, which do not act on each other; with arrays.
    channels : int
        As long as the importer says nothing.

    Returns
    -------
    FmuInterface
        With the structural parameter ``channels`` after all other variables. Channels that are not in use rest: their
        inputs and states stay at their start values.
    """
    most = next(entry.shape[0] for entry in interface.variables if entry.name == "x")
    place = len(interface.variables)

    def resized(variable: InterfaceVariable) -> InterfaceVariable:
        if variable.name not in _EACH or variable.shape[:1] != (most,):
            return variable
        each = variable.count // most
        start = None if variable.start is None else variable.start[: channels * each]
        return replace(variable, shape=(channels, *variable.shape[1:]), start=start, length=place)

    number = InterfaceVariable(
        "channels",
        "structure",
        start=(float(channels),),
        description="Number of channels of x",
        minimum=1.0,
        maximum=float(most),
    )
    return replace(interface, variables=(*map(resized, interface.variables), number), most_channels=most)


def room_for(
    system: object,
    channels: int | None,
    most: int,
    inertia: ArrayLike | Literal["scalar", "diagonal", "full"] | None,
    *,
    named: bool,
    grouped: bool,
) -> tuple[int, int]:
    """Channels that the model has room for, and those in use at first.

    Parameters
    ----------
    system, channels, inertia
        As for :func:`export_fmu`.
    most : int
        Its ``max_channels``.
    named : bool
        Whether the channels have names.
    grouped : bool
        Whether the FMU has arrays.

    Raises
    ------
    ValueError
        If the filter is none whose channels are alike and apart from each other.
    """
    first = 1 if channels is None else channels
    coupled = (
        inertia == "full" if isinstance(inertia, str) else np.ndim(0.0 if inertia is None else inertia) > 0
    )
    if not grouped:
        problem = 'arrays of FMI 3: fmi="3.0", arrays=True'
    elif not _alike(system):
        problem = "one filter for all channels, without E"
    elif coupled:
        problem = "an inertia that is one number for all channels, or an input of kind 'scalar' or 'diagonal'"
    elif named:
        problem = "channels without names"
    elif most < 2 or not 1 <= first <= most:
        problem = f"1 <= channels <= max_channels and max_channels of 2 or more, got {first} and {most}"
    else:
        return most, first
    raise ValueError(f"max_channels needs {problem}")


def _alike(system: object) -> bool:
    if isinstance(system, SampledPhyFilter):
        return len(system.filters) == 1 and system.E is None
    return isinstance(system, PhyFilter)
