"""How a filter is sampled: what records, loops, blocks, files and C code need to know besides its coefficients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Literal, TypedDict, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from .._choices import Method
from .._sections import FloatArray
from .._signals import LARGEST, array, channel_names, count, duration, interval, number, real
from .._signals import inertia as signal_inertia

__all__ = ["InertiaInput", "Method", "NonFinite", "Precision", "Rule", "Sampling", "SamplingOptions"]

Rule = Literal["hold", "average"]
Precision = Literal["float64", "float32"]
NonFinite = Literal["raise", "hold"]
InertiaInput = Literal["scalar", "diagonal", "full"]

_SIGNALS = ("x", "g", "f")  # that have units
_CHOICES = {"method": Method, "g": Rule, "f_theta": Rule, "precision": Precision, "nonfinite": NonFinite}


class ChannelOptions(TypedDict, total=False):
    """What :class:`Sampling` knows of the channels."""

    channels: int | Sequence[str] | None
    inertia: ArrayLike | InertiaInput | None
    units: Mapping[str, str] | None


class SamplingOptions(ChannelOptions, total=False):
    """Options of :class:`Sampling` that are given by name."""

    precision: Precision
    delay: float
    limit: ArrayLike | None
    g_limit: tuple[ArrayLike, ArrayLike] | ArrayLike | None
    nonfinite: NonFinite
    E: ArrayLike | None


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Sampling:
    """How a filter is sampled.

    Parameters
    ----------
    dt : float, optional
        Nominal sampling interval h in seconds; a timedelta64 has its unit with it. Everything that runs a filter needs
        it; :func:`~phyfilter_ctl.learn` alone takes that of the recordings where it is left out.
    method : {"exact", "matched", "euler", "tustin"}
        "exact": zero-order hold of the step-averaged residual, exact for x linear between samples. "matched": exact
        sampling with a numerator that keeps the zeros of 1 - F, its type and those at +-j w, at the samples
        (``filter/matching.py``). "euler": forward Euler, as in the paper; refused where it diverges, |1 + p h| >= 1.
        "tustin": the trapezoidal rule.
    g, f_theta : {"hold", "average"}
        What the signal does between samples: "hold" (a command held by an actuator) or "average" (a smooth signal
        known at both ends of the step). With ``g="hold"``, ``run``, blocks and FMUs take the g that acts from this
        sample on; ``step``, ``live.step`` and C take the g that acted since the last sample. With ``g="average"`` all
        take g at this sample.
    precision : {"float64", "float32"}
        Arithmetic of ``step``. In float32 every state carries a compensation word, so that nothing is lost over
        days; ``run`` rounds inputs, coefficients and outputs alike and carries the states in double.
    delay : float
        Known delay of the measurement x in seconds; g, f_theta and the inertia are delayed alike inside F.
    limit : float or array_like, shape (n_f,), optional
        Bound on |f_hat|. It clamps the output, never the state, so nothing winds up.
    g_limit : pair (low, high) of floats or array_likes, shape (n_x,), optional
        Between which g acts: each g is clipped there, entry by entry, before it counts. So the filter knows what a
        saturated actuator leaves of a command, and does not take the rest for a force (``docs/saturation.md``). For
        limits of something else than g, such as torques or rotors, give the g that the limited command makes.
    nonfinite : {"raise", "hold"}
        What a sample does that is NaN, infinite, masked or beyond 1e150. It never enters the state: "raise" refuses
        it, "hold" keeps the estimate of the residual, f_hat - f_theta, for that sample and for as long as none is
        good (f_theta, where it is bad too, is its last good value), says so, and takes the gap as one longer step.
        After more than 20 nominal steps without a good sample, times that jump included, there is no such step under
        either: the filter goes on from the next good sample (``docs/loops.md``).
    channels : int or sequence of str, optional
        Number n_x of channels of x, or their names. None: as many as the signals have.
    inertia : float, (n_x,) or (n_x, n_x) array, or {"scalar", "diagonal", "full"}, optional
        Model M_hat of the inertia, where it is constant; or which kind of it comes with every sample. Records, loops,
        blocks, files, FMUs and C code take it from here; what a call is given, and a recording's own, goes before.
        None means I.
    units : mapping of str to str, optional
        Units of "x", of "g" (and of M x') and of "f" (f_theta and f_hat too). They label files, FMUs and C code; no
        number is converted.
    E : array_like, shape (n_x, n_f), optional
        Known direction in which f acts, M x' = g + E f, of full column rank. f_theta and f_hat then have n_f channels.

    Raises
    ------
    TypeError
        For names and units that are no text.
    ValueError
        For options out of range, a low that is not below its high, an inertia of another size than the channels, E
        without full column rank; and where ``dt`` is asked for and was left out.

    Examples
    --------
    >>> Sampling(0.002, g="average", limit=2.0)
    Sampling(0.002, g='average', limit=2.0)
    >>> Sampling(0.002) == Sampling(2e-3, delay=0.0)
    True
    >>> Sampling(0.01, channels=["vx", "vy"], inertia=1.2, units={"x": "m/s", "f": "N"}).n_x
    2
    """

    dt: float
    method: Method
    g: Rule
    f_theta: Rule
    precision: Precision
    delay: float
    limit: FloatArray | None
    g_limit: FloatArray | None
    nonfinite: NonFinite
    channels: int | tuple[str, ...] | None
    inertia: FloatArray | InertiaInput | None
    units: Mapping[str, str]
    E: FloatArray | None

    def __init__(
        self,
        dt: float | None = None,
        method: Method = "exact",
        g: Rule = "hold",
        f_theta: Rule = "average",
        *,
        precision: Precision = "float64",
        delay: float = 0.0,
        limit: ArrayLike | None = None,
        g_limit: tuple[ArrayLike, ArrayLike] | ArrayLike | None = None,
        nonfinite: NonFinite = "raise",
        channels: int | Sequence[str] | None = None,
        inertia: ArrayLike | InertiaInput | None = None,
        units: Mapping[str, str] | None = None,
        E: ArrayLike | None = None,
    ) -> None:
        dt = None if dt is None else duration("dt", dt)
        delay = number("delay", interval("delay", delay), "s", least=0.0)
        if dt is not None and not 1.0 / LARGEST < dt < LARGEST:
            raise ValueError(f"dt: expected a positive sampling interval in seconds, got {dt}")
        if delay >= LARGEST:
            raise ValueError(f"delay: expected less than {LARGEST:g} s, got {delay}")
        bound = None if limit is None else _bound(limit)
        ends = None if g_limit is None else _ends(g_limit)
        if channels is not None:
            named = not isinstance(channels, int | np.integer)
            channels = (
                channel_names(channels, len(channels)) or None if named else count("channels", channels)
            )
        M = None if inertia is None else _inertia(inertia, _number(channels))
        values = (
            dt,
            method,
            g,
            f_theta,
            precision,
            delay,
            bound,
            ends,
            nonfinite,
            channels,
            M,
            _units(units),
            None if E is None else _direction(E),
        )
        for entry, value in zip(fields(self), values, strict=True):
            if value is not None or entry.name != "dt":
                object.__setattr__(self, entry.name, value)
        for name, choices in _CHOICES.items():
            if (value := getattr(self, name)) not in get_args(choices):
                raise ValueError(f"{name}: expected one of {', '.join(get_args(choices))}, got {value!r}")

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> object:
            """What it has not: dt, where it was left out."""
            if name == "dt":
                raise ValueError(
                    "dt: expected the sampling interval in s, which learn alone takes from its recordings; give it, as "
                    "Sampling(0.01, ...)"
                )
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    @property
    def has_dt(self) -> bool:
        """Whether dt was given."""
        return "dt" in vars(self)

    @property
    def delay_steps(self) -> float:
        """The delay in nominal steps."""
        return self.delay / self.dt

    @property
    def n_x(self) -> int | None:
        """Number of channels of x, as ``channels`` or the size of the inertia tell it."""
        of_inertia = (
            self.inertia.shape[0] if isinstance(self.inertia, np.ndarray) and self.inertia.ndim else None
        )
        return _number(self.channels) or of_inertia

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels of x; empty where there are none."""
        return self.channels if isinstance(self.channels, tuple) else ()

    def inertia_or(self, given: ArrayLike | None) -> ArrayLike | None:
        """The inertia that counts: what a call is given, else the constant one from here, else None for I.

        Raises
        ------
        ValueError
            If none is given where one comes with every sample.
        """
        if given is not None or not isinstance(self.inertia, str):
            return self.inertia if given is None else given
        raise ValueError(
            f"inertia: expected M_hat, which the filter takes with every sample (inertia={self.inertia!r}), got none; "
            "give it, or sample the filter with a constant one"
        )

    def told(
        self,
        *,
        channels: int | Sequence[str] | None = None,
        inertia: ArrayLike | InertiaInput | None = None,
        units: Mapping[str, str] | None = None,
    ) -> Sampling:
        """These options with what a call says besides: its inertia counts, names and units must not contradict these.

        Parameters
        ----------
        channels, inertia, units
            As for :class:`Sampling`; None says nothing.

        Raises
        ------
        ValueError
            If numbers of channels, names or units contradict each other.

        Examples
        --------
        >>> Sampling(0.01, inertia=5.0).told(channels=["u", "v"], units={"x": "m/s"})
        Sampling(0.01, channels=('u', 'v'), inertia=5.0, units={'x': 'm/s'})
        """
        if channels is not None:
            said = Sampling(channels=channels)
            if self.names and said.names and said.names != self.names:
                raise ValueError(
                    f"channels: the filter has {', '.join(self.names)}, got {', '.join(said.names)}; say it once"
                )
            self.channels_or(said.n_x)
            channels = self.names or said.names or said.n_x
        wanted = _units(units)
        for signal, unit in wanted.items():
            if (mine := self.units.get(signal, unit)) != unit:
                raise ValueError(f"units: the filter has {mine!r} of {signal}, got {unit!r}; say it once")
        return self._but(
            channels=self.channels if channels is None else channels,
            inertia=self.inertia if inertia is None else inertia,
            units={**self.units, **wanted},
        )

    def channels_or(self, given: int | None) -> int | None:
        """The number of channels that counts: what a call is given, else the one known here.

        Raises
        ------
        ValueError
            If the two contradict each other.
        """
        if given is not None and self.n_x not in (None, given):
            raise ValueError(
                f"channels: the filter is for {self.n_x} ({self._why_n_x}), got {given}; leave channels out"
            )
        return self.n_x if given is None else given

    @property
    def _why_n_x(self) -> str:
        if self.names:
            return ", ".join(self.names)
        return "channels" if self.channels is not None else "the size of its inertia"

    def check_channels(self, n_x: int) -> None:
        """Raise where x has another number of channels than is known here.

        Parameters
        ----------
        n_x : int

        Raises
        ------
        ValueError
        """
        if self.n_x not in (None, n_x):
            raise ValueError(f"x has {n_x} channels but the filter is for {self.n_x} ({self._why_n_x})")

    def alone(self, i: int) -> Sampling:
        """The options of one channel by itself, where channels do not share a direction E.

        Of a full inertia it has the entry on the diagonal: what couples channels is in none of them alone.

        Parameters
        ----------
        i : int
        """
        limit, ends, M = self.limit, self.g_limit, self.inertia
        if isinstance(M, np.ndarray) and M.ndim:
            M = M[i] if M.ndim == 1 else M[i, i]
        return self._but(
            limit=limit[i] if limit is not None and limit.ndim else limit,
            g_limit=ends[:, i] if ends is not None and ends.ndim > 1 else ends,
            channels=(self.names[i],) if self.names else None if self.channels is None else 1,
            inertia=M,
        )

    def _but(self, **changed: Any) -> Sampling:
        """As ``dataclasses.replace``, for one without dt too."""
        return Sampling(**(vars(self) | changed))

    def differences(self, other: Sampling) -> dict[str, object]:
        """Options that differ from those of another, with their values here.

        Parameters
        ----------
        other : Sampling

        Examples
        --------
        >>> Sampling(0.002, limit=[1.0, 2.0]).differences(Sampling(0.002))
        {'limit': [1.0, 2.0]}
        """
        mine, theirs = (
            {e.name: _plain(vars(one).get(e.name)) for e in fields(self)} for one in (self, other)
        )
        return {name: value for name, value in mine.items() if value != theirs[name]}

    @property
    def unusual(self) -> dict[str, object]:
        """Options, besides dt, that are not the default ones."""
        return self.differences(Sampling(vars(self).get("dt")))

    def __eq__(self, other: object) -> bool:
        return not self.differences(other) if isinstance(other, Sampling) else NotImplemented

    def __hash__(self) -> int:
        return hash((vars(self).get("dt"), self.method, self.g, self.f_theta, self.precision, self.delay))

    def __repr__(self) -> str:
        given = [f"{self.dt:g}"] if self.has_dt else []
        return f"Sampling({', '.join([*given, *(f'{k}={v!r}' for k, v in self.unusual.items())])})"


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _number(channels: int | tuple[str, ...] | None) -> int | None:
    return len(channels) if isinstance(channels, tuple) else channels


def _inertia(given: ArrayLike | InertiaInput, n_x: int | None) -> FloatArray | InertiaInput:
    """M_hat, () or (n_x,) or (n_x, n_x), read-only; or the kind that is an input."""
    if isinstance(given, str):
        if given not in get_args(InertiaInput):
            raise ValueError(
                f"inertia: expected one of {', '.join(get_args(InertiaInput))} or numbers, got {given!r}"
            )
        return cast(InertiaInput, given)
    M = real("inertia", given)
    M = signal_inertia("inertia", M, n_x or (len(M) if M.ndim and len(M) else 1))
    M.flags.writeable = False
    return M


def _direction(E: ArrayLike) -> FloatArray:
    """E (n_x, n_f) of full column rank, read-only."""
    matrix = array("E", E, ("n_x", "n_f"))
    rank = int(np.linalg.matrix_rank(matrix))
    if rank < matrix.shape[1]:
        raise ValueError(
            f"E has rank {rank} for {matrix.shape[1]} columns: expected full column rank, else f cannot be told from "
            "the measurement; drop dependent columns"
        )
    matrix.flags.writeable = False
    return matrix


def _units(units: Mapping[str, str] | None) -> Mapping[str, str]:
    """Units by signal, none of them empty, always in one order."""
    given = {} if units is None else dict(units)
    if unknown := set(given) - set(_SIGNALS):
        raise ValueError(f"units: expected units of {', '.join(_SIGNALS)}, got one of {sorted(unknown)[0]!r}")
    for name, unit in given.items():
        if not isinstance(unit, str):
            raise TypeError(f"units: expected text for {name}, got {unit!r}")
    return {name: given[name] for name in _SIGNALS if given.get(name)}


def _bound(limit: ArrayLike) -> FloatArray:
    """Bounds on |f_hat|, () or (n_f,), read-only."""
    bound = real("limit", limit)
    if bound.ndim > 1 or not np.all(bound > 0.0):
        raise ValueError(
            f"limit: expected a positive bound on |f_hat|, one number or one per channel, got {limit!r}"
        )
    bound.flags.writeable = False
    return bound


def _ends(g_limit: tuple[ArrayLike, ArrayLike] | ArrayLike) -> FloatArray:
    """Ends of what g may be, (2,) or (2, n_x), read-only."""
    try:
        first, last = g_limit  # pyright: ignore[reportGeneralTypeIssues]  # one number is not iterable
    except (TypeError, ValueError):
        raise ValueError(
            f"g_limit: expected a pair (low, high), each one number or one per channel, got {g_limit!r}"
        ) from None
    low, high = real("g_limit, low", first), real("g_limit, high", last)
    if max(low.ndim, high.ndim) > 1 or (low.size != high.size and 1 not in (low.size, high.size)):
        raise ValueError(
            f"g_limit: expected low and high of one size, got shapes {low.shape} and {high.shape}"
        )
    if not np.all(low < high):
        raise ValueError(f"g_limit: expected low < high, got {low.tolist()} and {high.tolist()}")
    ends = np.stack(np.broadcast_arrays(low, high))
    ends.flags.writeable = False
    return ends
