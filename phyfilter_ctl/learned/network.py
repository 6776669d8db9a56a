"""A small neural network of tanh units as a model of the unknown dynamics."""

from __future__ import annotations

import warnings
from dataclasses import KW_ONLY, dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..results import Status
from . import _arrays
from .layers import Layers, standardisation
from .model import FitResult
from .perceptron import Perceptron

if TYPE_CHECKING:
    from sklearn.neural_network import MLPRegressor

_SOLVERS = ("lbfgs", "adam")


@dataclass(frozen=True, eq=False, repr=False)
class Network(Perceptron):
    """Layers of tanh units on standardised features, with a linear output.

        f_theta = m_f + S_f (W_L' h_{L-1} + b_L),   h_i = tanh(W_i' h_{i-1} + b_i),   h_0 = (z - m_z) / S_z

    m and S are the mean and the standard deviation of the data fitted to. The parameters are the weights and the
    biases. Trained by scikit-learn's ``MLPRegressor``, evaluated here. To give the network the past of a signal,
    make the features with :func:`window`.

    Parameters
    ----------
    hidden : tuple of int
        Units in each hidden layer.
    solver : {"lbfgs", "adam"}
        L-BFGS uses all rows in every iteration, Adam mini-batches.
    l2 : float
        Weight l of the penalty l |W|^2 / (2 N) beside half the mean squared error, in standardised units.
    max_iterations : int
        Most iterations of L-BFGS, or passes over the data of Adam.
    tolerance : float
        Largest entry of the gradient (L-BFGS) or least improvement of the loss (Adam) at which training stops,
        in standardised units.
    seed : int
        Seed of the first weights and of the mini-batches: the same data and seed give the same network.
    layers : Layers, optional
        Weights of a fitted network; None before the first fit.

    Raises
    ------
    ValueError, TypeError
        If an option is out of range or the layers do not have the sizes in ``hidden``.

    Notes
    -----
    Gradient by back-propagation: D. E. Rumelhart, G. E. Hinton, R. J. Williams, "Learning representations by
    back-propagating errors", Nature 323, 1986.

    Examples
    --------
    >>> z = np.linspace(-2.0, 2.0, 200)[:, None]
    >>> result = Network(seed=1).fit(z, np.sin(z))
    >>> str(result.status), result.rmse < 0.05
    ('converged', True)
    >>> result.model
    Network(hidden=(20, 20), 1 -> 1, 481 parameters)
    """

    _: KW_ONLY
    solver: Literal["lbfgs", "adam"] = "lbfgs"
    l2: float = 1e-4
    max_iterations: int = 1000
    tolerance: float = 1e-4
    seed: int = 0

    _kind: ClassVar[str] = "network"
    _options: ClassVar[tuple[str, ...]] = ("solver", "l2", "max_iterations", "tolerance", "seed")
    _fitted_by: ClassVar[str] = "fit(z, f)"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.solver not in _SOLVERS:
            raise ValueError(f"solver: expected one of {_SOLVERS}, got {self.solver!r}")
        _signals.count("max_iterations", self.max_iterations)
        _signals.count("seed", self.seed, 0)
        for name in ("l2", "tolerance"):
            _arrays.number(name, getattr(self, name))

    def fit(self, z: ArrayLike, f: ArrayLike) -> FitResult[Self]:
        """Train on features z (N, n_z) and unknown dynamics f (N, n_x), from first weights drawn by ``seed``.

        Raises
        ------
        ValueError, TypeError
            If ``z`` and ``f`` are not finite real arrays with the same number of rows.
        """
        from sklearn.neural_network import MLPRegressor  # slow to import, needed for training only

        z, f = _arrays.pairs(z, f)
        (z_mean, z_scale), (f_mean, f_scale) = standardisation("z", z), standardisation("f", f)
        regressor = MLPRegressor(
            hidden_layer_sizes=self.hidden,
            activation="tanh",
            solver=self.solver,
            alpha=self.l2,
            max_iter=self.max_iterations,
            max_fun=20 * self.max_iterations,  # so that the iterations are the limit, not the line searches
            tol=self.tolerance,
            random_state=self.seed,
        )
        targets = (f - f_mean) / f_scale
        try:
            complaint = _train(
                regressor, (z - z_mean) / z_scale, targets[:, 0] if targets.shape[1] == 1 else targets
            )
            # A column of f that does not vary is its mean: what training left of it is rounding and initial weights.
            varies = np.sqrt(np.mean(targets**2, axis=0)) > 0.5  # 1 or 0 after standardisation
            regressor.coefs_[-1] *= varies
            regressor.intercepts_[-1] *= varies
            layers = Layers(
                tuple(regressor.coefs_), tuple(regressor.intercepts_), z_mean, z_scale, f_mean, f_scale
            )
        except ValueError as error:
            if "finite" not in str(error):  # something else than weights that ran away
                raise
            message = f"training diverged ({error}); change l2 or the seed, or use solver='lbfgs'"
            return FitResult(
                self, float("inf"), int(getattr(regressor, "n_iter_", 0)), Status.FAILED, message
            )
        rmse = float(np.sqrt(np.mean((layers.predict(z) - f) ** 2)))
        iterations = int(regressor.n_iter_)
        status, message = _status(complaint, iterations, self.max_iterations)
        return FitResult(replace(self, layers=layers), rmse, iterations, status, message)


def _train(regressor: MLPRegressor, z: FloatArray, f: FloatArray) -> str:
    """Fit; what the optimiser complained of, or nothing."""
    from sklearn.exceptions import ConvergenceWarning
    from threadpoolctl import threadpool_limits

    # One thread: the products are narrow, and on a busy machine several took up to twenty times as long; and the
    # network does not depend on the number of cores.
    with threadpool_limits(1, user_api="blas"), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        regressor.fit(z, f)
    complaints = [w for w in caught if issubclass(w.category, (ConvergenceWarning, RuntimeWarning))]
    for other in (w for w in caught if w not in complaints):
        warnings.warn_explicit(other.message, other.category, other.filename, other.lineno)
    if not np.isfinite(regressor.loss_):
        raise ValueError("the loss is not finite")
    return " ".join(str(complaints[0].message).split()) if complaints else ""


def _status(complaint: str, iterations: int, limit: int) -> tuple[Status, str]:
    if not complaint:
        return Status.CONVERGED, "converged"
    if iterations >= limit:
        return (
            Status.ITERATION_LIMIT,
            f"not converged in {limit} iterations; raise max_iterations, tolerance or l2",
        )
    return (
        Status.STALLED,
        f"the optimiser found no further descent ({complaint}); usable, or try another seed",
    )
