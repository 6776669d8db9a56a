"""FMUs imported."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from .archive import ArchiveLimits
from .clock_schedule import ClockTimes
from .foreign import Isolation
from .importing_model import FmuModel
from .importing_steps import FmuSteps
from .inspect import FmuDescription, Kind, Scalar
from .unpacked import UnpackedFmu

__all__ = ["import_fmu"]


def import_fmu(
    path: str | Path,
    *,
    kind: Kind | None = None,
    name: str | None = None,
    step: float | None = None,
    parameters: Mapping[str, Scalar] | None = None,
    start_time: float = 0.0,
    tolerance: float | None = None,
    events: Literal["raise", "ignore"] = "raise",
    outputs: Sequence[str] | None = None,
    limits: ArchiveLimits | None = None,
    isolated: bool | Isolation = False,
    clocks: ClockTimes | None = None,
) -> FmuModel | FmuSteps:
    """Import an FMU (FMI 2.0 or 3.0) as a python-control system.

    **The FMU's code is run, with all it may do**: in this process, or with ``isolated`` in one of its own, which it may
    crash or hang without harm to this one. Import files you trust only; :func:`describe` reads any file without running
    it.

    Parameters
    ----------
    path : str or Path
    kind : {"me", "cs", "se"}, optional
        Model exchange gives a continuous system (its states and derivatives are python-control's), co-simulation a
        discrete one (the FMU integrates itself; ``sampled_block(block)`` takes it into a continuous diagram), scheduled
        execution too (its partitions are activated as their clocks tick). None: model exchange if the FMU has it and
        has no event indicators, else the first of the others.
    name : str, optional
        Of the block; the model's name by default.
    step : float, optional
        Communication step in seconds of a co-simulation FMU; by default that of its default experiment, its fixed
        internal step, or the shortest interval of a clock. Clocks tick in between too.
    parameters : dict of str to number, text or bytes, optional
        Values of parameters and start values; elements of arrays as ``a[0]``. Structural parameters are set before all
        else, and arrays have the lengths that follow.
    start_time : float
        Seconds.
    tolerance : float, optional
        Relative, of the FMU's own solver.
    events : {"raise", "ignore"}
        What python-control's own simulation, which handles none, is to do where a model-exchange FMU has events.
        :func:`simulate` runs them in any diagram.
    outputs : sequence of str, optional
        Variables that the block is to put out, of any causality: names, in which * and ? stand for other characters.
        None: the FMU's outputs. String and Binary variables cannot be signals of python-control: of a co-simulation FMU
        :func:`cosimulate` records them.
    limits : ArchiveLimits, optional
        What the archive may hold at most.
    isolated : bool or Isolation
        Whether the FMU runs in a process of its own, and within which limits of time; that costs one exchange between
        processes a step, 0.3 to 0.6 ms. SECURITY.md says what it fences.
    clocks : dict of str to float or sequence of float, optional
        For clocks (FMI 3.0) whose interval is the importer's to choose, the interval in seconds; for triggered ones the
        times at which they tick. Periodic and countdown clocks tick as the FMU says.

    Returns
    -------
    FmuModel or FmuSteps
        Its inputs and outputs are the FMU's (an array ``x`` as ``x[0]``, ``x[1]``, ...; a dot in a name, which
        python-control does not allow, becomes an underscore), ``params`` its numeric parameters, ``units`` their
        units, ``start_state`` and ``start_inputs`` their start values. Inputs that nothing drives keep those in
        :func:`simulate`.

    Raises
    ------
    FileNotFoundError, ValueError
        As for :func:`describe`; if the FMU has no binary for this platform, is of another kind, or no step is known.
    FmuError
        If the FMU itself fails.

    Examples
    --------
    >>> block = import_fmu("drone.fmu", kind="me")                                  # doctest: +SKIP
    >>> simulate(ct.interconnect([block, controller]), timepts, inputs)             # doctest: +SKIP
    >>> ct.input_output_response(block, timepts, inputs, block.start_state)       # doctest: +SKIP
    >>> engine = sampled_block(import_fmu("engine.fmu", kind="cs", step=0.01))      # doctest: +SKIP
    >>> simulate(ct.interconnect([engine, shaft]), timepts, inputs)                 # doctest: +SKIP
    """
    if kind not in (None, "me", "cs", "se"):
        raise ValueError(f'kind: expected "me", "cs" or "se", got {kind!r}')
    if events not in ("raise", "ignore"):
        raise ValueError(f'events: expected "raise" or "ignore", got {events!r}')
    fmu = UnpackedFmu(path, limits=limits, isolated=isolated, structure=parameters)
    description = fmu.description
    try:
        if kind is None:
            continuous = "me" in description.kinds and not (
                description.event_indicators and "cs" in description.kinds
            )
            kind = "me" if continuous else "cs" if "cs" in description.kinds else "se"
        label = name or re.sub(r"\W", "_", description.name)
        _known(description, parameters or {})
        parameters = {key: value for key, value in (parameters or {}).items() if key not in fmu.structure}
        if kind == "me":
            return FmuModel(
                fmu,
                name=label,
                parameters=parameters,
                start_time=start_time,
                tolerance=tolerance,
                events=events,
                outputs=outputs,
                clocks=clocks,
            )
        dt = step or description.communication_step
        if dt is None or not 0.0 < dt < np.inf:
            raise ValueError(f"{path}: step: expected seconds > 0, got {dt}; the FMU names none")
        return FmuSteps(
            fmu,
            name=label,
            step=dt,
            parameters=parameters,
            start_time=start_time,
            tolerance=tolerance,
            outputs=outputs,
            kind=kind,
            clocks=clocks,
        )
    except BaseException:
        fmu.close()
        raise


def _known(description: FmuDescription, parameters: Mapping[str, Scalar]) -> None:
    settable = {
        label
        for entry in description.variables
        if entry.start or entry.causality == "input"
        for label in (entry.name, *entry.labels)
    }
    unknown = [key for key in parameters if key not in settable]
    if unknown:
        raise ValueError(
            f"{description.path}: no variable with a start value is called {', '.join(unknown)}; "
            f"there are {', '.join(sorted(settable))}"
        )
