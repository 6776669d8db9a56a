"""A filter on disk: a TOML file that a person can read and write, and that gives back every bit.

::

    # PhyFilter, F(s) = 400/(s**2 + 40*s + 400)
    format = "phyfilter"
    version = 1
    a = [400.0, 40.0]                        # ascending a_0 ... a_(n-1); a_i in (rad/s)^(n-i)
    b = [400.0, 0.0]                         # ascending; left out: the low-pass form N = a_0
    poles = [[-20.0, 0.0], [-20.0, 0.0]]     # [real, imaginary] in rad/s; may be left out, must agree with a to 1e-6

    [sampled]                                # only of a SampledPhyFilter
    dt = 0.002                               # s
    method = "exact"
    g = "hold"
    f_theta = "average"
    precision = "float64"
    # delay, limit, g_limit, nonfinite, E: as for Sampling; may be left out

    [signals]                                # may be left out, as may each key
    channels = ["x", "y", "z"]
    units = { x = "m/s", g = "N", f = "N" }
    inertia = 1.2                            # or [1.2, 1.2, 1.3], or a matrix
                                             # of a [sampled] filter also: channels = 3, their number, and inertia =
                                             # "scalar", "diagonal" or "full", which comes with every sample

Filters of their own for every channel, sampled or not, have a, b and poles in one ``[[filters]]`` table a channel
instead. Unknown keys, unknown versions and numbers that are not finite (but for limits of ``inf``) are refused.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from .._output import replacing
from .._renamed import takes_signals
from ..filter import FilterBank, PhyFilter, SampledPhyFilter, Sampling
from ..filter.sampling import ChannelOptions
from .table import TomlTable, parsed, refuse_oversize

__all__ = ["load", "read_noted", "save"]

FORMAT = "phyfilter"
VERSION = 1

_FILTER_KEYS = ("a", "b", "poles")
_TOP_KEYS = ("format", "version", *_FILTER_KEYS, "filters", "sampled", "signals")
_CHOICES = ("method", "g", "f_theta", "precision", "nonfinite")
_ALWAYS = (
    "dt",
    "method",
    "g",
    "f_theta",
    "precision",
)  # written; the others where they are not the usual ones
_LIMITS = ("limit", "g_limit")
_SAMPLED_KEYS = ("dt", *_CHOICES, "E", "delay", *_LIMITS)
_SIGNAL_KEYS = ("channels", "units", "inertia")
_UNIT_KEYS = ("x", "g", "f")
Filter = PhyFilter | FilterBank | SampledPhyFilter
# Poles of all filters of a file together: finding them is what takes time.
_MOST_POLES = 1024


@takes_signals
def save(
    path: str | os.PathLike[str],
    filter: PhyFilter | FilterBank | SampledPhyFilter,
    *,
    channels: Sequence[str] | None = None,
    inertia: ArrayLike | None = None,
    units: Mapping[str, str] | None = None,
) -> None:
    """Write a filter to a TOML file, whole or not at all: a failed write leaves the old file as it was.

    Parameters
    ----------
    path : str or path-like
        Written over if it exists.
    filter : PhyFilter, FilterBank or SampledPhyFilter
    channels, inertia, units
        Of a continuous filter: names of the channels of x, the constant M_hat, and units of "x", "g" and "f", for
        ``load(path, dt=...)`` and the exports of the command line. A sampled one has them in its ``sampling``.

    Raises
    ------
    TypeError
        If ``filter`` is something else; for names and units that are no text.
    ValueError
        If a sampled filter is told what its ``sampling`` is for; if the filter has another number of channels than the
        names or the inertia; if the file would be one that :func:`load` refuses for its size.
    OSError
        If the file cannot be written.

    Warns
    -----
    UserWarning
        If F = 0.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from phyfilter_ctl import PhyFilter
    >>> from phyfilter_ctl.filterfile import load, save
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "filter.toml"
    ...     save(path, PhyFilter([400.0, 40.0]).sampled(0.002))
    ...     print(path.read_text(), end="")
    ...     load(path)
    # PhyFilter, F(s) = 400/(s**2 + 40*s + 400)
    format = "phyfilter"
    version = 1
    a = [400.0, 40.0]
    poles = [[-20.0, 0.0], [-20.0, 0.0]]
    <BLANKLINE>
    [sampled]
    dt = 0.002
    method = "exact"
    g = "hold"
    f_theta = "average"
    precision = "float64"
    PhyFilter(a=[400.0, 40.0]).sampled(0.002)
    """
    if not isinstance(filter, Filter):
        hint = "; stack them first" if isinstance(filter, list | tuple) else ""
        raise TypeError(f"filter: expected a PhyFilter, a SampledPhyFilter or a stack, got {filter!r}{hint}")
    noted = _noted_beside(filter, channels, inertia, units)
    _refuse_many([entry.order for entry in _filters(filter)])
    if not any(np.any(entry.b) for entry in _filters(filter)):
        warnings.warn(
            f"{os.fspath(path)}: F = 0 is saved, which estimates nothing beyond f_theta: what learning returns where "
            "no filter keeps the limits of a loop",
            stacklevel=2,
        )
    data = _text(filter, noted).encode()
    refuse_oversize(data)
    with replacing(path) as file:
        file.write(data)


@overload
def load(path: str | os.PathLike[str], *, dt: float) -> SampledPhyFilter: ...
@overload
def load(path: str | os.PathLike[str], *, dt: None = None) -> PhyFilter | FilterBank | SampledPhyFilter: ...
def load(
    path: str | os.PathLike[str], *, dt: float | None = None
) -> PhyFilter | FilterBank | SampledPhyFilter:
    """Read the filter of a TOML file: a SampledPhyFilter if it has a ``[sampled]`` table, else a PhyFilter or a bank.

    Parameters
    ----------
    path : str or path-like
    dt : float, optional
        Sampling interval in s at which a continuous filter is sampled, with the names, units and inertia that the file
        notes beside it. Without, those stay in the file.

    Returns
    -------
    PhyFilter, FilterBank or SampledPhyFilter
        Equal to the one saved, bit for bit; a sampled one with the names, units and inertia of ``[signals]`` in its
        ``Sampling``.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no TOML (the line is named), no filter, of a version this library does not read, has an unknown key,
        or a value of the wrong type, not finite or not allowed by the filter: the file and the key are named. If it is
        longer than 500 kB or holds filters of more than 1024 poles together. If ``dt`` is given for a filter that is
        sampled already.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from phyfilter_ctl.filterfile import load
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "by_hand.toml"
    ...     _ = path.write_text('format = "phyfilter"\\nversion = 1\\na = [20]\\n')
    ...     load(path)
    PhyFilter(a=[20.0])
    """
    filter, noted = read_noted(path)
    if dt is None:
        return filter
    if isinstance(filter, SampledPhyFilter):
        raise ValueError(
            f"{os.fspath(path)}: dt is for a continuous filter, and this one is sampled every {filter.dt:g} s already"
        )
    sampled = SampledPhyFilter(filter, dt)
    return replace(sampled, sampling=sampled.sampling.told(**noted))


def read_noted(path: str | os.PathLike[str]) -> tuple[Filter, ChannelOptions]:
    """The filter of a file, and what the file notes of its channels: names, units, inertia.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    filter : PhyFilter, FilterBank or SampledPhyFilter
    noted : ChannelOptions
        ``channels``, ``inertia`` and ``units`` of a continuous filter, those of them that the file has; a sampled one
        has them in its ``sampling``.

    Raises
    ------
    OSError, ValueError
        As for :func:`load`.
    """
    return _read(Path(path))


# -- writing ----------------------------------------------------------------------------------------------------


def _filters(filter: Filter) -> tuple[PhyFilter, ...]:
    if isinstance(filter, PhyFilter):
        return (filter,)
    return filter.filters if isinstance(filter, SampledPhyFilter) else filter


def _text(filter: Filter, about: Sampling) -> str:
    head = {"format": FORMAT, "version": VERSION}
    filters = _filters(filter)
    if len(filters) == 1 and not isinstance(filter, FilterBank):
        blocks = [_title(filters[0]) + _lines(head | _coefficients(filters[0]))]
    else:
        blocks = [f"# PhyFilter, one for each of {len(filters)} channels\n" + _lines(head)]
        blocks += [f"{_title(entry)}[[filters]]\n{_lines(_coefficients(entry))}" for entry in filters]
    if isinstance(filter, SampledPhyFilter):
        blocks.append("[sampled]\n" + _lines(_options(filter)))
    if noted := _noted(about):
        blocks.append("[signals]\n" + _lines(noted))
    return "\n".join(blocks)


def _title(filter: PhyFilter) -> str:
    return f"# PhyFilter, F(s) = {filter.formula()}\n"


def _coefficients(filter: PhyFilter) -> dict[str, object]:
    table: dict[str, object] = {"a": filter.a.tolist()}
    if not filter.is_lowpass:
        table["b"] = filter.b.tolist()
    if _kept_by_reading(filter):
        table["poles"] = [[pole.real, pole.imag] for pole in filter.poles.tolist()]
    return table


def _kept_by_reading(filter: PhyFilter) -> bool:
    """Whether the poles beside ``a`` give this filter back.

    Poles that the root finder found need not: far apart, they may miss a small coefficient by more than poles given
    by hand are allowed to. It finds the same ones again, so they are left out.
    """
    try:
        again = PhyFilter(filter.a, filter.b, poles=filter.poles)
    except ValueError:
        return False
    return again == filter and np.array_equal(again.poles, filter.poles)


def _options(sampled: SampledPhyFilter) -> dict[str, object]:
    sampling = sampled.sampling
    table = {key: getattr(sampling, key) for key in _ALWAYS}
    return table | {key: value for key, value in sampling.unusual.items() if key not in _SIGNAL_KEYS}


def _noted_beside(
    filter: Filter,
    channels: Sequence[str] | None,
    inertia: ArrayLike | None,
    units: Mapping[str, str] | None,
) -> Sampling:
    """What is to be noted, checked: the filter's own sampling, or one that holds what is given for it."""
    given = {"channels": channels, "inertia": inertia, "units": units}
    told = [name for name, value in given.items() if value is not None]
    if isinstance(filter, SampledPhyFilter):
        if told:
            raise ValueError(f"{told[0]}: a sampled filter has its own, filter.sampled(dt, {told[0]}=...)")
        return filter.sampling
    for name, kind, what in (
        ("channels", int | np.integer, "names"),
        ("inertia", str, "numbers; one that comes with every sample is of a sampled filter"),
    ):
        if isinstance(given[name], kind):
            raise ValueError(f"{name}: expected {what}, got {given[name]!r}")
    noted = Sampling(1.0, channels=channels, inertia=inertia, units=units)
    _refuse_disagreement(filter, noted)
    return noted


def _noted(noted: Sampling) -> dict[str, object]:
    table: dict[str, object] = {}
    if noted.channels is not None:
        table["channels"] = list(noted.names) or noted.channels
    if noted.units:
        table["units"] = dict(noted.units)
    if noted.inertia is not None:
        table["inertia"] = noted.inertia if isinstance(noted.inertia, str) else noted.inertia.tolist()
    return table


def _lines(table: Mapping[str, object]) -> str:
    return "".join(f"{key} = {_value(value)}\n" for key, value in table.items())


def _value(value: object) -> str:
    """A value in TOML. The keys this file writes need no quotes."""
    if isinstance(value, str):
        # A JSON string is a TOML string where non-ASCII stays as it is (no surrogate pairs) and DEL is escaped too.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_value(entry)}' for key, entry in value.items())} }}"
    return repr(value)  # the shortest text that reads back as the same double; the int version


# -- reading ----------------------------------------------------------------------------------------------------


def _read(path: Path) -> tuple[Filter, ChannelOptions]:
    top = TomlTable(path, "", parsed(path))
    top.refuse_other_formats(FORMAT, VERSION, "filter")
    top.refuse_unknown(_TOP_KEYS)
    filters = _read_filters(top)
    if "sampled" in top:
        filter: Filter = _read_sampled(top.table("sampled"), filters)
    else:
        filter = FilterBank(filters) if "filters" in top else filters[0]
    noted: ChannelOptions = {}
    if "signals" in top:
        sampled = filter if isinstance(filter, SampledPhyFilter) else None
        noted = _read_signals(top.table("signals"), sampled is not None)
        try:
            sampling = Sampling(1.0, **noted) if sampled is None else replace(sampled.sampling, **noted)
            _refuse_disagreement(filter, sampling)
            if sampled is not None:
                filter, noted = replace(sampled, sampling=sampling), {}
        except ValueError as error:
            raise top.error("signals", str(error)) from error
    return filter, noted


def _read_filters(top: TomlTable) -> tuple[PhyFilter, ...]:
    if "filters" not in top:
        return (_read_filter(top),)
    for key in _FILTER_KEYS:
        if key in top:
            raise top.error(key, "expected either a, b, poles or [[filters]] tables, got both")
    tables = top.tables("filters")
    for table in tables:
        table.refuse_unknown(_FILTER_KEYS)
    _refuse_many([len(table.numbers("a")) for table in tables], lambda text: top.error("filters", text))
    return tuple(_read_filter(table) for table in tables)


def _read_filter(table: TomlTable) -> PhyFilter:
    a = table.numbers("a")
    b = table.numbers("b") if "b" in table else None
    poles = None
    if "poles" in table:
        pairs = table.matrix("poles", columns=2)
        poles = [complex(real, imaginary) for real, imaginary in pairs]
    try:
        return PhyFilter(a, b, poles=poles)
    except ValueError as error:
        keys = ", ".join(key for key in _FILTER_KEYS if key in table)
        raise table.error(keys, str(error)) from error


def _read_sampled(table: TomlTable, filters: tuple[PhyFilter, ...]) -> SampledPhyFilter:
    table.refuse_unknown(_SAMPLED_KEYS)
    options: dict[str, Any] = {key: table.text(key) for key in _CHOICES if key in table}
    E = table.matrix("E") if "E" in table else None
    if "delay" in table:
        options["delay"] = table.number("delay")
    options |= {key: table.number_or_numbers(key) for key in _LIMITS if key in table}
    dt = table.number("dt")
    try:
        return SampledPhyFilter(filters, Sampling(dt, **options), E=E)
    except ValueError as error:
        raise ValueError(f"{table.file}: [sampled] {error}") from error


def _read_signals(table: TomlTable, sampled: bool) -> ChannelOptions:
    """What the table has; only a sampled filter's may have a number of channels and a kind of inertia."""
    table.refuse_unknown(_SIGNAL_KEYS)
    found: ChannelOptions = {}
    if "units" in table:
        inner = table.table("units")
        inner.refuse_unknown(_UNIT_KEYS)
        found["units"] = {key: inner.text(key) for key in _UNIT_KEYS if key in inner}
    if "channels" in table:
        counted = sampled and isinstance(table.values["channels"], int)
        found["channels"] = table.integer("channels") if counted else table.texts("channels")
    if "inertia" in table:
        kind = sampled and isinstance(table.values["inertia"], str)
        found["inertia"] = table.text("inertia") if kind else table.numbers_of_any_shape("inertia")
    try:
        Sampling(1.0, **found)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{table.file}: [signals] {error}") from error
    return found


# -- checks -----------------------------------------------------------------------------------------------------


def _refuse_many(orders: Sequence[int], error: Callable[[str], ValueError] = ValueError) -> None:
    if sum(orders) > _MOST_POLES:
        raise error(
            f"expected filters of at most {_MOST_POLES} poles together, got {len(orders)} filters of {sum(orders)}; "
            "one filter may serve all channels"
        )


def _refuse_disagreement(filter: Filter, noted: Sampling) -> None:
    """Raise where the filter has another number of channels than its names or its inertia."""
    filters = _filters(filter)
    if isinstance(filter, SampledPhyFilter) and filter.E is not None:
        n_x, reason = len(filter.E), "E has as many rows"
    elif len(filters) > 1 or isinstance(filter, FilterBank):
        n_x, reason = len(filters), "there are as many filters"
    else:
        return
    if noted.names and len(noted.names) != n_x:
        raise ValueError(f"channels: expected {n_x} names ({reason}), got {len(noted.names)}")
    if isinstance(noted.inertia, np.ndarray) and noted.inertia.ndim and len(noted.inertia) != n_x:
        raise ValueError(f"inertia: expected size {n_x} ({reason}), got {len(noted.inertia)}")
