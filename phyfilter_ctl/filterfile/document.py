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
    # delay, limit, g_limit, nonfinite: as for Sampling, E: as for SampledPhyFilter; may be left out

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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._output import replacing
from ..filter import FilterBank, InertiaInput, PhyFilter, SampledPhyFilter, Sampling, SamplingOptions
from .table import TomlTable, parsed, refuse_oversize

__all__ = ["Signals", "load", "load_signals", "save", "settled_inertia", "settled_signals"]

FORMAT = "phyfilter"
VERSION = 1

Inertia = float | tuple[float, ...] | tuple[tuple[float, ...], ...]

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
_NOTHING = ((), "", None)  # where a signal has no name, no unit, no inertia
Filter = PhyFilter | FilterBank | SampledPhyFilter
# Poles of all filters of a file together: finding them is what takes time.
_MOST_POLES = 1024


@dataclass(frozen=True, init=False)
class Signals:
    """The signals a filter is meant for: a note beside its coefficients.

    A sampled filter has them in its ``Sampling``, and needs no such note; where it has both they must agree.

    Parameters
    ----------
    channels : sequence of str
        Names of the channels of x; empty where not known.
    unit_x, unit_g, unit_f : str
        Units of x, of g (and of M x'), and of f, f_theta and f_hat.
    inertia : array_like, optional
        Constant inertia M_hat: a scalar, (n_x,) a diagonal, or (n_x, n_x). Kept as a float or as tuples.

    Raises
    ------
    TypeError
        If a name or unit is no text or the inertia no array of real numbers.
    ValueError
        If names repeat or are not printable, or the inertia is not finite or of another shape.

    Examples
    --------
    >>> from phyfilter_ctl.filterfile import Signals
    >>> Signals(["x", "y"], unit_x="m/s", inertia=[1.5, 2.0]).inertia
    (1.5, 2.0)
    """

    channels: tuple[str, ...]
    unit_x: str
    unit_g: str
    unit_f: str
    inertia: Inertia | None

    def __init__(
        self,
        channels: Sequence[str] = (),
        *,
        unit_x: str = "",
        unit_g: str = "",
        unit_f: str = "",
        inertia: ArrayLike | None = None,
    ) -> None:
        names = _signals.channel_names(channels, len(channels))
        for key, unit in (("unit_x", unit_x), ("unit_g", unit_g), ("unit_f", unit_f)):
            if not isinstance(unit, str):
                raise TypeError(f"{key}: expected text, got {unit!r}")
            object.__setattr__(self, key, unit)
        object.__setattr__(self, "channels", names)
        object.__setattr__(self, "inertia", None if inertia is None else _inertia(inertia, len(names)))


def save(
    path: str | os.PathLike[str],
    filter: PhyFilter | FilterBank | SampledPhyFilter,
    *,
    signals: Signals | None = None,
) -> None:
    """Write a filter to a TOML file, whole or not at all: a failed write leaves the old file as it was.

    Parameters
    ----------
    path : str or path-like
        Written over if it exists.
    filter : PhyFilter, FilterBank or SampledPhyFilter
    signals : Signals, optional
        Names, units and inertia to note beside it, besides those that a sampled filter has in its ``Sampling``.

    Raises
    ------
    TypeError
        If ``filter`` or ``signals`` is something else.
    ValueError
        If the filter and ``signals`` disagree about the channels, a unit or the inertia, or the file would be one that
        :func:`load` refuses for its size.
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
    if not (signals is None or isinstance(signals, Signals)):
        raise TypeError(f"signals: expected Signals or None, got {signals!r}")
    signals = settled_signals(filter, signals)
    _refuse_disagreement(filter, signals)
    _refuse_many([entry.order for entry in _filters(filter)])
    if not any(np.any(entry.b) for entry in _filters(filter)):
        warnings.warn(
            f"{os.fspath(path)}: F = 0 is saved, which estimates nothing beyond f_theta: what learning returns where "
            "no filter keeps the limits of a loop",
            stacklevel=2,
        )
    data = _text(filter, signals).encode()
    refuse_oversize(data)
    with replacing(path) as file:
        file.write(data)


def load(path: str | os.PathLike[str]) -> PhyFilter | FilterBank | SampledPhyFilter:
    """Read the filter of a TOML file: a SampledPhyFilter if it has a ``[sampled]`` table, else a PhyFilter or a bank.

    Parameters
    ----------
    path : str or path-like

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
        longer than 500 kB or holds filters of more than 1024 poles together.

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
    return _read(Path(path))[0]


def load_signals(path: str | os.PathLike[str]) -> Signals:
    """Read the names, units and inertia noted beside a filter; an empty Signals where the file has none.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    Signals

    Raises
    ------
    OSError, ValueError
        As for :func:`load`; the whole file is checked.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from phyfilter_ctl import PhyFilter
    >>> from phyfilter_ctl.filterfile import Signals, load_signals, save
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "filter.toml"
    ...     save(path, PhyFilter([20.0]), signals=Signals(["vx", "vy"], unit_x="m/s"))
    ...     load_signals(path).channels
    ('vx', 'vy')
    """
    return _read(Path(path))[1]


def settled_inertia(
    filter: object, inertia: ArrayLike | InertiaInput | None, signals: Signals
) -> ArrayLike | InertiaInput | None:
    """The inertia that counts: what a call is given, else what comes with every sample, else what is noted.

    Parameters
    ----------
    filter : PhyFilter, FilterBank, SampledPhyFilter or sequence of PhyFilter
    inertia : float, (n_x,) or (n_x, n_x) array, {"scalar", "diagonal", "full"}, optional
    signals : Signals
        As :func:`settled_signals` gives them.
    """
    if inertia is not None or signals.inertia is not None or not isinstance(filter, SampledPhyFilter):
        return signals.inertia if inertia is None else inertia
    return filter.sampling.inertia


def settled_signals(filter: object, signals: Signals | None) -> Signals:
    """Names, units and inertia that count: what a sampled filter has in its Sampling, and what is noted beside it.

    Parameters
    ----------
    filter : PhyFilter, FilterBank, SampledPhyFilter or sequence of PhyFilter
    signals : Signals, optional

    Returns
    -------
    Signals
        Without the inertia where that comes with every sample.

    Raises
    ------
    ValueError
        If the two contradict each other.

    Examples
    --------
    >>> sampled = PhyFilter([20.0]).sampled(0.01, inertia=5.0, units={"x": "m/s"})
    >>> settled_signals(sampled, Signals(["u", "v"])).inertia
    5.0
    >>> settled_signals(sampled, Signals(inertia=2.0))
    Traceback (most recent call last):
        ...
    ValueError: inertia: the filter has 5.0, its signals have 2.0; say it once
    """
    noted = Signals() if signals is None else signals
    if not isinstance(filter, SampledPhyFilter):
        return noted
    sampling = filter.sampling
    constant = None if isinstance(sampling.inertia, str) else sampling.inertia
    own = Signals(
        sampling.names, **{f"unit_{key}": unit for key, unit in sampling.units.items()}, inertia=constant
    )
    found = dict(vars(noted))
    for key, mine in vars(own).items():
        if mine in _NOTHING:
            continue
        if found[key] not in (*_NOTHING, mine):
            raise ValueError(f"{key}: the filter has {mine}, its signals have {found[key]}; say it once")
        found[key] = mine
    if found["channels"]:
        sampling.check_channels(len(found["channels"]))
    return Signals(**found)


# -- writing ----------------------------------------------------------------------------------------------------


def _filters(filter: Filter) -> tuple[PhyFilter, ...]:
    if isinstance(filter, PhyFilter):
        return (filter,)
    return filter.filters if isinstance(filter, SampledPhyFilter) else filter


def _text(filter: Filter, signals: Signals) -> str:
    head = {"format": FORMAT, "version": VERSION}
    filters = _filters(filter)
    if len(filters) == 1 and not isinstance(filter, FilterBank):
        blocks = [_title(filters[0]) + _lines(head | _coefficients(filters[0]))]
    else:
        blocks = [f"# PhyFilter, one for each of {len(filters)} channels\n" + _lines(head)]
        blocks += [f"{_title(entry)}[[filters]]\n{_lines(_coefficients(entry))}" for entry in filters]
    if isinstance(filter, SampledPhyFilter):
        blocks.append("[sampled]\n" + _lines(_options(filter)))
    if noted := _noted(filter, signals):
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
    unusual = {key: value for key, value in sampling.unusual.items() if key not in _SIGNAL_KEYS}
    return table | unusual | ({} if sampled.E is None else {"E": sampled.E.tolist()})


def _noted(filter: Filter, signals: Signals) -> dict[str, object]:
    sampling = filter.sampling if isinstance(filter, SampledPhyFilter) else None
    table: dict[str, object] = {}
    if signals.channels:
        table["channels"] = list(signals.channels)
    elif sampling is not None and sampling.channels is not None:
        table["channels"] = sampling.n_x
    units = {key: unit for key in _UNIT_KEYS if (unit := getattr(signals, f"unit_{key}"))}
    if units:
        table["units"] = units
    if signals.inertia is not None:
        table["inertia"] = signals.inertia
    elif sampling is not None and isinstance(sampling.inertia, str):
        table["inertia"] = sampling.inertia
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


def _read(path: Path) -> tuple[Filter, Signals]:
    top = TomlTable(path, "", parsed(path))
    top.refuse_other_formats(FORMAT, VERSION, "filter")
    top.refuse_unknown(_TOP_KEYS)
    filters = _read_filters(top)
    if "sampled" in top:
        filter: Filter = _read_sampled(top.table("sampled"), filters)
    else:
        filter = FilterBank(filters) if "filters" in top else filters[0]
    signals = Signals()
    if "signals" in top:
        table = top.table("signals")
        sampled = filter if isinstance(filter, SampledPhyFilter) else None
        options: SamplingOptions = {} if sampled is None else _read_options(table)
        signals = _read_signals(table, *options)
        try:
            _refuse_disagreement(filter, signals)
            if sampled is not None:
                filter = replace(sampled, sampling=_with_signals(sampled.sampling, options, signals))
        except ValueError as error:
            raise top.error("signals", str(error)) from error
    return filter, signals


def _with_signals(sampling: Sampling, options: SamplingOptions, signals: Signals) -> Sampling:
    units = {key: unit for key in _UNIT_KEYS if (unit := getattr(signals, f"unit_{key}"))}
    noted: SamplingOptions = {
        "channels": signals.channels or None,
        "inertia": signals.inertia,
        "units": units,
    }
    return replace(sampling, **(noted | options))


def _read_options(table: TomlTable) -> SamplingOptions:
    """What only a sampled filter's signals may say: a number of channels, a kind of inertia."""
    options: SamplingOptions = {}
    if isinstance(table.values.get("channels"), int):
        options["channels"] = table.integer("channels")
    if isinstance(table.values.get("inertia"), str):
        options["inertia"] = table.text("inertia")
    return options


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


def _read_signals(table: TomlTable, *known: str) -> Signals:
    """The table as Signals, but for keys that are known already."""
    table.refuse_unknown(_SIGNAL_KEYS)
    units: dict[str, str] = {}
    if "units" in table:
        inner = table.table("units")
        inner.refuse_unknown(_UNIT_KEYS)
        units = {f"unit_{key}": inner.text(key) for key in _UNIT_KEYS if key in inner}
    channels = table.texts("channels") if "channels" in table and "channels" not in known else ()
    inertia = None
    if "inertia" in table and "inertia" not in known:
        inertia = table.numbers_of_any_shape("inertia")
    try:
        return Signals(channels, **units, inertia=inertia)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{table.file}: [signals] {error}") from error


# -- checks -----------------------------------------------------------------------------------------------------


def _refuse_many(orders: Sequence[int], error: Callable[[str], ValueError] = ValueError) -> None:
    if sum(orders) > _MOST_POLES:
        raise error(
            f"expected filters of at most {_MOST_POLES} poles together, got {len(orders)} filters of {sum(orders)}; "
            "one filter may serve all channels"
        )


def _inertia(values: ArrayLike, channels: int) -> Inertia:
    array = _signals.inertia(
        "inertia", values, channels or max(1, np.shape(values)[0] if np.ndim(values) else 1)
    )
    if array.ndim == 2:
        return tuple(tuple(row) for row in array.tolist())
    return tuple(array.tolist()) if array.ndim else float(array)


def _refuse_disagreement(filter: Filter, signals: Signals) -> None:
    """Raise where the filter and the signals have another number of channels."""
    filters = _filters(filter)
    if isinstance(filter, SampledPhyFilter) and filter.E is not None:
        n_x, reason = len(filter.E), "E has as many rows"
    elif len(filters) > 1 or isinstance(filter, FilterBank):
        n_x, reason = len(filters), "there are as many filters"
    else:
        return
    if signals.channels and len(signals.channels) != n_x:
        raise ValueError(f"channels: expected {n_x} names ({reason}), got {len(signals.channels)}")
    if isinstance(signals.inertia, tuple) and len(signals.inertia) != n_x:
        raise ValueError(f"inertia: expected size {n_x} ({reason}), got {len(signals.inertia)}")
