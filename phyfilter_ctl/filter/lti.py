"""What python-control asks of a linear system, answered by a filter that stays frozen and small.

python-control decides by ``isinstance``: functions of transfer functions ask for ``TransferFunction``, functions of
state spaces for ``StateSpace``, and each converts what is the other. A filter is both, and gives either side its own
numbers: its coefficients as a transfer function, its chain of sections as a state space. So no conversion runs that
would lose digits. Everything is computed when it is asked for; a filter holds no more than its coefficients and poles.
"""

# What python-control stores in attributes is computed here, and its annotations come from defaults of None.
# pyright: reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false

from __future__ import annotations

import numbers
import operator
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import control as ct
import numpy as np

from .._sections import ComplexArray, FloatArray

__all__ = ["LinearForm", "Roots"]


class Roots(np.ndarray[tuple[int], np.dtype[np.complex128]]):
    """Poles or zeros: an array, which python-control's way of asking, ``F.poles()``, gives as a plain one.

    Parameters
    ----------
    roots : (n,) complex array
        Of which this is a view.

    Examples
    --------
    >>> roots = Roots(np.array([-2.0 + 0.0j]))
    >>> roots.tolist(), type(roots()), type(2.0 * roots)
    ([(-2+0j)], <class 'numpy.ndarray'>, <class 'numpy.ndarray'>)
    """

    def __new__(cls, roots: ComplexArray) -> Roots:
        return roots.view(cls)

    def __call__(self) -> ComplexArray:
        return np.array(self)  # to sort or to change

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        return array[()] if np.ndim(array) == 0 else np.asarray(array)

    def __repr__(self) -> str:
        return repr(self.view(np.ndarray))


class _Labels(list[str]):
    """Labels of states that do not count as given: python-control's copy of a transfer function refuses given ones."""

    def __bool__(self) -> bool:
        return False


class LinearForm(ct.TransferFunction, ct.StateSpace):
    """A filter as python-control's ``TransferFunction`` and ``StateSpace`` from ``u[0]`` to ``y[0]``; frozen.

    ``TransferFunction.__init__`` does not run: what it would store is answered by the properties below.
    """

    name: str = "phyfilter"
    dt = 0
    ninputs = 1
    noutputs = 1
    display_format = None
    _static = False
    _repr_format = None

    # -- as a transfer function, by the filter's own coefficients -----------------------------------------------

    @property
    def transfer_function(self) -> ct.TransferFunction:
        """F(s) by its own coefficients."""
        raise NotImplementedError

    @property
    def error_transfer_function(self) -> ct.TransferFunction:
        """1 - F(s) by its own coefficients."""
        raise NotImplementedError

    @cached_property
    def num_array(self) -> Any:
        """Numerator for python-control: a (1, 1) array of the descending coefficients."""
        return self.transfer_function.num_array

    @cached_property
    def den_array(self) -> Any:
        """Denominator for python-control: a (1, 1) array of the descending coefficients."""
        return self.transfer_function.den_array

    # -- as a state space, by its sections, the last first ------------------------------------------------------
    # So A is upper triangular: of a lower one python-control's balancing confuses the states, and with them which poles
    # matter, how long a step response has to be and what step_info reads from it.

    @cached_property
    def sections(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(A, equilibrium, C) of the chain of sections."""
        raise NotImplementedError

    @property
    def A(self) -> FloatArray:
        """State matrix (n, n) of the chain of sections, the last first."""
        return self.sections[0][::-1, ::-1].copy()

    @property
    def B(self) -> FloatArray:
        """Input matrix (n, 1) of the chain of sections."""
        A, equilibrium, _ = self.sections
        return (-A @ equilibrium)[::-1, None]

    @property
    def C(self) -> FloatArray:
        """Output matrix (1, n) of the chain of sections."""
        return self.sections[2][None, ::-1].copy()

    @property
    def D(self) -> FloatArray:
        """Feedthrough (1, 1): zero, F is strictly proper."""
        return np.zeros((1, 1))

    @property
    def nstates(self) -> int:
        """Number of states, the order of D."""
        return len(self.sections[2])

    @property
    def input_index(self) -> dict[str, int]:
        """Number of the input by its label."""
        return {"u[0]": 0}

    @property
    def output_index(self) -> dict[str, int]:
        """Number of the output by its label."""
        return {"y[0]": 0}

    @property
    def state_index(self) -> dict[str, int]:
        """Numbers of the states by their labels."""
        return {f"w[{i}]": k for k, i in enumerate(reversed(range(self.nstates)))}

    @property
    def state_labels(self) -> list[str]:
        """Labels of the states."""
        return _Labels(self.state_index)

    @property
    def params(self) -> dict[str, float]:
        """Parameters of the state equations: none."""
        return {}

    @property
    def _current_params(self) -> dict[str, float]:
        return {}

    def _update_params(self, params: Any) -> None:
        """Nothing to update."""

    @property
    def updfcn(self) -> Callable[..., Any]:
        """Derivative of the states, by python-control's name for it: (t, x, u, params) -> x'."""
        return lambda t, x, u, params=None: self.dynamics(t, x, u)

    @property
    def outfcn(self) -> Callable[..., Any]:
        """Output, by python-control's name for it: (t, x, u, params) -> y."""
        return lambda t, x, u, params=None: self.output(t, x, u)

    # -- names: a frozen filter has none of its own to change ---------------------------------------------------

    def update_names(
        self,
        *,
        name: str | None = None,
        inputs: Sequence[str] | str | None = None,
        outputs: Sequence[str] | str | None = None,
        states: Sequence[str] | str | None = None,
    ) -> None:
        """Refuse a name: python-control would write it into the filter, which is frozen.

        Parameters
        ----------
        name, inputs, outputs, states
            As python-control has them.

        Raises
        ------
        TypeError
            If there is a name to set.
        """
        if any(given is not None for given in (name, inputs, outputs, states)):
            raise TypeError(
                "a PhyFilter is frozen and keeps its names; name the system that comes of it, "
                "ct.tf(F, name='fast') or ct.ss(F, name='fast')"
            )

    def copy(self, name: str | None = None, use_prefix_suffix: bool = True) -> ct.StateSpace:
        """The filter as a state space that can have another name, as ``control.interconnect`` asks for a second one.

        Parameters
        ----------
        name : str, optional
            Name of the state space.
        use_prefix_suffix : bool
            Without a name: mark it as a copy, else number it.

        Returns
        -------
        control.StateSpace
        """
        return ct.StateSpace(self).copy(name, use_prefix_suffix)

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self, var: str | None = None) -> None:
        """Leave notebooks to the formula."""

    def _repr_markdown_(self) -> None:
        """Leave notebooks to the formula."""

    # -- responses from a state: python-control would warn that a transfer function has none ---------------------

    @property
    def forced_response(self) -> Callable[..., Any]:
        """``control.forced_response`` of the chain of sections, to be called like it."""
        return ct.StateSpace(self).forced_response

    @property
    def impulse_response(self) -> Callable[..., Any]:
        """``control.impulse_response`` of the chain of sections, to be called like it.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> PhyFilter([20.0]).impulse_response([0.0, 0.1]).outputs.round(6).tolist()
        [20.0, 2.706706]
        """
        return ct.StateSpace(self).impulse_response

    @property
    def initial_response(self) -> Callable[..., Any]:
        """``control.initial_response`` of the chain of sections, to be called like it."""
        return ct.StateSpace(self).initial_response

    @property
    def sample(self) -> Callable[..., Any]:
        """``control.sample_system`` of the chain of sections, to be called like it.

        A transfer function would lose the digits of repeated poles, and on a fast clock their stability; only the
        method "matched" asks for one.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> PhyFilter.from_poles([-3.0] * 8).sample(1e-3).poles().real.round(9).tolist()[:2]
        [0.997004496, 0.997004496]
        """

        def sample(Ts: float, method: str = "zoh", *args: Any, **keywords: Any) -> Any:
            form = self.transfer_function if method == "matched" else ct.StateSpace(self)
            return form.sample(Ts, method, *args, **keywords)

        return sample

    # -- algebra: as a state space with those, else as a transfer function --------------------------------------

    def horner(self, x: Any, warn_infinite: bool = True) -> ComplexArray:
        """F at complex frequencies, shape (1, 1, N), as python-control's ``horner`` has it.

        Parameters
        ----------
        x : array_like, shape (N,)
            Complex frequencies.
        warn_infinite : bool
            False: no warning where one is a pole.
        """
        return np.atleast_1d(self(x, warn_infinite=warn_infinite)).reshape(1, 1, -1)

    def _operand(self, other: object) -> ct.TransferFunction | ct.StateSpace:
        """The filter in the form of what it is to be combined with; python-control divides no other form by data."""
        if isinstance(other, ct.NonlinearIOSystem | ct.FrequencyResponseData) and not isinstance(
            other, LinearForm
        ):
            return ct.StateSpace(self)
        return self.transfer_function

    def feedback(self, other: Any = 1, sign: int = -1) -> Any:
        """F in a loop with another system, as python-control's ``feedback``.

        Parameters
        ----------
        other : control.InputOutputSystem or number
            What is in the return path.
        sign : int
            -1 for negative feedback, 1 for positive.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> PhyFilter([20.0]).feedback().poles().tolist()
        [(-40+0j)]
        """
        return self._operand(other).feedback(_plain(other), sign)

    def append(self, other: Any) -> Any:
        """F and another system side by side, as python-control's ``append``.

        Parameters
        ----------
        other : control.LTI
            The system with the later inputs and outputs.
        """
        return ct.StateSpace(self).append(other)

    def __neg__(self) -> ct.TransferFunction:
        return -self.transfer_function

    def __add__(self, other: Any) -> Any:
        return self._combined(operator.add, other)

    def __radd__(self, other: Any) -> Any:
        return self._combined(operator.add, other, reflected=True)

    def __sub__(self, other: Any) -> Any:
        return self._combined(operator.sub, other)

    def __rsub__(self, other: Any) -> Any:
        if isinstance(other, numbers.Real) and other == 1:
            return self.error_transfer_function  # without cancellation near s = 0
        return self._combined(operator.sub, other, reflected=True)

    def __mul__(self, other: Any) -> Any:
        return self._combined(operator.mul, other)

    def __rmul__(self, other: Any) -> Any:
        return self._combined(operator.mul, other, reflected=True)

    def __truediv__(self, other: Any) -> Any:
        return self._combined(operator.truediv, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._combined(operator.truediv, other, reflected=True)

    def __pow__(self, other: Any) -> Any:
        return self.transfer_function**other

    def _combined(self, operation: Callable[[Any, Any], Any], other: Any, *, reflected: bool = False) -> Any:
        if not isinstance(other, numbers.Number | np.ndarray | ct.InputOutputSystem):
            return NotImplemented
        one, two = self._operand(other), _plain(other)
        return operation(two, one) if reflected else operation(one, two)


def _plain(other: Any) -> Any:
    return other.transfer_function if isinstance(other, LinearForm) else other
