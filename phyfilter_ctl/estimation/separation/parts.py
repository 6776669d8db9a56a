"""What a residual may be made of: each part is declared by what tells it from the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import FloatArray
from ...filter.sampling import Rule
from ...recording import Recording

__all__ = [
    "AddedInertia",
    "ColouredForce",
    "ModelScale",
    "Part",
    "Payload",
    "Regressor",
    "SensorBias",
    "SteadyForce",
    "Terms",
]


@dataclass(frozen=True, eq=False)
class Terms:
    """A part as p random scalars c: dc = -rate c dt + noise of the density, from N(mean, sd^2).

    Attributes
    ----------
    labels : tuple of str
    mean, sd, rate, density : (p,) arrays
    parameter : bool
        Whether c is a parameter, whose prior deviation is how large it may be; else a random force.
    load : (n_x, p) array or None
        Force c acts with, less inertia; None where it is recorded sample by sample.
    inertia : (n_x, n_x) array or None
        What the one scalar of an inertia part adds to M.
    measured : (n_x, p) array
        What c adds to the measured x.
    """

    labels: tuple[str, ...]
    mean: FloatArray
    sd: FloatArray
    rate: FloatArray
    density: FloatArray
    parameter: bool
    load: FloatArray | None
    inertia: FloatArray | None
    measured: FloatArray


def _made(
    part: Part,
    labels: tuple[str, ...],
    n_x: int,
    *,
    mean: FloatArray | float = 0.0,
    sd: FloatArray,
    rate: float = 0.0,
    density: FloatArray | float = 0.0,
    parameter: bool = True,
    load: FloatArray | None,
    inertia: FloatArray | None = None,
    measured: FloatArray | None = None,
) -> Terms:
    p = len(labels)
    _signals.number(f"{part.name}: sd", float(np.min(sd)), above=0.0)
    first, noise = np.broadcast_to(mean, p).astype(float), np.broadcast_to(density, p).astype(float)
    B = np.zeros((n_x, p)) if measured is None else measured
    return Terms(labels, first, sd, np.full(p, float(rate)), noise, parameter, load, inertia, B)


def _each(name: str, values: ArrayLike, count: int) -> FloatArray:
    """One number for all, or one each."""
    given = np.asarray(values, dtype=float)
    return _signals.array(name, np.full(count, float(given)) if given.ndim == 0 else given, (count,))


def _drift(part: str, drift: float) -> float:
    return _signals.number(f"{part}: drift", drift, least=0.0) ** 2


def _channels(name: str, n_x: int) -> tuple[str, ...]:
    return (name,) if n_x == 1 else tuple(f"{name}[{i}]" for i in range(n_x))


@dataclass(frozen=True, eq=False)
class Payload:
    """An unknown mass dm that rides along: f = -dm (v' + gravity e).

    Parameters
    ----------
    sd : float
        How large it may be: prior standard deviation, kg.
    gravity : (n_x,) array_like
        g e, upwards, in m/s^2; zeros where weight is carried by something else.
    x_per_velocity : float
        1 where x is a velocity and M a mass; the nominal mass where x = m v and M = 1.
    mean : float
        Prior mean, kg.
    drift : float
        It may change by drift sqrt(t) in t seconds, kg/s^(1/2).
    name : str

    Examples
    --------
    >>> Payload(1.0).gravity
    (0.0, 0.0, 9.81)
    """

    sd: float
    gravity: ArrayLike = (0.0, 0.0, 9.81)
    x_per_velocity: float = 1.0
    mean: float = 0.0
    drift: float = 0.0
    name: str = "payload"

    def _terms(self, n_x: int) -> Terms:
        """For n_x channels."""
        scale = _signals.number(f"{self.name}: x_per_velocity", self.x_per_velocity, above=0.0)
        down = -_signals.array(f"{self.name}: gravity", self.gravity, (n_x,))
        return _made(
            self,
            (self.name,),
            n_x,
            mean=_signals.number(f"{self.name}: mean", self.mean),
            sd=_each(f"{self.name}: sd", self.sd, 1),
            density=_drift(self.name, self.drift),
            load=down[:, None],
            inertia=np.eye(n_x) / scale,
        )


@dataclass(frozen=True, eq=False)
class AddedInertia:
    """An unknown inertia theta J that moves along: f = -theta J x'.

    Parameters
    ----------
    J : float, (n_x,) or (n_x, n_x) array_like
        Its shape, proportional to M; a diagonal as (n_x,).
    sd : float
        Prior standard deviation of theta.
    mean, drift : float
        Prior mean; and theta may change by drift sqrt(t) in t seconds.
    name : str
    """

    J: ArrayLike
    sd: float
    mean: float = 0.0
    drift: float = 0.0
    name: str = "added_inertia"

    def _terms(self, n_x: int) -> Terms:
        """For n_x channels."""
        J = _signals.inertia(f"{self.name}: J", self.J, n_x)
        full = J if J.ndim == 2 else np.eye(n_x) * J
        return _made(
            self,
            (self.name,),
            n_x,
            mean=_signals.number(f"{self.name}: mean", self.mean),
            sd=_each(f"{self.name}: sd", self.sd, 1),
            density=_drift(self.name, self.drift),
            load=np.zeros((n_x, 1)),
            inertia=full,
        )


@dataclass(frozen=True, eq=False)
class Regressor:
    """A known course of unknown strength: f = Phi(t) theta.

    Drag: the columns -v, -\\|v\\| v. An actuator that lost a share of its gain: minus the force that was commanded.

    Parameters
    ----------
    values : (N, n_x) or (N, n_x, p) array_like
        Phi at the samples of the recording.
    sd : float or (p,) array_like
        How large theta may be: prior standard deviation.
    mean : float or (p,) array_like
        Prior mean.
    drift : float
        theta may change by drift sqrt(t) in t seconds.
    between : {"average", "hold"}
        Between samples: a smooth signal, or a command that is held.
    name : str
    """

    values: ArrayLike
    sd: ArrayLike
    mean: ArrayLike = 0.0
    drift: float = 0.0
    between: Rule = "average"
    name: str = "regressor"

    def _terms(self, n_x: int) -> Terms:
        """For n_x channels."""
        if self.between not in ("average", "hold"):
            raise ValueError(f"{self.name}: between: expected 'average' or 'hold', got {self.between!r}")
        p = self._columns(n_x).shape[2]
        return _made(
            self,
            _channels(self.name, p),
            n_x,
            mean=_each(f"{self.name}: mean", self.mean, p),
            sd=_each(f"{self.name}: sd", self.sd, p),
            density=_drift(self.name, self.drift),
            load=None,
        )

    def _columns(self, n_x: int) -> FloatArray:
        """Phi (N, n_x, p)."""
        given = np.asarray(self.values, dtype=float)
        given = given[:, None] if given.ndim == 1 and n_x == 1 else given
        given = given[..., None] if given.ndim == 2 else given
        return _signals.array(f"{self.name}: values", given, ("N", n_x, "p"))

    def _recorded(self, log: Recording) -> FloatArray:
        """Phi (N, n_x, p) at the samples of a recording."""
        found = self._columns(log.n_x)
        if len(found) != log.n:
            raise ValueError(
                f"{self.name}: values: expected {log.n} samples as in the recording, got {len(found)}"
            )
        return found


@dataclass(frozen=True, eq=False)
class ModelScale:
    """The learned model is right up to a factor: f = theta f_theta, theta = 0 where it is right.

    Parameters
    ----------
    sd : float
        How wrong it may be: prior standard deviation of theta; 1 for a model that may be of no use at all.
    drift : float
        theta may change by drift sqrt(t) in t seconds.
    name : str
    """

    sd: float = 1.0
    drift: float = 0.0
    name: str = "model_scale"

    def _terms(self, n_x: int) -> Terms:
        """For n_x channels."""
        return _made(
            self,
            (self.name,),
            n_x,
            sd=_each(f"{self.name}: sd", self.sd, 1),
            density=_drift(self.name, self.drift),
            load=None,
        )

    @property
    def between(self) -> Rule:
        """Between samples."""
        return "average"

    def _recorded(self, log: Recording) -> FloatArray:
        """f_theta (N, n_x, 1) of a recording."""
        if log.f_theta is None:
            raise ValueError(f"{self.name}: the recording has no f_theta; see with_signals(f_theta=...)")
        return log.f_theta[:, :, None]


@dataclass(frozen=True, eq=False)
class SteadyForce:
    """A force that is constant or drifts, channel by channel: mean wind, a trim, a slope.

    Parameters
    ----------
    sd : float or (n_x,) array_like
        How large it may be: prior standard deviation, unit of f.
    drift : float
        It may change by drift sqrt(t) in t seconds, unit of f per s^(1/2). Alone it makes the estimate a PhyFilter of
        order 2.
    name : str
    """

    sd: ArrayLike
    drift: float = 0.0
    name: str = "steady"

    def _terms(self, n_x: int) -> Terms:
        """For n_x channels."""
        return _made(
            self,
            _channels(self.name, n_x),
            n_x,
            sd=_each(f"{self.name}: sd", self.sd, n_x),
            density=_drift(self.name, self.drift),
            load=np.eye(n_x),
        )


@dataclass(frozen=True, eq=False)
class ColouredForce:
    """A random force with a bandwidth, channel by channel: gusts. Gauss-Markov, w' = -bandwidth w + white noise.

    Parameters
    ----------
    sd : float or (n_x,) array_like
        Its standard deviation, unit of f.
    bandwidth : float
        rad/s.
    name : str
    """

    sd: ArrayLike
    bandwidth: float
    name: str = "wind"

    def _terms(self, n_x: int) -> Terms:
        """For n_x channels."""
        rate = _signals.number(f"{self.name}: bandwidth", self.bandwidth, "rad/s", above=0.0)
        sd = _each(f"{self.name}: sd", self.sd, n_x)
        return _made(
            self,
            _channels(self.name, n_x),
            n_x,
            sd=sd,
            rate=rate,
            density=2.0 * rate * sd**2,
            parameter=False,
            load=np.eye(n_x),
        )


@dataclass(frozen=True, eq=False)
class SensorBias:
    """An error of the measured x that stays or wanders, channel by channel; it is no force.

    Parameters
    ----------
    sd : float or (n_x,) array_like
        Its standard deviation, unit of x.
    bandwidth : float
        rad/s; 0 for one that stays.
    name : str
    """

    sd: ArrayLike
    bandwidth: float = 0.0
    name: str = "bias"

    def _terms(self, n_x: int) -> Terms:
        """For n_x channels."""
        rate = _signals.number(f"{self.name}: bandwidth", self.bandwidth, "rad/s", least=0.0)
        sd = _each(f"{self.name}: sd", self.sd, n_x)
        return _made(
            self,
            _channels(self.name, n_x),
            n_x,
            sd=sd,
            rate=rate,
            density=2.0 * rate * sd**2,
            parameter=rate == 0.0,
            load=np.zeros((n_x, n_x)),
            measured=np.eye(n_x),
        )


Part = Payload | AddedInertia | Regressor | ModelScale | SteadyForce | ColouredForce | SensorBias
