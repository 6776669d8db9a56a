"""Analysis of several channels, each with a filter of its own: the one place where channels come apart."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from inspect import signature
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar, cast, overload

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..filter import FilterBank, PhyFilter, SampledBank, SampledPhyFilter
from ..results import PerChannel, Result

__all__ = ["Filter", "PerFilter", "channels_of", "per_channel"]

Filter = PhyFilter | SampledPhyFilter
_P = ParamSpec("_P")
_R = TypeVar("_R", bound=Result, covariant=True)


def channels_of(system: object) -> list[tuple[str, Filter]] | None:
    """Several filters one by one, those of one system named by channel; None of what is not several.

    With E a channel's filter takes its own row of E^+, as the one column that has this row as its pseudo-inverse.
    """
    if isinstance(system, FilterBank) or (isinstance(system, SampledPhyFilter) and len(system.filters) > 1):
        filters: Iterable[Filter] = system if isinstance(system, FilterBank) else system.by_channel
        if isinstance(system, SampledPhyFilter) and system.E is not None:
            columns = [np.linalg.pinv(row[None]) for row in np.linalg.pinv(system.E)]
            filters = [
                SampledPhyFilter(one.filter, one.sampling, E=E)
                for one, E in zip(system.by_channel, columns, strict=True)
            ]
        return [(f"channel {i}", entry) for i, entry in enumerate(filters)]
    if isinstance(system, Sequence) and system and all(isinstance(entry, Filter) for entry in system):
        return [("", entry) for entry in system]
    return None


class PerFilter(Protocol[_P, _R]):
    """An analysis of one filter, or of several: then channel by channel, each argument one for all or a list."""

    @overload
    def __call__(
        self, filter: SampledBank | Sequence[Filter], *arguments: object, **named: object
    ) -> PerChannel[_R]: ...

    @overload
    def __call__(self, filter: Filter, *args: _P.args, **kwargs: _P.kwargs) -> _R: ...


def per_channel(function: Callable[Concatenate[Filter, _P], _R]) -> PerFilter[_P, _R]:
    """Let an analysis of one filter answer for a bank of them too."""
    parameters, alone = signature(function), cast(Callable[..., _R], function)

    @wraps(function)
    def answer(filter: Any, *args: Any, **kwargs: Any) -> Any:
        filters = channels_of(filter)
        if filters is None:
            return function(filter, *args, **kwargs)
        given = parameters.bind(filter, *args, **kwargs).arguments
        del given["filter"]
        if np.ndim(given.get("inertia", 1.0)) == 2:
            given["inertia"] = _of_channels(given["inertia"], filter)
        spread = {name: _spread(name, value, len(filters)) for name, value in given.items()}
        return PerChannel(
            alone(entry, **{name: values[i] for name, values in spread.items()})
            for i, (_, entry) in enumerate(filters)
        )

    return answer


def _of_channels(M: ArrayLike, filter: object) -> FloatArray:
    """What of a full inertia each channel of a system hears: the sizes of its rows (n,). The matrix where E takes a row
    of it, or the filters are no channels of one system."""
    given = _signals.real("inertia", M)
    together = isinstance(filter, SampledPhyFilter) and filter.E is None
    return np.linalg.norm(given, axis=1) if together or isinstance(filter, FilterBank) else given


def _spread(name: str, value: Any, count: int) -> Sequence[Any]:
    several = isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim == 1)
    if not several or (name == "ratios" and np.ndim(value) == 1):  # (low, high) is one for all
        return [value] * count
    if len(value) != count:
        raise ValueError(
            f"{name}: expected one for all channels or one for each of the {count}, got {len(value)}"
        )
    return list(value)
