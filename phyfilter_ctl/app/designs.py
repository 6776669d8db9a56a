"""The design that a message carries: poles, a numerator, a sampling and what is assumed; from and to JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, cast, get_args

import numpy as np

from .. import _sections
from .._sections import FloatArray
from ..analysis import frequency_response
from ..design.placement import Family, bandpass, lowpass, place_poles
from ..filter import FilterBank, PhyFilter, SampledPhyFilter, Sampling
from ..filter.sampling import InertiaInput, Method, SamplingOptions
from ..results import plain
from .checking import Fields, MessageError, real, shown

__all__ = [
    "FAMILIES",
    "Assumptions",
    "Design",
    "Numerator",
    "Signals",
    "design_of_family",
    "read_design",
    "read_designs",
]

HIGHEST_ORDER = 8
SLOWEST, FASTEST = 1e-3, 1e5  # |p| in rad/s
_ROUNDED = 1e-12  # a pole of a family at the edge, its magnitude rounded another way
SHORTEST_STEP, LONGEST_STEP = 1e-5, 1.0  # s
LARGEST_COEFFICIENT = 1e60
_LARGEST_ZERO = 1e7  # rad/s
_MOST_LIMITS = 64  # entries in the drawn limits, all levels together
_LIMIT_DEPTH = 4
_LARGEST_ASSUMED = 1e12
MOST_CHANNELS = 12
_SIGNALS = ("channels", "inertia", "units")

# "damped": complex pairs of one damping ratio and one natural frequency. The rest are those of the library.
FAMILIES: tuple[str, ...] = (*get_args(Family), "damped", "bandpass")


@dataclass(frozen=True)
class Numerator:
    """How N is chosen.

    Parameters
    ----------
    kind : {"lowpass", "type", "zeros", "b"}
        N = a_0; b_i = a_i for i < type and 0 beyond; N = gain * prod (s - zero); the coefficients.
    type : int
    zeros : tuple of complex
        In rad/s, in conjugate pairs.
    gain : float
        Leading coefficient of N.
    b : tuple of float
        Ascending.
    """

    kind: Literal["lowpass", "type", "zeros", "b"] = "lowpass"
    type: int = 1
    zeros: tuple[complex, ...] = ()
    gain: float = 1.0
    b: tuple[float, ...] = ()

    def as_json(self) -> dict[str, object]:
        """As a message has it."""
        if self.kind == "type":
            return {"kind": "type", "type": self.type}
        if self.kind == "zeros":
            return {"kind": "zeros", "zeros": plain(self.zeros), "gain": self.gain}
        return {"kind": "b", "b": list(self.b)} if self.kind == "b" else {"kind": "lowpass"}


@dataclass(frozen=True)
class Assumptions:
    """What the figures are computed for.

    Parameters
    ----------
    slope : float
        Bound of the residual's derivative.
    noise : float
        Standard deviation of the noise of x, per sample.
    ratio : float
        M_hat / M.
    lag, delay : float
        Of the actuator, in s.
    unit : str
        Unit of f.
    ratio_spread : float
        The true M_hat / M lies between ratio/(1 + ratio_spread) and ratio (1 + ratio_spread).
    lag_spread, delay_spread : float
        The true lag and delay lie within as many s of those assumed, and are not negative.
    """

    slope: float = 1.0
    noise: float = 1e-3
    ratio: float = 1.0
    lag: float = 0.02
    delay: float = 0.0
    unit: str = ""
    ratio_spread: float = 0.0
    lag_spread: float = 0.0
    delay_spread: float = 0.0

    def as_json(self) -> dict[str, object]:
        """As a message has it."""
        return dict(vars(self))


@dataclass(frozen=True)
class Signals:
    """What a file, or an open log, says of the signals: it goes with what is saved and exported.

    Parameters
    ----------
    options : SamplingOptions
        channels, inertia and units, as JSON holds them; those that are known.
    E : list of list of float, optional
        Direction in which f acts.
    """

    options: SamplingOptions = field(default_factory=SamplingOptions)
    E: list[list[float]] | None = None

    @classmethod
    def of(cls, filter: SampledPhyFilter) -> Signals:
        """Those of a filter.

        Parameters
        ----------
        filter : SampledPhyFilter
        """
        kept = {key: plain(value) for key, value in filter.sampling.unusual.items() if key in _SIGNALS}
        return cls(cast(SamplingOptions, kept), None if filter.E is None else filter.E.tolist())

    def as_json(self) -> dict[str, object]:
        """As a message has it."""
        return {**self.options} | ({} if self.E is None else {"E": self.E})


@dataclass(frozen=True, eq=False)
class Design:
    """A filter being designed.

    Parameters
    ----------
    poles : tuple of complex
        In rad/s.
    numerator : Numerator
    dt : float
        Sampling interval in s.
    method : {"matched", "exact", "euler", "tustin"}
        "matched" is what the library takes by itself: the exact method where matched sampling has nothing to keep, or
        cannot.
    assume : Assumptions
    limits : mapping or None
        Limits that are drawn; kept as they came.
    signals : Signals
        Channels, inertia, units and E, for what is saved and exported; figures are of one channel per unit of inertia.
    """

    poles: tuple[complex, ...] = (-20.0 + 0.0j, -20.0 + 0.0j)
    numerator: Numerator = field(default_factory=Numerator)
    dt: float = 0.002
    method: Method = "matched"
    assume: Assumptions = field(default_factory=Assumptions)
    limits: Mapping[str, object] | None = None
    signals: Signals = field(default_factory=Signals)

    def with_filter(self, filter: PhyFilter | FilterBank | SampledPhyFilter) -> Design:
        """The same sampling and assumptions around another filter.

        Parameters
        ----------
        filter : PhyFilter or SampledPhyFilter (a bank is refused)
            Sampled: one filter for all channels; its step, method and signals are taken over.

        Raises
        ------
        ValueError
            If it is of another size than a designer shows.
        """
        filters = filter.filters if isinstance(filter, SampledPhyFilter) else filter
        if not isinstance(filters, PhyFilter) and len(filters) > 1:
            raise ValueError(
                f"expected one filter, got {len(filters)}, one for each channel: show them one by one"
            )
        if isinstance(filter, FilterBank):
            return self.with_filter(filter[0])
        if isinstance(filter, SampledPhyFilter):
            if not SHORTEST_STEP <= filter.dt <= LONGEST_STEP:
                raise ValueError(
                    f"dt: expected {SHORTEST_STEP:g} to {LONGEST_STEP:g} s, got {filter.dt:g} s; sample it "
                    "otherwise"
                )
            usual = filter.sampling.method == filter.filter.sampled(filter.dt).sampling.method
            method = "matched" if usual else filter.sampling.method
            design = replace(self, dt=filter.dt, method=method, signals=Signals.of(filter))
            return design.with_filter(filter.filter)
        size = np.abs(filter.poles)
        if filter.order > HIGHEST_ORDER or size.min() < SLOWEST or size.max() > FASTEST:
            raise ValueError(
                f"poles: expected 1 to {HIGHEST_ORDER} poles of {SLOWEST:g} to {FASTEST:g} rad/s, got "
                f"{filter.order} of {size.min():.3g} to {size.max():.3g} rad/s"
            )
        return replace(self, poles=tuple(filter.poles.tolist()), numerator=_numerator_of(filter))

    @cached_property
    def filter(self) -> PhyFilter:
        """F."""
        if self.numerator.kind == "lowpass":
            return PhyFilter.from_poles(self.poles)
        if self.numerator.kind == "type":
            return place_poles(self.poles, type=self.numerator.type)
        return PhyFilter.from_poles(self.poles, self._b)

    @property
    def _b(self) -> FloatArray:
        if self.numerator.kind == "b":
            return np.array(self.numerator.b)
        b = np.zeros(len(self.poles))
        zeros = np.array(self.numerator.zeros, dtype=np.complex128)
        monic = np.append(_sections.polynomial_from_roots(_paired(zeros)), 1.0)
        b[: len(monic)] = self.numerator.gain * monic
        return b

    @property
    def sampled(self) -> SampledPhyFilter:
        """F as it runs.

        Raises
        ------
        ValueError
            If forward Euler diverges.
        """
        return self.sampled_at(self.dt)

    def sampled_at(self, dt: float) -> SampledPhyFilter:
        """F as it runs at another step ``dt`` in s; raises as ``sampled``."""
        return self.filter.sampled(dt, None if self.method == "matched" else self.method)

    @property
    def handed_over(self) -> SampledPhyFilter:
        """F as it is saved and exported: with its channels, inertia, units and E; raises as ``sampled``."""
        sampled = self.sampled
        sampling = replace(sampled.sampling, **self.signals.options)
        return SampledPhyFilter(sampled.filters, sampling, E=self.signals.E)

    @property
    def unmatched(self) -> str:
        """Why the exact method stands for the matched one; empty where it does not have to."""
        if self.method != "matched":
            return ""
        try:
            self.filter.sampled(self.dt, "matched")
        except ValueError as error:
            return str(error).removeprefix("method='matched': ").removesuffix(", or use method='exact'")
        return ""

    @property
    def euler_dt(self) -> float:
        """The step in s at which forward Euler loses stability."""
        poles = self.filter.poles
        return float(np.min(-2.0 * poles.real / np.abs(poles) ** 2))

    def as_json(self) -> dict[str, object]:
        """As a message has it."""
        return {
            "poles": plain(self.poles),
            "numerator": self.numerator.as_json(),
            "sampling": {"dt": self.dt, "method": self.method, **self.signals.as_json()},
            "assume": self.assume.as_json(),
            "limits": self.limits,
        }


def read_design(message: Fields) -> Design:
    """The design of a message, checked: its filter can be built.

    Parameters
    ----------
    message : Fields
        With a field "design".

    Raises
    ------
    MessageError
        Naming the field.
    """
    fields = message.fields("design")
    fields.only("poles", "numerator", "sampling", "assume", "limits")
    poles = fields.points("poles", 1, HIGHEST_ORDER, size=FASTEST)
    _check_poles(fields, poles)
    sampling = fields.fields("sampling")
    sampling.only("dt", "method", *_SIGNALS, "E")
    method = sampling.choice("method", get_args(Method)) if "method" in sampling else "matched"
    design = Design(
        tuple(poles),
        _numerator(fields.fields("numerator"), len(poles)) if "numerator" in fields else Numerator(),
        sampling.number("dt", SHORTEST_STEP, LONGEST_STEP, unit="s"),
        cast(Method, method),
        _assumptions(fields.fields("assume")) if "assume" in fields else Assumptions(),
        _limits(fields) if "limits" in fields else None,
        _signals(sampling),
    )
    try:
        _ = design.filter
    except ValueError as error:
        raise fields.error("poles", str(error)) from error
    try:
        one = Sampling(design.dt, **design.signals.options)
        _ = SampledPhyFilter(PhyFilter([1.0]), one, E=design.signals.E)
    except (TypeError, ValueError) as error:
        raise fields.error("sampling", str(error)) from error
    return design


def _signals(sampling: Fields) -> Signals:
    """Channels, inertia, units and E of a message; the library checks that they belong together."""
    options: SamplingOptions = {}
    if "channels" in sampling:
        named = isinstance(sampling.get("channels"), list)
        options["channels"] = (
            sampling.texts("channels", 1, MOST_CHANNELS)
            if named
            else sampling.integer("channels", 1, MOST_CHANNELS)
        )
    if "inertia" in sampling:
        value = sampling.get("inertia")
        if isinstance(value, str):
            options["inertia"] = sampling.choice("inertia", get_args(InertiaInput))
        elif isinstance(value, list):
            rows = bool(value) and isinstance(value[0], list)
            options["inertia"] = (
                _matrix(sampling, "inertia")
                if rows
                else sampling.numbers("inertia", 1, MOST_CHANNELS, size=_LARGEST_ASSUMED)
            )
        else:
            options["inertia"] = sampling.number("inertia", -_LARGEST_ASSUMED, _LARGEST_ASSUMED)
    if "units" in sampling:
        units = sampling.fields("units")
        units.only("x", "g", "f")
        options["units"] = {key: units.text(key) for key in ("x", "g", "f") if key in units}
    return Signals(options, _matrix(sampling, "E") if "E" in sampling else None)


def _matrix(fields: Fields, key: str) -> list[list[float]]:
    rows = fields.listed(key, 1, MOST_CHANNELS)
    inside = Fields({str(i): row for i, row in enumerate(rows)}, f"{fields.where}{key}.")
    return [inside.numbers(str(i), 1, MOST_CHANNELS, size=_LARGEST_ASSUMED) for i in range(len(rows))]


def read_designs(message: Fields, most: int) -> list[Design]:
    """The designs of a message's list "designs", each checked as :func:`read_design` does.

    Parameters
    ----------
    message : Fields
        With a field "designs".
    most : int
        How many there may be.

    Raises
    ------
    MessageError
        Naming the field.
    """
    entries = message.listed("designs", 1, most)
    return [
        read_design(Fields({"design": entry}, f"{message.where}designs[{i}]."))
        for i, entry in enumerate(entries)
    ]


def design_of_family(message: Fields, like: Design) -> Design:
    """The design of op "family": poles by a family and a cutoff, the rest of it as before.

    Parameters
    ----------
    message : Fields
        family, order, cutoff, and where they count: type, damping ("damped" alone), band (two edges: a band-pass, the
        family then its prototype; cutoff and type do not count).
    like : Design
        Gives sampling and assumptions.

    Raises
    ------
    MessageError, ValueError
        If a field is wrong or the family has no such filter.
    """
    family = message.choice("family", FAMILIES)
    order = message.integer("order", 1, HIGHEST_ORDER)
    if family == "bandpass" or "band" in message:
        if family == "damped":
            raise message.error("family", "a band-pass needs a prototype of another family; try butterworth")
        low, high = message.numbers("band", 2, 2, size=FASTEST)
        prototype = "butterworth" if family == "bandpass" else family
        return like.with_filter(bandpass(order, low, high, family=cast(Family, prototype)))
    cutoff = message.number("cutoff", SLOWEST, FASTEST, unit="rad/s")
    kind = message.integer("type", 1, order) if "type" in message else 1
    if family != "damped":
        return like.with_filter(lowpass(order, cutoff, family=cast(Family, family), type=kind))
    damping = message.number("damping", 0.01, 1.0) if "damping" in message else math.sqrt(0.5)
    pair = complex(-damping, math.sqrt(1.0 - damping**2))
    poles = [pair, pair.conjugate()] * (order // 2) + [-1.0 + 0.0j] * (order % 2)
    prototype = place_poles(poles, type=kind)
    return like.with_filter(prototype.faster(cutoff / frequency_response(prototype).band_edges[1]))


# -- reading ----------------------------------------------------------------------------------------------------


def _check_poles(fields: Fields, poles: list[complex]) -> None:
    for i, pole in enumerate(poles):
        if not pole.real < 0.0:
            raise fields.error(
                f"poles[{i}]",
                f"expected a real part below 0, got {pole:.6g}; move it into the left half plane",
            )
        if not SLOWEST * (1.0 - _ROUNDED) <= abs(pole) <= FASTEST * (1.0 + _ROUNDED):
            raise fields.error(
                f"poles[{i}]", f"expected a size of {SLOWEST:g} to {FASTEST:g} rad/s, got {abs(pole):.6g}"
            )


def _numerator(fields: Fields, order: int) -> Numerator:
    kind = fields.choice("kind", ("lowpass", "type", "zeros", "b"))
    if kind == "lowpass":
        fields.only("kind")
        return Numerator()
    if kind == "type":
        fields.only("kind", "type")
        return Numerator("type", type=fields.integer("type", 1, order))
    if kind == "b":
        fields.only("kind", "b")
        return Numerator("b", b=tuple(fields.numbers("b", order, order, size=LARGEST_COEFFICIENT)))
    fields.only("kind", "zeros", "gain")
    zeros = fields.points("zeros", 0, order - 1, size=_LARGEST_ZERO)
    gain = fields.number("gain", -LARGEST_COEFFICIENT, LARGEST_COEFFICIENT)
    try:
        _paired(np.array(zeros, dtype=np.complex128))
    except ValueError as error:
        raise fields.error("zeros", str(error).replace("pole", "zero")) from error
    return Numerator("zeros", zeros=tuple(zeros), gain=gain)


def _paired(zeros: np.ndarray) -> np.ndarray:
    return _sections.pair_conjugates(zeros) if len(zeros) else zeros


def _assumptions(fields: Fields) -> Assumptions:
    usual = Assumptions()
    ranges = {
        "slope": (0.0, _LARGEST_ASSUMED, ""),
        "noise": (0.0, _LARGEST_ASSUMED, ""),
        "ratio": (1e-3, 1e3, ""),
        "lag": (0.0, 10.0, "s"),
        "delay": (0.0, 10.0, "s"),
        "ratio_spread": (0.0, 1e3, ""),
        "lag_spread": (0.0, 10.0, "s"),
        "delay_spread": (0.0, 10.0, "s"),
    }
    fields.only(*ranges, "unit")
    given = {
        key: fields.number(key, low, high, unit=unit) if key in fields else float(getattr(usual, key))
        for key, (low, high, unit) in ranges.items()
    }
    return Assumptions(**given, unit=fields.text("unit") if "unit" in fields else "")


def _limits(fields: Fields) -> Mapping[str, object]:
    """The drawn limits: any small object of numbers, words and lists, kept for the front end."""
    left = _MOST_LIMITS

    def checked(value: object, where: str, depth: int) -> object:
        nonlocal left
        left -= 1
        if left < 0 or depth > _LIMIT_DEPTH:
            raise MessageError(where, f"expected at most {_MOST_LIMITS} entries in {_LIMIT_DEPTH} levels")
        if value is None or isinstance(value, bool):
            return value
        if isinstance(value, int | float):
            return real(value, -_LARGEST_ASSUMED, _LARGEST_ASSUMED, where)
        if isinstance(value, str):
            return Fields({"limits": value}, "design.").text("limits")
        if isinstance(value, list | tuple):
            return [checked(entry, f"{where}[{i}]", depth + 1) for i, entry in enumerate(value)]
        if isinstance(value, Mapping):
            if any(not isinstance(key, str) or len(key) > 40 for key in value):
                raise MessageError(where, "expected names of at most 40 characters")
            return {key: checked(entry, f"{where}.{key}", depth + 1) for key, entry in value.items()}
        raise MessageError(where, f"expected numbers, words and lists, got {shown(value)}")

    found = checked(fields.get("limits"), f"{fields.where}limits", 0)
    if not isinstance(found, dict):
        raise fields.error("limits", f"expected an object, got {shown(found)}")
    return found


def _numerator_of(filter: PhyFilter) -> Numerator:
    if filter.is_lowpass:
        return Numerator()
    kind = filter.type
    if kind > 0 and np.array_equal(filter.b, np.where(np.arange(filter.order) < kind, filter.a, 0.0)):
        return Numerator("type", type=kind)
    nonzero = np.flatnonzero(filter.b)
    if len(nonzero) == 1:  # a band-pass, N = gain s^m: its zeros can be seen and moved
        power = int(nonzero[0])
        return Numerator("zeros", zeros=(0j,) * power, gain=float(filter.b[power]))
    return Numerator("b", b=tuple(filter.b.tolist()))
