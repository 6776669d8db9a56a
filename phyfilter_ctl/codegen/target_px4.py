"""What an external module of PX4 says of a filter: its parameters, one or two for each pole."""

from __future__ import annotations

import re

import control as ct
from numpy.typing import ArrayLike

from ..diagram import FlatModel
from ..filter import SampledPhyFilter

__all__ = ["check_px4", "px4_values"]

_AXES = 3
_PREFIX = 6  # letters of the 16 that the name of a parameter has
_SHORT = 9  # letters of the name of a debug vector
_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z][a-z0-9]*)*")


def check_px4(
    system: ct.InputOutputSystem | FlatModel | SampledPhyFilter,
    name: str,
    channels: int | None,
    inertia: ArrayLike | str | None,
) -> None:
    """Refuse what a module on the velocity of a vehicle cannot be made from.

    Raises
    ------
    ValueError
        If it is no low-pass filter of three channels with unit inertia, or the name is none that PX4 takes.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> check_px4(PhyFilter([20.0]).sampled(0.004), "wind", 3, None)
    """
    if not _NAME.fullmatch(name):
        raise ValueError(f"name: PX4 takes small letters, digits and single underscores, got {name!r}")
    if not isinstance(system, SampledPhyFilter) or system.E is not None or len(set(system.filters)) > 1:
        raise ValueError("px4: expected one sampled filter for all axes, without directions E")
    lowpass = system.filters[0]
    if lowpass.b[0] != lowpass.a[0] or lowpass.b[1:].any():
        raise ValueError("px4: expected a low-pass filter, b = (a0, 0, ..., 0): its poles become parameters")
    if channels not in (None, _AXES) or (channels is None and len(system.filters) not in (1, _AXES)):
        raise ValueError(f"px4: the velocity has {_AXES} channels, got channels={channels}")
    if inertia is not None:
        raise ValueError("px4: the module works per unit of mass; leave the inertia out")


def px4_values(sampled: SampledPhyFilter, name: str, c_files: list[str]) -> dict[str, str]:
    """What the templates of the module leave open.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> values = px4_values(PhyFilter([20.0]).sampled(0.004), "wind_speed", ["wind_speed.c"])
    >>> values["Name"], values["PREFIX"]
    ('WindSpeed', 'WINDSP')
    """
    prefix = name.replace("_", "").upper()[:_PREFIX]
    poles = [complex(pole) for pole in sampled.filters[0].poles if pole.imag >= 0.0]
    definitions, members, tune, at = [], [], [], 0
    for i, pole in enumerate(poles):
        parts = {"r": pole.real} if pole.imag == 0.0 else {"r": pole.real, "i": pole.imag}
        for part, value in parts.items():
            meaning = "real" if part == "r" else "imaginary"
            definitions.append(
                f"      {prefix}_P{i}{part.upper()}:\n"
                f'        description: {{short: "Pole {i}, {meaning} part"}}\n'
                f"        type: float\n        unit: rad/s\n        default: {value!r}"
            )
            members.append(f"\t\t(ParamFloat<px4::params::{prefix}_P{i}{part.upper()}>) _p{i}_{part},")
        real = f"(double)_p{i}_r.get()"
        imaginary = f"(double)_p{i}_i.get()" if "i" in parts else "0.0"
        tune.append(f"\tconst double p{i}[2] = {{{real}, {imaginary}}};")
        tune.append(f"\ttuning.poles[0][{at}][0] = p{i}[0];\n\ttuning.poles[0][{at}][1] = p{i}[1];")
        if "i" in parts:
            tune.append(
                f"\ttuning.poles[0][{at + 1}][0] = p{i}[0];\n\ttuning.poles[0][{at + 1}][1] = -p{i}[1];"
            )
        tune.append(f"\ta0 *= {f'p{i}[0] * p{i}[0] + p{i}[1] * p{i}[1]' if 'i' in parts else f'-p{i}[0]'};")
        at += len(parts)
    return {
        "Name": "".join(word.capitalize() for word in name.split("_")),
        "PREFIX": prefix,
        "short": name[:_SHORT],
        "px4_sources": "\n".join(f"\t\t{file}" for file in c_files),
        "px4_poles": "\n".join(definitions),
        "px4_members": "\n".join(members),
        "px4_tune": "\n".join(tune),
    }
