"""How importers are to run an FMU, and how it integrates inside."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["FmuExperiment", "FmuSolver"]

Method = Literal["rk4", "adaptive"]

_DEFAULT_STEP = 1e-3
_DEFAULT_STOP = 10.0


@dataclass(frozen=True)
class FmuSolver:
    """How a co-simulation FMU integrates between communication points and events.

    Parameters
    ----------
    method : {"rk4", "adaptive"}
        Classical Runge-Kutta of fixed step, or Dormand-Prince 5(4).
    step : float, optional
        Longest step in seconds; 1 ms for rk4, no bound (0) for adaptive. The FMU's parameter ``solver.step``.
    rtol, atol : float
        Error of a step below atol + rtol |x|; ``solver.rtol`` and ``solver.atol``. Adaptive only.

    Raises
    ------
    ValueError
        If the method is another, or a number is negative or not finite.

    Examples
    --------
    >>> FmuSolver().step, FmuSolver("adaptive").step
    (0.001, 0.0)
    """

    method: Method = "rk4"
    step: float | None = None
    rtol: float = 1e-8
    atol: float = 1e-10

    def __post_init__(self) -> None:
        if self.method not in ("rk4", "adaptive"):
            raise ValueError(f"solver method: expected 'rk4' or 'adaptive', got {self.method!r}")
        if self.step is None:
            object.__setattr__(self, "step", _DEFAULT_STEP if self.method == "rk4" else 0.0)
        for name, value in (("step", self.step), ("rtol", self.rtol), ("atol", self.atol)):
            if value is None or not 0.0 <= value < float("inf"):
                raise ValueError(f"solver {name}: expected a number >= 0, got {value!r}")
        if self.method == "rk4" and self.step == 0.0:
            raise ValueError("solver step: rk4 needs a step above 0 s, got 0")


@dataclass(frozen=True)
class FmuExperiment:
    """What importers run by default.

    Parameters
    ----------
    start, stop : float
        Seconds.
    step : float, optional
        Communication step in seconds.
    tolerance : float
        Relative, for solvers of the importer and the adaptive one inside.

    Raises
    ------
    ValueError
        If stop is not after start, or the step or tolerance not above 0.
    """

    start: float = 0.0
    stop: float = _DEFAULT_STOP
    step: float | None = None
    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        if not self.start < self.stop < float("inf"):
            raise ValueError(f"experiment: expected start < stop, got {self.start!r} and {self.stop!r}")
        if not self.tolerance > 0.0 or (self.step is not None and not self.step > 0.0):
            raise ValueError(
                f"experiment: expected step and tolerance above 0, got {self.step!r} and {self.tolerance!r}"
            )
