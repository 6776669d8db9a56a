"""How importers are to run an FMU, and how it integrates inside."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from .. import _signals

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
    """What importers run by default, how the FMU integrates, and what its description says of it.

    Parameters
    ----------
    start, stop : float
        Seconds.
    step : float, optional
        Communication step in seconds.
    tolerance : float
        Relative, for solvers of the importer and the adaptive one inside.
    solver : FmuSolver, optional
        Of co-simulation with continuous states. None: RK4 in steps of 1 ms, shorter where poles are fast.
    author, description : str
        For the model description.

    Raises
    ------
    TypeError
        For a solver, author or description of another kind.
    ValueError
        If stop is not after start, or the step or tolerance not above 0.

    Examples
    --------
    >>> FmuExperiment(stop=2.0, step=0.01, solver=FmuSolver("adaptive")).solver.rtol
    1e-08
    """

    start: float = 0.0
    stop: float = _DEFAULT_STOP
    step: float | None = None
    tolerance: float = 1e-6
    solver: FmuSolver | None = None
    author: str = ""
    description: str = ""

    def __post_init__(self) -> None:
        for name in ("start", "stop", "step", "tolerance"):
            if getattr(self, name) is not None or name != "step":
                unit = "" if name == "tolerance" else "s"
                object.__setattr__(self, name, _signals.number(name, getattr(self, name), unit))
        if not self.start < self.stop:
            raise ValueError(f"experiment: expected start < stop, got {self.start!r} and {self.stop!r}")
        if not self.tolerance > 0.0 or (self.step is not None and not self.step > 0.0):
            raise ValueError(
                f"experiment: expected step and tolerance above 0, got {self.step!r} and {self.tolerance!r}"
            )
        if self.solver is not None and not isinstance(self.solver, FmuSolver):
            raise TypeError(f"solver: expected FmuSolver(method, step), got {self.solver!r}")
        for name in ("author", "description"):
            if not isinstance(getattr(self, name), str):
                raise TypeError(f"{name}: expected text, got {getattr(self, name)!r}")
