"""What an FMU can do as model exchange, in co-simulation or in scheduled execution."""

from __future__ import annotations

import math
from dataclasses import dataclass

import lxml.etree as etree

from .._intake import check_name

__all__ = ["FmuKind", "read_kind"]


@dataclass(frozen=True)
class FmuKind:
    """Capabilities of an FMU in one of its kinds.

    Parameters
    ----------
    identifier : str
        Stem of the binary's name.
    state : bool
        Its state can be taken and put back (needed for a rollback).
    serialize : bool
    directional_derivatives, adjoint_derivatives : bool
    variable_step : bool
        Co-simulation only: communication steps may differ.
    interpolates : bool
        Co-simulation of FMI 2.0 only: inputs may have slopes.
    fixed_step : float or None
        Communication steps must be multiples of this.
    needs_tool : bool
        It only runs beside the tool that made it.
    once_per_process : bool
        It has global data: two instances would share it.
    completed_step : bool
        Model exchange only: it is to be told of each completed step of integration.
    event_mode : bool
        Co-simulation of FMI 3.0 only: it has Event Mode, and stops at events for it.
    intermediate_update : bool
        Co-simulation of FMI 3.0 only: it tells of its variables inside steps.
    """

    identifier: str
    state: bool = False
    serialize: bool = False
    directional_derivatives: bool = False
    adjoint_derivatives: bool = False
    variable_step: bool = True
    interpolates: bool = False
    fixed_step: float | None = None
    needs_tool: bool = False
    once_per_process: bool = False
    completed_step: bool = True
    event_mode: bool = False
    intermediate_update: bool = False

    def __str__(self) -> str:
        words = {
            "state": self.state,
            "serialized state": self.serialize,
            "directional derivatives": self.directional_derivatives,
            "adjoint derivatives": self.adjoint_derivatives,
            "variable step": self.variable_step,
            "needs its tool": self.needs_tool,
            "event mode": self.event_mode,
            "intermediate update": self.intermediate_update,
            "one instance per process": self.once_per_process,
        }
        return ", ".join(word for word, has in words.items() if has) or "no options"


def read_kind(element: etree._Element) -> FmuKind:
    """Capabilities from the XML itself: fmpy drops some of FMI 3.0's.

    Parameters
    ----------
    element : Element
        ``ModelExchange``, ``CoSimulation`` or ``ScheduledExecution``.

    Raises
    ------
    ValueError
        If the model identifier, of which the path of the binary is made, is no plain name; if the fixed internal step
        is no positive number that divides a second into less than 2^53 steps.
    """

    def flag(*names: str) -> bool:
        return any(element.get(name) in ("true", "1") for name in names)

    fixed = element.get("fixedInternalStepSize")
    if fixed is not None and not 2.0**-53 < float(fixed) < math.inf:
        raise ValueError(
            f"{element.tag}: fixedInternalStepSize: expected seconds between 2^-53 and infinity, got {fixed}"
        )
    return FmuKind(
        identifier=check_name(element.get("modelIdentifier", ""), f"{element.tag}: modelIdentifier"),
        state=flag("canGetAndSetFMUstate", "canGetAndSetFMUState"),
        serialize=flag("canSerializeFMUstate", "canSerializeFMUState"),
        directional_derivatives=flag("providesDirectionalDerivative", "providesDirectionalDerivatives"),
        adjoint_derivatives=flag("providesAdjointDerivatives"),
        variable_step=flag("canHandleVariableCommunicationStepSize") or element.tag == "ScheduledExecution",
        interpolates=flag("canInterpolateInputs"),
        fixed_step=None if fixed is None else float(fixed),
        needs_tool=flag("needsExecutionTool"),
        once_per_process=flag("canBeInstantiatedOnlyOncePerProcess"),
        completed_step=not flag("completedIntegratorStepNotNeeded")
        and element.get("needsCompletedIntegratorStep") not in ("false", "0"),
        event_mode=flag("hasEventMode"),
        intermediate_update=flag("providesIntermediateUpdate"),
    )
