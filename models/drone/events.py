"""What goes wrong in flight: the payload drops, a motor turns weak."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from phyfilter_ctl.blocks import FunctionBlock, Variable

__all__ = ["EVENTS", "with_events"]

_OWN = (
    Variable("drop_time", 1e9, unit="s", description="from which on the added mass is gone"),
    Variable("weak_time", 1e9, unit="s", description="from which on the first motor is weak"),
    Variable("weak", 1.0, description="share of the commanded thrust that it then gives"),
)
EVENTS = tuple(f"vehicle.quadrotor.{entry.name}" for entry in _OWN)
"""Parameters of the closed loop that make :func:`~.experiment.fly` fly a vehicle with events."""


def with_events(vehicle: FunctionBlock) -> FunctionBlock:
    """The vehicle with the parameters drop_time, weak_time and weak.

    Parameters
    ----------
    vehicle : FunctionBlock
        With a parameter ``added_mass`` and an input ``thrust[0]``.
    """
    law = vehicle.functions
    names = [entry.name for entry in law.parameters], [entry.name for entry in law.inputs]
    mass, motor = names[0].index("added_mass"), names[1].index("thrust[0]")
    t, x = ca.SX.sym("t"), ca.SX.sym("x", len(law.states))
    u, p = ca.SX.sym("u", len(law.inputs)), ca.SX.sym("p", len(law.parameters) + len(_OWN))
    drop_time, weak_time, weak = ca.vertsplit(p[len(law.parameters) :])
    now, acting = ca.SX(p[: len(law.parameters)]), ca.SX(u)
    now[mass] = ca.if_else(t < drop_time, p[mass], 0.0)
    acting[motor] = ca.if_else(t < weak_time, 1.0, weak) * u[motor]
    dynamics, output = (
        ca.Function(name, [t, x, u, p], [function(t, x, acting, now)])
        for name, function in (("dynamics", law.dynamics), ("output", law.output))
    )
    return FunctionBlock(
        replace(law, parameters=(*law.parameters, *_OWN), dynamics=dynamics, output=output), vehicle.name
    )
