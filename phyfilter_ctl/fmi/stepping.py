"""How the steps of a co-simulation are made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Literal

import numpy as np

from .. import _signals

__all__ = ["Master"]

_CHOICES = {"scheme": ("jacobi", "gauss-seidel"), "hold": ("zero", "first")}


@dataclass(frozen=True)
class Master:
    """How :func:`cosimulate` steps its parts.

    At a communication point t_k every part has reached t_k; outputs are handed on along direct feedthrough until
    they settle, then each part advances to t_{k+1} on inputs that it holds:

    * Jacobi: the inputs at t_k, for all parts alike.
    * Gauss-Seidel: part after part, in order; a part sees the outputs at t_{k+1} of the parts before it.

    Both are of first order in the communication step, and of second order with ``hold="first"``, where inputs follow
    lines over a step: through the last two outputs (extrapolated), through both ends of the step where these are known
    (from outside, and from parts before in Gauss-Seidel).

    Parameters
    ----------
    step : float, optional
        Longest communication step in seconds; the spacing of ``timepts`` by default. With ``tolerance``: the first
        step.
    scheme : {"jacobi", "gauss-seidel"}
    order : sequence of str, optional
        Parts in the order of Gauss-Seidel; as given by default.
    hold : {"zero", "first"}
        Whether continuous inputs are held over a step or follow lines. An FMU of FMI 2.0 that can interpolate inputs is
        given slopes (fmi2SetRealInputDerivatives); every other part is given the line's value in the middle of the step
        (FMI 3.0 has no call for slopes), which has the same integral. Discrete inputs and discrete systems hold.
    tolerance, absolute_tolerance : float, optional
        Step control: each step is made once and again as two halves, the difference of all outputs is kept below
        ``absolute_tolerance + tolerance * |y|``, and the finer result is kept. All parts must be able to put back their
        state. ``absolute_tolerance`` is ``tolerance`` by default.
    threads : int
        For the steps of FMUs with Jacobi in C, except on Windows: worth it for FMUs whose steps take 10 us and more.
        The results do not depend on it.
    intermediate : bool
        Whether FMUs that provide intermediate updates (FMI 3.0) are to tell of their Float64 outputs inside steps, on
        the inputs held; ``response.intermediate`` has them.

    Raises
    ------
    TypeError
        For an order that is no list of names, a number of threads that is no whole number.
    ValueError
        For a scheme or hold of another kind, a step or tolerance that is not above 0, an order for Jacobi, an absolute
        tolerance alone.

    References
    ----------
    Schierz, T., Arnold, M., Clauss, C.: Co-simulation with communication step size control in an FMI compatible
    master algorithm. 9th International Modelica Conference, 2012.

    Examples
    --------
    >>> Master(0.01, "gauss-seidel", order=["plant", "law"]).order
    ('plant', 'law')
    """

    step: float | None = None
    scheme: Literal["jacobi", "gauss-seidel"] = "jacobi"
    _: KW_ONLY
    order: Sequence[str] | None = None
    hold: Literal["zero", "first"] = "zero"
    tolerance: float | None = None
    absolute_tolerance: float | None = None
    threads: int = 1
    intermediate: bool = False

    def __post_init__(self) -> None:
        for name, unit in (
            ("step", "seconds"),
            ("tolerance", "a number"),
            ("absolute_tolerance", "a number"),
        ):
            value = getattr(self, name)
            if value is not None and not 0.0 < _signals.number(name, value) < np.inf:
                raise ValueError(f"{name}: expected {unit} > 0, got {value}")
        for name, known in _CHOICES.items():
            if getattr(self, name) not in known:
                raise ValueError(
                    f'{name}: expected "{known[0]}" or "{known[1]}", got {getattr(self, name)!r}'
                )
        if self.absolute_tolerance is not None and self.tolerance is None:
            raise ValueError("absolute_tolerance: means nothing without tolerance; give both")
        if self.order is not None:
            if isinstance(self.order, str) or not all(isinstance(name, str) for name in self.order):
                raise TypeError(f"order: expected names of parts, got {self.order!r}")
            object.__setattr__(self, "order", tuple(self.order))
            if self.scheme == "jacobi":
                raise ValueError('order: means nothing to scheme="jacobi"; expected scheme="gauss-seidel"')
        _signals.count("threads", self.threads)
        if not isinstance(self.intermediate, bool):
            raise ValueError(f"intermediate: expected True or False, got {self.intermediate!r}")
