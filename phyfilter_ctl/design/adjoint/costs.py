"""Stage and terminal costs of a rollout, with their gradients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import FloatArray

if TYPE_CHECKING:
    import casadi as ca


class CostTerms(NamedTuple):
    """A cost summed over m samples, and its gradients."""

    value: float
    f_hat: FloatArray  # (m, n_f): gradient in the estimate of each sample
    a: FloatArray  # (n,): gradient in the coefficients a where the cost names them


class StageCost(Protocol):
    """sum_i l_i(f_i, f_hat_i, a): any function that also gives its gradients."""

    def __call__(self, f_true: FloatArray, f_hat: FloatArray, a: FloatArray, /) -> CostTerms:
        """Sum over the samples f_true, f_hat (m, n_f) at coefficients a (n,)."""
        ...


@dataclass(frozen=True, eq=False)
class SquaredError:
    """The paper's stage cost (f - f_hat)' W (f - f_hat).

    Parameters
    ----------
    weights : array_like, shape (n_f,), optional
        Diagonal of W; None means 1 for every channel.

    Raises
    ------
    ValueError
        If a weight is negative or not finite.

    Examples
    --------
    >>> import numpy as np
    >>> SquaredError()(np.zeros((2, 1)), np.array([[1.0], [2.0]]), np.array([20.0])).value
    5.0
    """

    weights: ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.weights is not None:
            weights = np.atleast_1d(_signals.real("weights", self.weights))
            if weights.ndim != 1 or not weights.size or not np.all(np.isfinite(weights) & (weights >= 0.0)):
                raise ValueError(
                    f"weights: expected finite numbers >= 0, one per channel, got {self.weights!r}"
                )
            weights.flags.writeable = False
            object.__setattr__(self, "weights", weights)

    def __call__(self, f_true: FloatArray, f_hat: FloatArray, a: FloatArray, /) -> CostTerms:
        """Sum over the samples f_true, f_hat (m, n_f), with its gradient; a (n,) does not enter."""
        error = np.subtract(f_hat, f_true)
        slope = 2.0 * error if self.weights is None else 2.0 * np.asarray(self.weights) * error
        return CostTerms(0.5 * float(np.vdot(error, slope)), slope, np.zeros(len(a)))


class CasadiCost:
    """A stage cost written in CasADi; its gradients are CasADi's.

    Parameters
    ----------
    function : casadi.Function
        (f (n_f,), f_hat (n_f,), a (n,)) -> l, a number.

    Raises
    ------
    ValueError
        If the function does not have three inputs and one scalar output.

    Examples
    --------
    A cost that grows linearly for large errors, with a price on a_0:

    >>> import casadi as ca
    >>> import numpy as np
    >>> f, f_hat, a = ca.SX.sym("f"), ca.SX.sym("f_hat"), ca.SX.sym("a", 2)
    >>> huber = CasadiCost(ca.Function("l", [f, f_hat, a], [ca.sqrt(1 + (f - f_hat) ** 2) + 1e-3 * a[0]]))
    >>> round(huber(np.zeros((2, 1)), np.zeros((2, 1)), np.array([400.0, 40.0])).value, 6)
    2.8
    """

    def __init__(self, function: ca.Function) -> None:
        if function.n_in() != 3 or function.n_out() != 1 or function.numel_out(0) != 1:
            raise ValueError(
                f"function: expected (f, f_hat, a) -> one number, got {function}; sum over channels inside it"
            )
        import casadi as ca

        inputs = [ca.MX.sym(name, function.size1_in(i)) for i, name in enumerate(("f", "f_hat", "a"))]
        value = function(*inputs)
        gradients = [ca.gradient(value, inputs[1]), ca.gradient(value, inputs[2])]
        self._function = ca.Function("terms", inputs, [value, *gradients])
        self._sizes = tuple(function.size1_in(i) for i in range(3))

    def __call__(self, f_true: FloatArray, f_hat: FloatArray, a: FloatArray, /) -> CostTerms:
        """Sum over the samples f_true, f_hat (m, n_f) at coefficients a (n,), with its gradients.

        Raises
        ------
        ValueError
            If the function was written for other numbers of channels or coefficients.
        """
        given = (f_true.shape[1], f_hat.shape[1], len(a))
        if given != self._sizes:
            raise ValueError(
                f"CasadiCost: written for (f, f_hat, a) of {self._sizes} numbers, got {given}; write it for these"
            )
        columns = np.broadcast_to(a[:, None], (len(a), len(f_hat)))
        value, in_f_hat, in_a = (np.asarray(part) for part in self._function(f_true.T, f_hat.T, columns))
        return CostTerms(float(value.sum()), np.ascontiguousarray(in_f_hat.T), in_a.sum(axis=1))
