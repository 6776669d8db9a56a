"""What is co-simulated: parts and their wiring, of a package, of a cut diagram or written down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Literal

import control as ct

from .._renamed import former_field
from .cosimulation_wiring import Connection, Wire, parameters_by_part, refuse_ill_formed
from .fmu import Fmu
from .inspect import Scalar

__all__ = ["Participant", "System"]

Participant = str | Path | Fmu | ct.InputOutputSystem

_UNITS = ("raise", "convert", "warn", "ignore")


@dataclass(frozen=True, eq=False)
class System:
    """Parts and the wires between them: what :func:`cosimulate` runs and :func:`write_ssp` writes.

    :func:`read_ssp` reads one from a package, :func:`cut_diagram` cuts one out of a diagram.

    Parameters
    ----------
    parts : dict of str to str, Path, Fmu or control.InputOutputSystem
        FMU files (co-simulation; one with model exchange only is integrated here, with its events), blocks from
        :func:`import_fmu` (each run makes a new instance), or python-control systems.
    connections : sequence of tuple of str, or of Wire
        ``(input, output, ...)`` as in ``ct.interconnect``: ``("plant.f[0]", "controller.u[0]")``; several outputs are
        summed, ``"-part.y"`` is subtracted, ``"plant.f"`` stands for all its elements. String and Binary outputs go to
        inputs of their own type as they are. A triggered input clock ticks with the output clock that it is wired to:
        at the same communication point, or at the end of the step in which that one ticked.
    inputs : dict of str to sequence of str or Wire, optional
        Names of the whole's inputs and each ``part.input`` that they drive.
    outputs : dict of str to str, optional
        Names of the whole's outputs and the ``part.output`` behind each.
    parameters : dict of str to number, text or bytes, optional
        Parameters and start values by ``part.name``; they count before those of an :class:`Fmu`.
    units : {"raise", "convert", "warn", "ignore"}
        Where a wire joins different units; those of one dimension can be converted, by the factors and offsets that the
        FMUs define or their names say. Packages convert as SSP has it.

    Raises
    ------
    TypeError
        For a part of another kind.
    ValueError
        Without parts; for a connection that is none, a parameter of no part, another choice of units.

    Examples
    --------
    >>> system = System({"plant": "plant.fmu", "law": "law.fmu"}, [("plant.u", "law.u"), ("law.e", "-plant.y")])
    >>> list(system.parts), len(system.connections)
    (['plant', 'law'], 2)
    """

    parts: Mapping[str, Participant]
    connections: Sequence[Connection | Wire] = ()
    _: KW_ONLY
    inputs: Mapping[str, Sequence[str | Wire]] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, Scalar] = field(default_factory=dict)
    units: Literal["raise", "convert", "warn", "ignore"] = "raise"

    def __post_init__(self) -> None:
        for name in ("parts", "inputs", "outputs", "parameters"):
            given = {} if getattr(self, name) is None else getattr(self, name)
            if not isinstance(given, Mapping) or not all(isinstance(key, str) for key in given):
                raise TypeError(f"{name}: expected a dict by name, got {given!r}")
            object.__setattr__(self, name, dict(given))
        if not self.parts:
            raise ValueError("parts: expected at least one")
        for name, part in self.parts.items():
            if not isinstance(part, str | Path | Fmu | ct.InputOutputSystem):
                raise TypeError(
                    f"{name}: expected an FMU file, an imported FMU or a python-control system, got {type(part)}"
                )
        object.__setattr__(self, "connections", tuple(self.connections or ()))
        refuse_ill_formed(self.connections)
        driven = {label: (s,) if isinstance(s, str | Wire) else tuple(s) for label, s in self.inputs.items()}
        for label, sinks in driven.items():
            if not all(isinstance(sink, str | Wire) for sink in sinks):
                raise TypeError(f'inputs: {label!r}: expected ["part.input", ...], got {sinks!r}')
        object.__setattr__(self, "inputs", driven)
        for label, source in self.outputs.items():
            if not isinstance(source, str):
                raise TypeError(f'outputs: {label!r}: expected "part.output", got {source!r}')
        parameters_by_part(list(self.parts), self.parameters)
        if self.units not in _UNITS:
            raise ValueError(f"units: expected one of {', '.join(_UNITS)}, got {self.units!r}")

    @property
    def wires(self) -> Sequence[Connection | Wire]:
        """The connections, by their name of 0.2."""
        return former_field(self, "wires", "connections")

    @property
    def ends(self) -> dict[str, tuple[Wire, ...]]:
        """What each of the whole's inputs drives, as wires without a source."""
        return {
            label: tuple(sink if isinstance(sink, Wire) else Wire(sink, "") for sink in sinks)
            for label, sinks in self.inputs.items()
        }
