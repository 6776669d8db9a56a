"""A small network as the unknown right-hand side of a differential equation, fitted to trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from itertools import pairwise
from typing import ClassVar, Literal, Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..results import Status
from . import _arrays
from ._descent import Descent, descend
from ._rollout import Segments, ends, misfit
from .layers import Layers, standardisation
from .model import FitResult
from .perceptron import Perceptron

_BETWEEN = ("hold", "average")
_STARTS = ("free", "measured")
# Parts of a segment whose mean f gives the first guess: short against the segment, long against the noise.
_PARTS = 4


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples of a state and of what drives it.

    Parameters
    ----------
    x : array_like, shape (N, n_x)
        Measured state, N >= 2.
    dt : float
        Sampling time, s.
    g : array_like, shape (N, n_x), optional
        Known dynamics; 0 if None.
    u : array_like, shape (N, n_u), optional
        Further inputs of f; none if None.

    Raises
    ------
    ValueError, TypeError
        If a shape is wrong or a value is not finite.
    """

    x: FloatArray
    dt: float
    _: KW_ONLY
    g: FloatArray | None = None
    u: FloatArray | None = None

    def __post_init__(self) -> None:
        x = _arrays.rows("x", self.x)
        if len(x) < 2:
            raise ValueError("x: expected at least 2 samples, got 1")
        _arrays.number("dt", self.dt, positive=True)
        g = np.zeros_like(x) if self.g is None else _arrays.rows("g", self.g, x.shape[1])
        u = np.zeros((len(x), 0)) if self.u is None else _arrays.rows("u", self.u)
        for name, values in (("g", g), ("u", u)):
            if len(values) != len(x):
                raise ValueError(f"{name}: expected {len(x)} rows as in x, got {len(values)}")
        for name, values in (("x", x), ("g", g), ("u", u)):
            object.__setattr__(self, name, _arrays.frozen(name, values))

    @property
    def signals(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, g and u."""
        assert self.g is not None  # both set in __post_init__
        assert self.u is not None
        return self.x, self.g, self.u


@dataclass(frozen=True, eq=False, repr=False)
class NeuralOde(Perceptron):
    """Layers of tanh units f_theta(x, u) in x' = g + f_theta(x, u), fitted to rollouts.

    :meth:`fit_trajectories` needs neither f nor a derivative of x: it rolls the equation out over short segments
    (multiple shooting, Runge-Kutta steps of the sampling time) and compares with the samples. :meth:`fit` takes
    labels of f, as every learned model does. Features z = (x, u).

    Parameters
    ----------
    hidden : tuple of int
        Units in each hidden layer.
    segment : int
        Steps of a segment: long against the noise (|noise| / (segment dt) small against f), short against the time
        over which two neighbouring motions part.
    starts : {"free", "measured"}
        Whether the states at the start of the segments are fitted too, or are the noisy samples.
    g, u : {"hold", "average"}
        How g and u go on between samples: held, or on a straight line.
    l2 : float
        Weight l of the penalty l |parameters|^2 / 2 beside half the mean squared misfit.
    max_iterations : int
        Most iterations of L-BFGS.
    tolerance : float
        Largest entry of the gradient at which the fit stops.
    seed : int
        Seed of the first weights.
    layers : Layers, optional
        Weights of a fitted network; None before the first fit.

    Raises
    ------
    ValueError, TypeError
        If an option is out of range or the layers do not have the sizes in ``hidden``.

    Notes
    -----
    R. T. Q. Chen, Y. Rubanova, J. Bettencourt, D. Duvenaud, "Neural ordinary differential equations", NeurIPS 2018;
    H. G. Bock, K. J. Plitt, "A multiple shooting algorithm for direct solution of optimal control problems", IFAC
    1984. The gradient is the adjoint of the Runge-Kutta steps.

    Examples
    --------
    >>> t = 0.05 * np.arange(100.0)
    >>> motion = Trajectory(np.exp(-0.8 * t)[:, None], 0.05)
    >>> result = NeuralOde((5,), max_iterations=100).fit_trajectories(motion)
    >>> bool(result.rmse < 1e-3), result.model.predict([[0.5]]).round(2).tolist()
    (True, [[-0.4]])
    """

    _: KW_ONLY
    segment: int = 10
    starts: Literal["free", "measured"] = "free"
    g: Literal["hold", "average"] = "hold"
    u: Literal["hold", "average"] = "average"
    l2: float = 1e-8
    max_iterations: int = 500
    tolerance: float = 1e-5
    seed: int = 0

    _kind: ClassVar[str] = "neural_ode"
    _options: ClassVar[tuple[str, ...]] = (
        "segment",
        "starts",
        "g",
        "u",
        "l2",
        "max_iterations",
        "tolerance",
        "seed",
    )
    _fitted_by: ClassVar[str] = "fit_trajectories"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, allowed in (("starts", _STARTS), ("g", _BETWEEN), ("u", _BETWEEN)):
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name}: expected one of {allowed}, got {getattr(self, name)!r}")
        for name in ("segment", "max_iterations"):
            _signals.count(name, getattr(self, name))
        _signals.count("seed", self.seed, 0)
        for name in ("l2", "tolerance"):
            _arrays.number(name, getattr(self, name))

    def fit(self, z: ArrayLike, f: ArrayLike) -> FitResult[Self]:
        """Fit to labels: z = (x, u) (N, n_z) and unknown dynamics f (N, n_x), from first weights drawn by ``seed``.

        Raises
        ------
        ValueError, TypeError
            If ``z`` and ``f`` are not finite real arrays with the same number of rows.
        """
        z, f = _arrays.pairs(z, f)
        first = self._first_layers(standardisation("z", z), standardisation("f", f))
        layers, end = self._regression(first, z, f)
        return self._result(layers, _arrays.rms(layers.predict(z) - f), end)

    def fit_trajectories(self, trajectories: Trajectory | Sequence[Trajectory]) -> FitResult[Self]:
        """Fit the rollouts of x' = g + f_theta(x, u) to the samples of one or several motions.

        A model that has weights goes on from them. ``rmse`` of the result is the error of the mean of g + f_theta
        over a segment, sqrt(mean((x_hat - x)_end^2)) / (segment dt), in the unit of f.

        Parameters
        ----------
        trajectories : Trajectory or sequence of Trajectory
            Motions with the same channels, each at least one segment long.

        Raises
        ------
        ValueError, TypeError
            If there is none, one is shorter than a segment, or their channels differ.
        """
        motions = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
        segments = self._segments(motions)
        duration = self.segment * segments.dt[:, None]
        mean_f = segments.mean_f(0, self.segment)
        first = self._guess(segments) if self.layers is None else self.layers
        # What f moves over a segment is the unit of the misfit: 1 means that nothing has been learned.
        scale = np.sqrt(np.mean((mean_f * duration) ** 2, axis=0))
        scale = np.where(scale > 0.0, scale, 1.0)
        measured, count = segments.x[:, 0], segments.x.size
        # One start in many moves the loss little; in this unit as much as a weight does, which L-BFGS wants.
        unit = scale * np.sqrt(len(measured))

        def starts(variables: FloatArray) -> FloatArray:
            if self.starts == "measured":
                return measured
            return measured + unit * variables[len(first.parameters) :].reshape(measured.shape)

        def loss(variables: FloatArray) -> tuple[float, FloatArray]:
            p = variables[: len(first.parameters)]
            value, slope, at_starts = misfit(first.with_parameters(p), segments, starts(variables), scale)
            slope = slope / count + self.l2 * p
            free = [(unit * at_starts / count).ravel()] if self.starts == "free" else []
            return value / count + 0.5 * self.l2 * float(p @ p), np.concatenate([slope, *free])

        extra = measured.size if self.starts == "free" else 0
        begin = np.concatenate([first.parameters, np.zeros(extra)])
        end = descend(loss, begin, max_iterations=self.max_iterations, tolerance=self.tolerance)
        layers = first.with_parameters(end.parameters[: len(first.parameters)])
        if end.status is Status.FAILED:
            return self._result(layers, float("inf"), end)
        error = (ends(layers, segments, starts(end.parameters)) - segments.x[:, -1]) / duration
        return self._result(layers, _arrays.rms(error), end)

    def simulate(self, trajectory: Trajectory) -> FloatArray:
        """Roll out from the first sample of ``trajectory`` with its g and u; the states, shape (N, n_x).

        Raises
        ------
        ValueError
            If the model has not been fitted, or the channels are not those it was fitted to.
        """
        layers = self._fitted()
        x, g, u = trajectory.signals
        self._check_channels(layers, x.shape[1], u.shape[1])
        state, ends_of_step = ca.SX.sym("x", x.shape[1]), ca.SX.sym("v", 2 * (g.shape[1] + u.shape[1]))
        cuts = np.cumsum([0, *2 * [g.shape[1]], *2 * [u.shape[1]]])
        g0, g1, u0, u1 = ca.vertsplit(ends_of_step, cuts.tolist())
        g1, u1 = (g0 if self.g == "hold" else g1), (u0 if self.u == "hold" else u1)
        h, slope, after = trajectory.dt, ca.SX.zeros(x.shape[1]), state
        for part, reach, weight in (
            (0.0, 0.0, 1 / 6),
            (0.5, 0.5, 1 / 3),
            (0.5, 0.5, 1 / 3),
            (1.0, 1.0, 1 / 6),
        ):
            u_here, g_here = (1.0 - part) * u0 + part * u1, (1.0 - part) * g0 + part * g1
            slope = g_here + layers.expression(ca.vertcat(state + reach * h * slope, u_here))
            after = after + weight * h * slope
        step = ca.Function("step", [state, ends_of_step], [after])
        drive = np.hstack([g[:-1], g[1:], u[:-1], u[1:]])
        return np.vstack([x[:1], step.mapaccum(len(x) - 1)(x[0], drive.T).full().T])

    def _segments(self, motions: list[Trajectory]) -> Segments:
        """All motions cut into segments; the last one of a motion may overlap the one before."""
        if not motions:
            raise ValueError("trajectories: expected at least one, got none")
        channels = {(m.x.shape[1], m.signals[2].shape[1]) for m in motions}
        if len(channels) > 1:
            raise ValueError(
                f"trajectories: expected the same channels (n_x, n_u) in all, got {sorted(channels)}"
            )
        if self.layers is not None:
            self._check_channels(self.layers, *channels.pop())
        pieces, steps = [], self.segment
        for number, motion in enumerate(motions):
            last = len(motion.x) - 1 - steps
            if last < 0:
                raise ValueError(
                    f"trajectories: number {number} has {len(motion.x)} samples, fewer than a segment of {steps} "
                    "steps; give longer ones, or lower segment"
                )
            first = np.unique([*range(0, last + 1, steps), last])
            x, g, u = motion.signals
            cut = first[:, None] + np.arange(steps + 1)
            fine = 2 * first[:, None] + np.arange(2 * steps + 1)
            pieces.append((x[cut], _halved(g)[fine], _halved(u)[fine], np.full(len(first), motion.dt)))
        x, g, u, dt = (np.concatenate(column) for column in zip(*pieces, strict=True))
        return Segments(x, g, u, dt, (self.g == "hold", self.u == "hold"))

    def _guess(self, segments: Segments) -> Layers:
        """Fit to means of f over parts of the segments: coarse, but a hundredth of the work of rollouts."""
        width = max(1, self.segment // _PARTS)
        cuts = range(0, self.segment - width + 1, width)
        z = np.concatenate([segments.mean_z(i, i + width) for i in cuts])
        f = np.concatenate([segments.mean_f(i, i + width) for i in cuts])
        first = self._first_layers(standardisation("x", z), standardisation("x", f))
        layers, end = self._regression(first, z, f)
        return first if end.status is Status.FAILED else layers

    def _regression(self, first: Layers, z: FloatArray, f: FloatArray) -> tuple[Layers, Descent]:
        def loss(p: FloatArray) -> tuple[float, FloatArray]:
            layers = first.with_parameters(p)
            error = (layers.predict(z) - f) / first.f_scale
            value = 0.5 * float(np.mean(error**2)) + 0.5 * self.l2 * float(p @ p)
            return value, layers.vjp(z, error / (first.f_scale * error.size)) + self.l2 * p

        end = descend(loss, first.parameters, max_iterations=self.max_iterations, tolerance=self.tolerance)
        return first.with_parameters(end.parameters), end

    def _first_layers(
        self, of_z: tuple[FloatArray, FloatArray], of_f: tuple[FloatArray, FloatArray]
    ) -> Layers:
        """Random hidden layers and an output of zero: the first rollouts follow the mean of f."""
        rng = np.random.default_rng(self.seed)
        sizes = (len(of_z[0]), *self.hidden, len(of_f[0]))
        limits = [np.sqrt(6.0 / (m + n)) for m, n in pairwise(sizes)]
        weights = [rng.uniform(-a, a, size) for a, size in zip(limits, pairwise(sizes), strict=True)]
        weights[-1] = np.zeros_like(weights[-1])
        return Layers(tuple(weights), tuple(np.zeros(n) for n in sizes[1:]), *of_z, *of_f)

    def _result(self, layers: Layers, rmse: float, end: Descent) -> FitResult[Self]:
        if end.status is Status.FAILED or not np.isfinite(rmse):
            message = f"the fit diverged ({end.message}); lower segment, scale x, or start without weights"
            return FitResult(self, float("inf"), end.iterations, Status.FAILED, message)
        return FitResult(replace(self, layers=layers), rmse, end.iterations, end.status, end.message)

    @staticmethod
    def _check_channels(layers: Layers, n_x: int, n_u: int) -> None:
        if layers.sizes[-1] != n_x or layers.sizes[0] != n_x + n_u:
            raise ValueError(
                f"trajectories: the model has {layers.sizes[-1]} states and {layers.sizes[0] - layers.sizes[-1]} "
                f"inputs u, got {n_x} and {n_u}"
            )


def _halved(values: FloatArray) -> FloatArray:
    """The samples and the means of neighbours between them, (2 N - 1, n)."""
    fine = np.empty((2 * len(values) - 1, values.shape[1]))
    fine[::2], fine[1::2] = values, 0.5 * (values[:-1] + values[1:])
    return fine
