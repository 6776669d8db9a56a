"""What a user chooses of one FMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import Any

from .. import _signals
from .archive import ArchiveLimits
from .clock_schedule import ClockTimes
from .foreign import Isolation
from .inspect import Scalar

__all__ = ["Fmu"]


@dataclass(frozen=True)
class Fmu:
    """An FMU file and what is chosen of it, given once for :func:`import_fmu`, :func:`cosimulate` and :func:`check`.

    Parameters
    ----------
    path : str or Path
    parameters : dict of str to number, text or bytes, optional
        Values of parameters and start values; elements of arrays as ``a[0]``. Structural parameters are set before all
        else, and arrays have the lengths that follow.
    outputs : sequence of str, optional
        Variables that it puts out, of any causality: names, in which * and ? stand for other characters. None: the
        FMU's outputs. String and Binary variables cannot be signals of python-control: of a co-simulation FMU
        :func:`cosimulate` records them. :func:`check` looks at all outputs in any case.
    clocks : dict of str to float or sequence of float, optional
        For clocks (FMI 3.0) whose interval is the importer's to choose, the interval in seconds; for triggered ones the
        times at which they tick. Periodic and countdown clocks tick as the FMU says.
    tolerance : float, optional
        Relative, of the FMU's own solver; None: that of its default experiment.
    isolated : bool or Isolation, optional
        Whether it runs in a process of its own, and within which limits of time; that costs one exchange between
        processes a step, 0.3 to 0.6 ms. SECURITY.md says what it fences. None: :func:`check` runs it in one of its
        own, the others in this process.
    limits : ArchiveLimits, optional
        What the archive may hold at most.

    Raises
    ------
    TypeError
        For a path, names of outputs, parameters or clocks that are no text, and for values of another kind.
    ValueError
        For a tolerance that is not above 0.

    Examples
    --------
    >>> Fmu("drone.fmu", parameters={"mass": 1.2}, isolated=True).parameters
    {'mass': 1.2}
    """

    path: str | Path
    _: KW_ONLY
    parameters: Mapping[str, Scalar] = field(default_factory=dict, hash=False)
    outputs: Sequence[str] | None = None
    clocks: ClockTimes = field(default_factory=dict, hash=False)
    tolerance: float | None = None
    isolated: bool | Isolation | None = None
    limits: ArchiveLimits | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.path, str | Path):
            raise TypeError(f"path: expected an FMU file, got {self.path!r}")
        for name, kind in (("parameters", "name: value"), ("clocks", "clock: seconds")):
            given: Any = getattr(self, name)
            given = {} if given is None else given
            if not isinstance(given, Mapping) or not all(isinstance(key, str) for key in given):
                raise TypeError(f"{name}: expected {{{kind}}}, got {given!r}")
            object.__setattr__(self, name, dict(given))
        if self.outputs is not None:
            if isinstance(self.outputs, str) or not all(isinstance(entry, str) for entry in self.outputs):
                raise TypeError(f"outputs: expected a list of names or patterns, got {self.outputs!r}")
            object.__setattr__(self, "outputs", tuple(self.outputs))
        if self.tolerance is not None:
            object.__setattr__(self, "tolerance", _signals.number("tolerance", self.tolerance, above=0.0))
        if not isinstance(self.isolated, bool | Isolation | None):
            raise TypeError(f"isolated: expected True, False or Isolation(call_limit), got {self.isolated!r}")
        if self.limits is not None and not isinstance(self.limits, ArchiveLimits):
            raise TypeError(f"limits: expected ArchiveLimits(entries, size), got {self.limits!r}")

    @classmethod
    def of(cls, given: str | Path | Fmu) -> Fmu:
        """What stands for an FMU in a call: a file as it is, or this.

        Parameters
        ----------
        given : str, Path or Fmu
        """
        return given if isinstance(given, Fmu) else cls(given)

    def told(self, parameters: Mapping[str, Scalar]) -> Fmu:
        """The same with other values for some parameters.

        Parameters
        ----------
        parameters : dict
        """
        return replace(self, parameters={**self.parameters, **parameters})
