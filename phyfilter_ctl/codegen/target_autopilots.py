"""What modules for autopilots say of a filter on the velocity: its parameters, one or two for each pole."""

from __future__ import annotations

import re

import control as ct
from numpy.typing import ArrayLike

from ..diagram import FlatModel
from ..filter import SampledPhyFilter
from .filter_guard import guard_stack

__all__ = ["autopilot_values", "check_autopilot"]

_AXES = 3
_PREFIX = 6  # letters of the 16 that the name of a parameter has
_SHORT = 9  # letters of the name of a debug vector of PX4, or of a group of the Crazyflie's parameters
_LOG = 4  # letters of a message in ArduPilot's log, whose own names (RATE, ...) do not begin with PF
_TICKS = 1000  # a second of the Crazyflie's controller
# Bytes of stack of what runs it: PX4's work queue nav_and_controllers, the Crazyflie's stabilizer (450 words); and
# those that the module itself and its callers take.
_STACKS, _CALLERS = {"px4": 2240, "crazyflie": 1800}, 400
_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z][a-z0-9]*)*")


def check_autopilot(
    target: str,
    system: ct.InputOutputSystem | FlatModel | SampledPhyFilter,
    name: str,
    channels: int | None,
    inertia: ArrayLike | str | None,
) -> None:
    """Refuse what a module on the velocity of a vehicle cannot be made from.

    Raises
    ------
    ValueError
        If it is no low-pass filter of three channels with unit inertia, or name, rate or order are none that the target
        takes.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> check_autopilot("px4", PhyFilter([20.0]).sampled(0.004), "wind", 3, None)
    """
    if not _NAME.fullmatch(name):
        raise ValueError(f"name: {target} takes small letters, digits and single underscores, got {name!r}")
    if not isinstance(system, SampledPhyFilter) or system.E is not None or len(system.filters) != 1:
        raise ValueError(
            f"{target}: expected one sampled filter that all axes share, without directions E: its poles become "
            "parameters"
        )
    lowpass = system.filters[0]
    if lowpass.b[0] != lowpass.a[0] or lowpass.b[1:].any():
        raise ValueError(
            f"{target}: expected a low-pass filter, b = (a0, 0, ..., 0): its poles become parameters"
        )
    if channels not in (None, _AXES):
        raise ValueError(f"{target}: the velocity has {_AXES} channels, got channels={channels}")
    if inertia is not None:
        raise ValueError(
            f"{target}: the module works per unit of mass; leave the inertia out, of the call and of the filter"
        )
    stack, room = guard_stack(system.order), _STACKS.get(target)
    if room is not None and stack > room - _CALLERS:
        raise ValueError(
            f"{target}: order {system.order} takes up to {stack:,} bytes of stack where {room:,} are for all; "
            "lower the order"
        )
    rate = 1.0 / system.dt
    if target == "crazyflie" and (abs(rate - round(rate)) > 1e-6 * rate or _TICKS % round(rate)):
        raise ValueError(f"crazyflie: expected a rate that divides {_TICKS} Hz, got dt = {system.dt:g} s")


def autopilot_values(sampled: SampledPhyFilter, name: str, c_files: list[str]) -> dict[str, str]:
    """What the templates of the modules leave open.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> values = autopilot_values(PhyFilter([20.0]).sampled(0.004), "wind_speed", ["wind_speed.c"])
    >>> values["Name"], values["PREFIX"]
    ('WindSpeed', 'WINDSP')
    """
    prefix = name.replace("_", "").upper()[:_PREFIX]
    poles = [complex(pole) for pole in sampled.filters[0].poles if pole.imag >= 0.0]
    parts = {
        f"p{i}{part}": value
        for i, pole in enumerate(poles)
        for part, value in (("r", pole.real), ("i", pole.imag))
        if part == "r" or value != 0.0
    }
    camel = "".join(word.capitalize() for word in name.split("_"))
    return {
        "Name": camel,
        "PREFIX": prefix,
        "short": name[:_SHORT],
        "rate": str(round(1.0 / sampled.dt)),
        "log": f"PF{prefix}"[:_LOG],
        "ardupilot_count": str(len(parts)),
        "ardupilot_members": "\n".join(f"    AP_Float _{part};" for part in parts),
        "ardupilot_poles": ", ".join(f"_{part}.get()" for part in parts),
        "ardupilot_info": "\n\n".join(
            f"    // @Param: {part.upper()}\n"
            f"    // @DisplayName: Pole {part[1:-1]}, {'real' if part[-1] == 'r' else 'imaginary'} part\n"
            f"    // @Units: rad/s\n"
            f'    AP_GROUPINFO("{part.upper()}", {5 + i}, AC_CustomControl_{camel}, _{part}, {value!r}f),\n'
            for i, (part, value) in enumerate(parts.items())
        ),
        "ardupilot_tune": _tune(poles, "    ", "(double)_{}.get()"),
        "order": str(sampled.filters[0].order),
        "poles_real": ", ".join(repr(complex(pole).real) for pole in sampled.filters[0].poles),
        "poles_imag": ", ".join(repr(complex(pole).imag) for pole in sampled.filters[0].poles),
        "px4_sources": "\n".join(f"\t\t{file}" for file in c_files),
        "px4_poles": "\n".join(
            f"      {prefix}_{part.upper()}:\n"
            f'        description: {{short: "Pole {part[1:-1]}, {"real" if part[-1] == "r" else "imaginary"} part"}}\n'
            f"        type: float\n        unit: rad/s\n        default: {value!r}"
            for part, value in parts.items()
        ),
        "px4_members": "\n".join(
            f"\t\t(ParamFloat<px4::params::{prefix}_{part.upper()}>) _{part}," for part in parts
        ),
        "px4_tune": _tune(poles, "\t", "(double)_{}.get()"),
        "kbuild": "\n".join(f"obj-y += {file[:-2]}.o" for file in c_files),
        "crazyflie_poles": "\n".join(f"static float {part} = {value!r}f;" for part, value in parts.items()),
        "crazyflie_params": "\n".join(f"PARAM_ADD(PARAM_FLOAT, {part}, &{part})" for part in parts),
        "crazyflie_tune": _tune(poles, "  ", "(double){}"),
    }


def _tune(poles: list[complex], indent: str, read: str) -> str:
    """Statements that put the poles of the parameters into ``tuning`` and their product into ``a0``."""
    lines, at = [], 0
    for i, pole in enumerate(poles):
        pair = pole.imag != 0.0
        lines.append(f"const double re{i} = {read.format(f'p{i}r')};")
        if pair:
            lines.append(f"const double im{i} = {read.format(f'p{i}i')};")
        for sign in ("", "-")[: 1 + pair]:
            lines.append(f"tuning.poles[0][{at}][0] = re{i};")
            lines += [f"tuning.poles[0][{at}][1] = {sign}im{i};"] if pair else []
            at += 1
        lines.append(f"a0 *= {f're{i} * re{i} + im{i} * im{i}' if pair else f'-re{i}'};")
    return "\n".join(indent + line for line in lines)
