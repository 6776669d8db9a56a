"""Observers that are special cases of the filter, each in its own differential equation.

    form                        state equation                                 estimate
    DisturbanceObserver         z'    = -a_0 z - a_0 (a_0 x + g)               f_hat = z + a_0 x
    LinearESO                   z_1'  = z_2 + g + 2 w (x - z_1),
                                z_2'  = w^2 (x - z_1)                          f_hat = z_2
    FeedbackNeuralNetwork       xh'   = g + f_hat                              f_hat = f_theta + a_0 (x - xh)
    Evolver                     xi_1' = f_theta' - a_0 (g + f_hat)             f_hat = xi_1 + a_0 x
    SeerII                      xi_2' = Xi Phi' s - a_0 (g + f_hat)            f_hat = xi_2 + int Xi Phi ds + a_0 x

The states written here are the ones integrated, exactly for x (and the integral of SEER-II) linear between samples
and everything else held at its mean over the step. All take M = I.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_banded

from .. import _sections, _signals
from .._sections import FloatArray
from ..filter import PhyFilter

Rule = Literal["hold", "average"]


@dataclass(frozen=True)
class DisturbanceObserver:
    """Chen's disturbance observer.

        z' = -a_0 z - a_0 (a_0 x + g),    f_hat = z + a_0 x,    z(0) = -a_0 x(0)

    The filter of order one without a model: equal to ``PhyFilter([a_0]).sampled(dt)`` to rounding.

    Parameters
    ----------
    gain : float
        a_0 in rad/s.
    dt : float
        Nominal sampling interval in s.
    g : {"hold", "average"}
        What g does over a step: held from its beginning, or held at the mean of both ends.

    Raises
    ------
    ValueError, TypeError
        If ``gain`` or ``dt`` is not a finite number above zero, or ``g`` is none of the two.

    Notes
    -----
    W.-H. Chen, D. J. Ballance, P. J. Gawthrop, J. O'Reilly, "A nonlinear disturbance observer for robotic
    manipulators", IEEE Transactions on Industrial Electronics 47(4), 2000.

    Examples
    --------
    Constant unknown 2 under x' = f:

    >>> t = 0.002 * np.arange(501)
    >>> f_hat = DisturbanceObserver(20.0, 0.002).run(2.0 * t[:, None])[:, 0]
    >>> bool(np.allclose(f_hat, 2.0 * (1.0 - np.exp(-20.0 * t)), atol=1e-12))
    True
    """

    gain: float
    dt: float
    _: KW_ONLY
    g: Rule = "hold"

    def __post_init__(self) -> None:
        _check_options("gain", self.gain, self.dt, self.g)

    @property
    def filter(self) -> PhyFilter:
        """The filter it is a form of, a_0 / (s + a_0)."""
        return PhyFilter([self.gain])

    def run(self, x: ArrayLike, g: ArrayLike | None = None, *, times: ArrayLike | None = None) -> FloatArray:
        """f_hat (N, n_x) over a whole record.

        Parameters
        ----------
        x : array_like, shape (N, n_x)
            Measured state.
        g : array_like, shape (N, n_x), optional
            Known part of x'; None means 0.
        times : array_like, shape (N,), optional
            Sampling instants in s where they are not every ``dt``.

        Raises
        ------
        ValueError, TypeError
            If an array has the wrong shape or is not finite, or the times do not increase.
        """
        x, g, steps = _record(self.dt, x, g, times)
        return _first_order(self.gain, steps, x, -self.gain * _mean(self.g, g), start=np.zeros_like(x[0]))


@dataclass(frozen=True)
class LinearESO:
    """Linear extended state observer of a first-order plant.

        z_1' = z_2 + g + 2 w (x - z_1),    z_2' = w^2 (x - z_1),    f_hat = z_2,    z(0) = (x(0), 0)

    The low-pass filter with two poles at -w without a model: equal to ``PhyFilter([w^2, 2 w]).sampled(dt)`` to
    rounding.

    Parameters
    ----------
    bandwidth : float
        w in rad/s.
    dt : float
        Nominal sampling interval in s.
    g : {"hold", "average"}
        As for :class:`DisturbanceObserver`.

    Raises
    ------
    ValueError, TypeError
        If ``bandwidth`` or ``dt`` is not a finite number above zero, or ``g`` is none of the two.

    Notes
    -----
    Z. Gao, "Scaling and bandwidth-parameterization based controller tuning", American Control Conference, 2003.

    Examples
    --------
    >>> x = 2.0 * 0.002 * np.arange(501)[:, None]
    >>> observer = LinearESO(20.0, 0.002)
    >>> bool(np.allclose(observer.run(x), observer.filter.sampled(0.002).run(x), atol=1e-12))
    True
    """

    bandwidth: float
    dt: float
    _: KW_ONLY
    g: Rule = "hold"

    def __post_init__(self) -> None:
        _check_options("bandwidth", self.bandwidth, self.dt, self.g)

    @property
    def filter(self) -> PhyFilter:
        """The filter it is a form of, w^2 / (s + w)^2."""
        return PhyFilter.from_poles([-self.bandwidth, -self.bandwidth])

    def run(self, x: ArrayLike, g: ArrayLike | None = None, *, times: ArrayLike | None = None) -> FloatArray:
        """f_hat (N, n_x) over a whole record.

        Parameters
        ----------
        x, g, times
            As for :meth:`DisturbanceObserver.run`.

        Raises
        ------
        ValueError, TypeError
            As for :meth:`DisturbanceObserver.run`.
        """
        x, g, steps = _record(self.dt, x, g, times)
        w = self.bandwidth
        A = np.array([[-2.0 * w, 1.0], [-(w**2), 0.0]])
        held = _mean(self.g, g)[..., None] * np.array([1.0, 0.0])
        linear = x[..., None] * np.array([2.0 * w, w**2])
        start = np.stack([x[0], np.zeros_like(x[0])], axis=-1)
        return _integrate(A, steps, linear, held, start)[..., 1]


@dataclass(frozen=True)
class FeedbackNeuralNetwork:
    """Learned model with linear feedback of its state error.

        xh' = g + f_hat,    f_hat = f_theta + a_0 (x - xh),    xh(0) = x(0)

    The filter of order one: equal to ``PhyFilter([a_0]).sampled(dt)`` with the same f_theta to rounding.

    Parameters
    ----------
    gain : float
        a_0 in rad/s.
    dt : float
        Nominal sampling interval in s.
    g : {"hold", "average"}
        As for :class:`DisturbanceObserver`.
    f_theta : {"average", "hold"}
        The same for f_theta.

    Raises
    ------
    ValueError, TypeError
        If ``gain`` or ``dt`` is not a finite number above zero, or ``g`` or ``f_theta`` is none of the two.

    Notes
    -----
    Eq. (7) of the work on feedback neural networks that the paper's supplement "Several special forms" cites
    (Jia et al., 2024). The supplement starts the integral xh at 0; that leaves a transient of a_0 x(0).

    Examples
    --------
    >>> x = 2.0 * 0.002 * np.arange(501)[:, None]
    >>> FeedbackNeuralNetwork(20.0, 0.002).run(x, f_theta=np.full_like(x, 2.0))[[0, -1]].round(9).ravel().tolist()
    [2.0, 2.0]
    """

    gain: float
    dt: float
    _: KW_ONLY
    g: Rule = "hold"
    f_theta: Rule = "average"

    def __post_init__(self) -> None:
        _check_options("gain", self.gain, self.dt, self.g)
        _check_rule("f_theta", self.f_theta)

    @property
    def filter(self) -> PhyFilter:
        """The filter it is a form of, a_0 / (s + a_0)."""
        return PhyFilter([self.gain])

    def run(
        self,
        x: ArrayLike,
        g: ArrayLike | None = None,
        *,
        f_theta: ArrayLike | None = None,
        times: ArrayLike | None = None,
    ) -> FloatArray:
        """f_hat (N, n_x) over a whole record.

        Parameters
        ----------
        x, g, times
            As for :meth:`DisturbanceObserver.run`.
        f_theta : array_like, shape (N, n_x), optional
            Learned model; None means 0.

        Raises
        ------
        ValueError, TypeError
            As for :meth:`DisturbanceObserver.run`.
        """
        x, g, steps = _record(self.dt, x, g, times)
        f_theta = _beside("f_theta", f_theta, x.shape)
        held = _mean(self.g, g) + _mean(self.f_theta, f_theta)
        A = np.array([[-self.gain]])
        x_hat = _integrate(A, steps, self.gain * x[..., None], held[..., None], x[0][:, None])[..., 0]
        return f_theta + self.gain * (x - x_hat)


@dataclass(frozen=True)
class Evolver:
    """Uncertainty observer that takes the slope of the learned model instead of its value (EVOLVER).

        xi_1' = f_theta' - a_0 (g + f_hat),    f_hat = xi_1 + a_0 x,    xi_1(0) = f_theta(0) - a_0 x(0)

    In continuous time the filter of order one where f_theta is smooth. Take it where the model jumps and the
    truth does not, such as a model fitted anew while it runs: a jump that is no part of the slope never reaches
    f_hat, while the general form passes it on and forgets it as exp(-a_0 t). The price is the other way round: a
    jump of f that the model knows of (a contact, a load) comes at once in the general form and as
    1 - exp(-a_0 t) here, unless it is named in ``jumps``.

    Parameters
    ----------
    gain : float
        a_0 in rad/s.
    dt : float
        Nominal sampling interval in s.
    g : {"hold", "average"}
        As for :class:`DisturbanceObserver`.

    Raises
    ------
    ValueError, TypeError
        If ``gain`` or ``dt`` is not a finite number above zero, or ``g`` is none of the two.

    Notes
    -----
    Paper, supplement "Several special forms", "Koopman operator-based uncertainty observer". Exact for f_theta
    linear between samples; ``PhyFilter([a_0]).sampled(dt)`` holds f_theta at its mean there, so the two differ
    by (a_0 h)^2 / 12 of the step of f_theta, second order in h.

    Examples
    --------
    The model is replaced by one that is 1 higher; f_hat does not move:

    >>> x = np.zeros((500, 1))
    >>> bool(np.abs(Evolver(20.0, 0.002).run(x, slope=np.zeros_like(x))).max() == 0.0)
    True
    >>> jumping = np.where(np.arange(500) < 250, 0.0, 1.0)[:, None]
    >>> PhyFilter([20.0]).sampled(0.002).run(x, f_theta=jumping).max().round(2).item()
    0.98
    """

    gain: float
    dt: float
    _: KW_ONLY
    g: Rule = "hold"

    def __post_init__(self) -> None:
        _check_options("gain", self.gain, self.dt, self.g)

    @property
    def filter(self) -> PhyFilter:
        """The filter it is a form of, a_0 / (s + a_0)."""
        return PhyFilter([self.gain])

    def run(
        self,
        x: ArrayLike,
        g: ArrayLike | None = None,
        *,
        slope: ArrayLike | None = None,
        f_theta0: ArrayLike | None = None,
        jumps: ArrayLike | None = None,
        times: ArrayLike | None = None,
    ) -> FloatArray:
        """f_hat (N, n_x) over a whole record.

        Parameters
        ----------
        x, g, times
            As for :meth:`DisturbanceObserver.run`.
        slope : array_like, shape (N, n_x), optional
            Time derivative of f_theta at the samples; its mean at both ends counts for a step. None means 0.
        f_theta0 : array_like, shape (n_x,), optional
            f_theta at the first sample, where f_hat starts; None means 0.
        jumps : array_like, shape (N, n_x), optional
            Jumps of f_theta just before sample k that f_hat shall follow at once; row 0 does nothing.

        Raises
        ------
        ValueError, TypeError
            As for :meth:`DisturbanceObserver.run`.
        """
        x, g, steps = _record(self.dt, x, g, times)
        slope = _beside("slope", slope, x.shape)
        held = _mean("average", slope) - self.gain * _mean(self.g, g)
        kicks = _beside("jumps", jumps, x.shape)[1:]
        return _first_order(self.gain, steps, x, held, start=_start(f_theta0, x), kicks=kicks)


@dataclass(frozen=True)
class SeerII:
    """Uncertainty observer with a model f_theta = Xi Phi(t) s(x), its slope split by variables (SEER-II).

        xi_2' = Xi Phi'(t) s(x) - a_0 (g + f_hat),    f_hat = xi_2 + P + a_0 x,    P = int Xi Phi(t) ds(x)

    x' is never needed: the part of the slope that holds it is the integral P along the path, which the trapezoidal
    rule sums. What :class:`Evolver` does at jumps of the model holds here too, for jumps of Xi.

    Parameters
    ----------
    gain : float
        a_0 in rad/s.
    dt : float
        Nominal sampling interval in s.
    g : {"hold", "average"}
        As for :class:`DisturbanceObserver`.

    Raises
    ------
    ValueError, TypeError
        If ``gain`` or ``dt`` is not a finite number above zero, or ``g`` is none of the two.

    Notes
    -----
    Paper, supplement "Several special forms", "Chebyshev-based uncertainty observer". The integral is taken along
    the path, with Phi moving. Read as the antiderivative Xi Phi(t) s(x) at the present t, that is f_theta, it would
    hold the drift Xi Phi' s a second time.
    P and xi_2 may each grow without bound where Phi and s move together (in proportion to the time for
    sinusoids in phase) and cancel in f_hat; in double precision this costs nothing in practice.

    Examples
    --------
    f = 0.5 cos(t) x:

    >>> t = 0.002 * np.arange(2001)[:, None]
    >>> x = np.exp(0.5 * np.sin(t))
    >>> f_hat = SeerII(20.0, 0.002).run(
    ...     x, basis=x, weights=0.5 * np.cos(t)[:, :, None], weight_slopes=-0.5 * np.sin(t)[:, :, None]
    ... )
    >>> bool(np.abs(f_hat - 0.5 * np.cos(t) * x).max() < 1e-5)
    True
    """

    gain: float
    dt: float
    _: KW_ONLY
    g: Rule = "hold"

    def __post_init__(self) -> None:
        _check_options("gain", self.gain, self.dt, self.g)

    @property
    def filter(self) -> PhyFilter:
        """The filter it is a form of, a_0 / (s + a_0)."""
        return PhyFilter([self.gain])

    def run(
        self,
        x: ArrayLike,
        g: ArrayLike | None = None,
        *,
        basis: ArrayLike,
        weights: ArrayLike,
        weight_slopes: ArrayLike,
        jumps: ArrayLike | None = None,
        times: ArrayLike | None = None,
    ) -> FloatArray:
        """f_hat (N, n_x) over a whole record, from f_theta at its first sample.

        Parameters
        ----------
        x, g, times
            As for :meth:`DisturbanceObserver.run`.
        basis : array_like, shape (N, p)
            s(x) at the samples.
        weights : array_like, shape (N, n_x, p)
            Xi Phi(t) at the samples; Xi may change from sample to sample.
        weight_slopes : array_like, shape (N, n_x, p)
            Xi Phi'(t) at the samples.
        jumps : array_like, shape (N, n_x), optional
            As for :meth:`Evolver.run`.

        Raises
        ------
        ValueError, TypeError
            As for :meth:`DisturbanceObserver.run`.
        """
        x, g, steps = _record(self.dt, x, g, times)
        s = _signals.array("basis", basis, (len(x), "p"), beside="x")
        shape = (*x.shape, s.shape[1])
        W = _signals.array("weights", weights, shape, beside="x and basis")
        dW = _signals.array("weight_slopes", weight_slopes, shape, beside="x and basis")
        moved = np.einsum("kij,kj->ki", 0.5 * (W[1:] + W[:-1]), np.diff(s, axis=0))
        path = np.concatenate([np.zeros_like(x[:1]), np.cumsum(moved, axis=0)])
        held = _mean("average", np.einsum("kij,kj->ki", dW, s)) - self.gain * _mean(self.g, g)
        kicks = _beside("jumps", jumps, x.shape)[1:]
        return _first_order(self.gain, steps, x, held, start=W[0] @ s[0], kicks=kicks, path=path)


def _first_order(
    gain: float,
    steps: float | FloatArray,
    x: FloatArray,
    held: FloatArray,
    *,
    start: FloatArray,
    kicks: FloatArray | None = None,
    path: FloatArray | None = None,
) -> FloatArray:
    """f_hat = xi + path + gain x with xi' = held - gain (xi + path + gain x), from f_hat(0) = start."""
    beside = gain * x if path is None else gain * x + path
    A = np.array([[-gain]])
    xi_0 = (start - beside[0])[:, None]
    added = None if kicks is None else kicks[..., None]
    return _integrate(A, steps, -gain * beside[..., None], held[..., None], xi_0, added)[..., 0] + beside


def _integrate(
    A: FloatArray,
    steps: float | FloatArray,
    linear: FloatArray,
    held: FloatArray,
    start: FloatArray,
    kicks: FloatArray | None = None,
) -> FloatArray:
    """States q (N, K, n) of q' = A q + linear(t) + held, exact; ``kicks`` are added at the ends of the steps.

    Parameters
    ----------
    linear : (N, K, n), straight between samples
    held, kicks : (N - 1, K, n), one a step
    start : (K, n)
    """
    n = len(A)
    # exp of [[A, I, 0], [0, 0, I], [0, 0, 0]] h holds e^{Ah}, int e^{As} ds and int e^{A(h-s)} s ds in its first row.
    augmented = np.zeros((3 * n, 3 * n))
    augmented[:n, :n] = A
    augmented[: 2 * n, n:] += np.eye(2 * n)
    grown = _sections.expm1(augmented, steps)[..., :n, :]
    E = np.eye(n) + grown[..., :n]
    constant, ramp = grown[..., n : 2 * n], grown[..., 2 * n :] / np.asarray(steps)[..., None, None]
    drive = (held + linear[:-1]) @ np.swapaxes(constant, -1, -2)
    drive += np.diff(linear, axis=0) @ np.swapaxes(ramp, -1, -2)
    if kicks is not None:
        drive += kicks
    return _recursion_of(E, drive, start)


def _recursion_of(E: FloatArray, drive: FloatArray, start: FloatArray) -> FloatArray:
    """q_k = E_k q_{k-1} + drive_k for all k at once: a banded triangular system. E (n, n) or (m, n, n)."""
    m, K, n = drive.shape
    states = np.empty((m + 1, K, n))
    states[0] = start
    if m == 0:
        return states
    first = E if E.ndim == 2 else E[0]
    right = np.array(drive)
    right[0] += start @ first.T
    band = np.zeros((2 * n, m, n))  # entry [d, k, j]: row k n + j + d, column k n + j
    band[0] = 1.0
    later = E if E.ndim == 2 else E[1:]
    for i in range(n):
        for j in range(n):
            band[n + i - j, :-1, j] = -later[..., i, j]
    solved = solve_banded(
        (2 * n - 1, 0), band.reshape(2 * n, m * n), np.moveaxis(right, 1, 2).reshape(m * n, K)
    )
    states[1:] = np.moveaxis(solved.reshape(m, n, K), 2, 1)
    return states


def _mean(rule: Rule, signal: FloatArray) -> FloatArray:
    """Value (N - 1, n_x) that counts for each step."""
    return signal[:-1] if rule == "hold" else 0.5 * (signal[:-1] + signal[1:])


def _record(
    dt: float, x: ArrayLike, g: ArrayLike | None, times: ArrayLike | None
) -> tuple[FloatArray, FloatArray, float | FloatArray]:
    """x, g and the step, or the steps where the times are given."""
    x = _signals.array("x", x, ("N", "n_x"))
    g = _beside("g", g, x.shape)
    return x, g, dt if times is None else np.diff(_signals.sample_times("times", times, len(x)))


def _beside(name: str, values: ArrayLike | None, shape: tuple[int, ...]) -> FloatArray:
    """A signal of the shape of x; zeros where it is not given."""
    return np.zeros(shape) if values is None else _signals.array(name, values, shape, beside="x")


def _start(f_theta0: ArrayLike | None, x: FloatArray) -> FloatArray:
    return (
        np.zeros(x.shape[1])
        if f_theta0 is None
        else _signals.array("f_theta0", f_theta0, x.shape[1:], beside="x")
    )


def _check_options(name: str, gain: float, dt: float, g: str) -> None:
    _signals.number(name, gain, "rad/s", above=0.0)
    _signals.duration("dt", dt)
    _check_rule("g", g)


def _check_rule(name: str, rule: str) -> None:
    if rule not in ("hold", "average"):
        raise ValueError(f"{name}: expected 'hold' or 'average', got {rule!r}")
