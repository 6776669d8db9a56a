"""FMUs imported."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np

from .._renamed import takes_former
from .fmu import Fmu
from .importing_model import FmuModel
from .importing_steps import FmuSteps
from .inspect import Kind, refuse_unknown
from .unpacked import UnpackedFmu

__all__ = ["import_fmu"]


@takes_former
def import_fmu(
    fmu: str | Path | Fmu,
    *,
    kind: Kind | None = None,
    name: str | None = None,
    step: float | None = None,
    start_time: float = 0.0,
    events: Literal["raise", "ignore"] = "raise",
) -> FmuModel | FmuSteps:
    """Import an FMU (FMI 2.0 or 3.0) as a python-control system.

    **The FMU's code is run, with all it may do**: in this process, or with ``Fmu(path, isolated=True)`` in one of its
    own, which it may crash or hang without harm to this one. Import files you trust only; :func:`describe` reads any
    file without running it.

    Parameters
    ----------
    fmu : str, Path or Fmu
        The file, or the file with parameters, outputs, clocks, a tolerance and a process of its own.
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
    start_time : float
        Seconds.
    events : {"raise", "ignore"}
        What python-control's own simulation, which handles none, is to do where a model-exchange FMU has events.
        :func:`simulate` runs them in any diagram.

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
    >>> block = import_fmu(Fmu("drone.fmu", parameters={"mass": 1.2}), kind="me")   # doctest: +SKIP
    >>> simulate(ct.interconnect([block, controller]), timepts, inputs)             # doctest: +SKIP
    >>> ct.input_output_response(block, timepts, inputs, block.start_state)       # doctest: +SKIP
    >>> engine = sampled_block(import_fmu("engine.fmu", kind="cs", step=0.01))      # doctest: +SKIP
    >>> simulate(ct.interconnect([engine, shaft]), timepts, inputs)                 # doctest: +SKIP
    """
    if kind not in (None, "me", "cs", "se"):
        raise ValueError(f'kind: expected "me", "cs" or "se", got {kind!r}')
    if events not in ("raise", "ignore"):
        raise ValueError(f'events: expected "raise" or "ignore", got {events!r}')
    chosen = Fmu.of(fmu)
    unpacked = UnpackedFmu(chosen)
    description = unpacked.description
    try:
        if kind is None:
            continuous = "me" in description.kinds and not (
                description.event_indicators and "cs" in description.kinds
            )
            kind = "me" if continuous else "cs" if "cs" in description.kinds else "se"
        label = name or re.sub(r"\W", "_", description.name)
        refuse_unknown(description, chosen.parameters)
        if kind == "me":
            return FmuModel(
                unpacked,
                name=label,
                parameters=unpacked.values,
                start_time=start_time,
                tolerance=chosen.tolerance,
                events=events,
                outputs=chosen.outputs,
                clocks=chosen.clocks,
            )
        dt = step or description.communication_step
        if dt is None or not 0.0 < dt < np.inf:
            raise ValueError(f"{chosen.path}: step: expected seconds > 0, got {dt}; the FMU names none")
        return FmuSteps(
            unpacked,
            name=label,
            step=dt,
            parameters=unpacked.values,
            start_time=start_time,
            tolerance=chosen.tolerance,
            outputs=chosen.outputs,
            kind=kind,
            clocks=chosen.clocks,
        )
    except BaseException:
        unpacked.close()
        raise
