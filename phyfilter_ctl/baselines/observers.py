"""Observers that are special cases of the filter, by the names that they are known by.

    form                        state equation                                 estimate
    DisturbanceObserver         z'    = -a_0 z - a_0 (a_0 x + g)               f_hat = z + a_0 x
    LinearESO                   z_1'  = z_2 + g + 2 w (x - z_1),
                                z_2'  = w^2 (x - z_1)                          f_hat = z_2
    FeedbackNeuralNetwork       xh'   = g + f_hat                              f_hat = f_theta + a_0 (x - xh)
    Evolver                     xi_1' = f_theta' - a_0 (g + f_hat)             f_hat = xi_1 + a_0 x
    SeerII                      xi_2' = Xi Phi' s - a_0 (g + f_hat)            f_hat = xi_2 + int Xi Phi ds + a_0 x

All take M = I, and are run by the filter that they equal. The first four are that filter. The last two take the slope
of the learned model instead of its value, and differ from the filter where the model jumps.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..filter import PhyFilter, SampledPhyFilter
from ..filter.sampling import Rule


def DisturbanceObserver(gain: float, dt: float, *, g: Rule = "hold") -> SampledPhyFilter:
    """Chen's disturbance observer: the filter of order one without a model.

        z' = -a_0 z - a_0 (a_0 x + g),    f_hat = z + a_0 x,    z(0) = -a_0 x(0)

    Parameters
    ----------
    gain : float
        a_0 in rad/s.
    dt : float
        Nominal sampling interval in s.
    g : {"hold", "average"}
        What g does over a step: held from its beginning, or held at the mean of both ends.

    Returns
    -------
    SampledPhyFilter
        Of a_0 / (s + a_0).

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
    return _first_order(gain).sampled(dt, g=g)


def MomentumObserver(gain: float, dt: float, *, g: Rule = "hold") -> SampledPhyFilter:
    """Momentum observer of a robot arm, the usual detector of contacts: the filter of order one without a model.

        r' = K (p' - tau - C^T q' + gravity - r),    p = M(q) q'

    Give its ``run`` x = p and g = tau + C^T q' - gravity; or x = q', ``inertia`` = M(q) and g = tau - C q' - gravity,
    which is the same motion. f_hat is r, the external torque.

    Parameters
    ----------
    gain : float
        K in rad/s.
    dt, g
        As for :func:`DisturbanceObserver`.

    Returns
    -------
    SampledPhyFilter
        Of K / (s + K).

    Raises
    ------
    ValueError, TypeError
        As for :func:`DisturbanceObserver`.

    Notes
    -----
    A. De Luca, R. Mattone, "Actuator failure detection and isolation using generalized momenta", IEEE International
    Conference on Robotics and Automation, 2003.

    Examples
    --------
    >>> MomentumObserver(30.0, 0.001) == DisturbanceObserver(30.0, 0.001)
    True
    """
    return DisturbanceObserver(gain, dt, g=g)


def LinearESO(bandwidth: float, dt: float, *, g: Rule = "hold") -> SampledPhyFilter:
    """Linear extended state observer of a first-order plant: the low-pass filter with two poles at -w, without a model.

        z_1' = z_2 + g + 2 w (x - z_1),    z_2' = w^2 (x - z_1),    f_hat = z_2,    z(0) = (x(0), 0)

    Parameters
    ----------
    bandwidth : float
        w in rad/s.
    dt, g
        As for :func:`DisturbanceObserver`.

    Returns
    -------
    SampledPhyFilter
        Of w^2 / (s + w)^2.

    Raises
    ------
    ValueError, TypeError
        If ``bandwidth`` or ``dt`` is not a finite number above zero, or ``g`` is none of the two.

    Notes
    -----
    Z. Gao, "Scaling and bandwidth-parameterization based controller tuning", American Control Conference, 2003.

    Examples
    --------
    >>> LinearESO(20.0, 0.002).run(2.0 * 0.002 * np.arange(501)[:, None])[[0, -1]].round(6).ravel().tolist()
    [0.0, 2.0]
    """
    w = _signals.number("bandwidth", bandwidth, "rad/s", above=0.0)
    return PhyFilter.from_poles([-w, -w]).sampled(dt, g=g)


def FeedbackNeuralNetwork(
    gain: float, dt: float, *, g: Rule = "hold", f_theta: Rule = "average"
) -> SampledPhyFilter:
    """Learned model with linear feedback of its state error: the filter of order one.

        xh' = g + f_hat,    f_hat = f_theta + a_0 (x - xh),    xh(0) = x(0)

    Parameters
    ----------
    gain : float
        a_0 in rad/s.
    dt, g
        As for :func:`DisturbanceObserver`.
    f_theta : {"average", "hold"}
        What f_theta does over a step.

    Returns
    -------
    SampledPhyFilter
        Of a_0 / (s + a_0); hand f_theta to its ``run`` or ``step``.

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
    return _first_order(gain).sampled(dt, g=g, f_theta=f_theta)


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
        As for :func:`DisturbanceObserver`.

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
        _held(self.gain, self.dt, self.g)

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
        x : array_like, shape (N, n_x)
            Measured state.
        g : array_like, shape (N, n_x), optional
            Known part of x'; None means 0.
        slope : array_like, shape (N, n_x), optional
            Time derivative of f_theta at the samples; its mean at both ends counts for a step. None means 0.
        f_theta0 : array_like, shape (n_x,), optional
            f_theta at the first sample, where f_hat starts; None means 0.
        jumps : array_like, shape (N, n_x), optional
            Jumps of f_theta just before sample k that f_hat shall follow at once; row 0 does nothing.
        times : array_like, shape (N,), optional
            Sampling instants in s where they are not every ``dt``.

        Raises
        ------
        ValueError, TypeError
            If an array has the wrong shape or is not finite, or the times do not increase.
        """
        x = _signals.array("x", x, ("N", "n_x"))
        h = _steps(self.dt, times, len(x))
        risen = _mean(_beside("slope", slope, x)) * h
        start = np.zeros(x.shape[1])
        if f_theta0 is not None:
            start = _signals.array("f_theta0", f_theta0, x.shape[1:], beside="x")
        return _driven(_held(self.gain, self.dt, self.g), x, g, start, risen, jumps, times)


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
        As for :func:`DisturbanceObserver`.

    Raises
    ------
    ValueError, TypeError
        If ``gain`` or ``dt`` is not a finite number above zero, or ``g`` is none of the two.

    Notes
    -----
    Paper, supplement "Several special forms", "Chebyshev-based uncertainty observer". The integral is taken along
    the path, with Phi moving. Read as the antiderivative Xi Phi(t) s(x) at the present t, that is f_theta, it would
    hold the drift Xi Phi' s a second time.

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
        _held(self.gain, self.dt, self.g)

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
            As for :meth:`Evolver.run`.
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
            As for :meth:`Evolver.run`.
        """
        x = _signals.array("x", x, ("N", "n_x"))
        s = _signals.array("basis", basis, (len(x), "p"), beside="x")
        shape = (*x.shape, s.shape[1])
        W = _signals.array("weights", weights, shape, beside="x and basis")
        dW = _signals.array("weight_slopes", weight_slopes, shape, beside="x and basis")
        along_the_path = np.einsum("kij,kj->ki", _mean(W), np.diff(s, axis=0))
        drift = _mean(np.einsum("kij,kj->ki", dW, s)) * _steps(self.dt, times, len(x))
        sampled = _held(self.gain, self.dt, self.g)
        return _driven(sampled, x, g, W[0] @ s[0], along_the_path + drift, jumps, times)


def _first_order(gain: float) -> PhyFilter:
    return PhyFilter([_signals.number("gain", gain, "rad/s", above=0.0)])


def _held(gain: float, dt: float, g: Rule) -> SampledPhyFilter:
    """The filter through which a jump of f_theta at a sample passes at once and whole."""
    return _first_order(gain).sampled(dt, g=g, f_theta="hold")


def _driven(
    sampled: SampledPhyFilter,
    x: FloatArray,
    g: ArrayLike | None,
    start: FloatArray,
    risen: FloatArray,
    jumps: ArrayLike | None,
    times: ArrayLike | None,
) -> FloatArray:
    """The filter behind what f_theta has ``risen`` (N - 1, n_x) by, evenly over each step.

    Of an even rise the filter forgets within the step; (1 - exp(-a_0 h)) / (a_0 h) of it is left at the end, the same
    as of a jump of that size there.
    """
    a_h = sampled.filter.a[0] * _steps(sampled.dt, times, len(x))
    passed = risen * (-np.expm1(-a_h) / a_h) + _beside("jumps", jumps, x)[1:]
    f_theta = start + np.concatenate([np.zeros_like(x[:1]), np.cumsum(passed, axis=0)])
    return np.asarray(sampled.run(x, _beside("g", g, x), f_theta, times=times), dtype=float)


def _steps(dt: float, times: ArrayLike | None, count: int) -> float | FloatArray:
    """The step, or the steps (N - 1, 1) where the times are given."""
    return dt if times is None else np.diff(_signals.sample_times("times", times, count))[:, None]


def _mean(signal: FloatArray) -> FloatArray:
    """Of both ends of each step."""
    return 0.5 * (signal[:-1] + signal[1:])


def _beside(name: str, values: ArrayLike | None, x: FloatArray) -> FloatArray:
    """A signal of the shape of x; zeros where it is not given."""
    return np.zeros_like(x) if values is None else _signals.array(name, values, x.shape, beside="x")
