"""By which symbol a block is drawn, and what is written in it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..blocks import PhyFilterBlock, SampledBlock
from .marks import Direction
from .names import number, polynomial

__all__ = [
    "Box", "Pin", "Symbol", "common_unit", "filter_note", "gain_symbol", "rate_note", "symbol_of", "units_of",
]  # fmt: skip

FloatArray = NDArray[np.float64]
_ORDER = 4  # of a transfer function that is written out
_NOISE = 1e-9  # of the largest coefficient: what conversions leave
_AXIS = np.linspace(-1.0, 1.0, 61)  # of a characteristic
_REACHES = [
    digit * 10.0**decade for decade in range(-3, 5) for digit in (1.0, 2.0, 5.0)
]  # ranges of its input
_BEND, _CLEAR = (
    1e-3,
    0.3,
)  # what a straight line may be off, of its range; how much of the largest bend is shown


class Pin(NamedTuple):
    """An input or output of a part: the name that is drawn, labels of the system, full names, entries, sign, unit."""

    name: str
    labels: tuple[str, ...]
    signals: tuple[str, ...]
    size: int
    sign: int = 1
    unit: str = ""


class Symbol(NamedTuple):
    """Kind of a node, its lines of text, a note below, signs of inputs, gain, characteristic in [-1, 1]."""

    kind: str
    lines: tuple[str, ...] = ()
    note: str = ""
    signs: tuple[int, ...] = ()
    gain: float | None = None
    curve: tuple[tuple[float, float], ...] = ()
    period: float = 0.0


@dataclass(frozen=True)
class Box:
    """A block by its name, labels, symbol, and units by label."""

    name: str
    input_labels: tuple[str, ...]
    output_labels: tuple[str, ...]
    symbol: Symbol
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def ninputs(self) -> int:
        return len(self.input_labels)

    @property
    def noutputs(self) -> int:
        return len(self.output_labels)


def gain_symbol(factor: float) -> Symbol:
    """Of a constant factor."""
    return Symbol("gain", (number(factor),), gain=factor)


def symbol_of(block: Any, inputs: Sequence[Pin], outputs: Sequence[Pin]) -> Symbol:
    """Of a block of a diagram.

    Parameters
    ----------
    block : control.InputOutputSystem
    inputs, outputs : sequence of Pin
        Its vectors.

    Returns
    -------
    Symbol
    """
    import control as ct

    if isinstance(block, Box):
        return block.symbol
    period = float(getattr(block, "period", 0.0) or (block.dt if block.dt not in (None, 0, True) else 0.0))
    inside = getattr(block, "system", None)
    found = _symbol(
        inside if inside is not None and isinstance(block, SampledBlock) else block, inputs, outputs
    )
    if isinstance(block, SampledBlock) and block.filter is not None:
        found = Symbol("filter", note=filter_note(block.filter.sampled.filters))
    elif isinstance(block, PhyFilterBlock):
        found = Symbol("filter", note=_bandwidth(np.asarray(block.A), block.dt or 0.0, block.noutputs))
    elif isinstance(block, ct.InterconnectedSystem):
        found = Symbol("diagram")
    notes = [found.note] if found.note else []
    return found._replace(note=", ".join([*notes, rate_note(period)] if period else notes), period=period)


def common_unit(units: Iterable[str]) -> str:
    """The one that all have; "" where there are several, or one has none."""
    found = set(units)
    return found.pop() if len(found) == 1 else ""


def units_of(block: Any, direction: Direction) -> list[str]:
    """Units of a block's inputs or outputs, as far as it, or what is inside it, knows them.

    Parameters
    ----------
    block : control.InputOutputSystem or Box
    direction : {"in", "out"}

    Returns
    -------
    list of str
        One a signal; "" where none is known.
    """
    import control as ct

    labels = block.input_labels if direction == "in" else block.output_labels
    if isinstance(block, ct.InterconnectedSystem):
        inside = [unit for part in block.syslist for unit in units_of(part, direction)]
        table = np.asarray(block.input_map).T if direction == "in" else np.asarray(block.output_map)
        ends = [(row[: len(inside)], np.flatnonzero(row[: len(inside)])) for row in table]
        return [common_unit(inside[j] for j in at) if (row[at] == 1.0).all() else "" for row, at in ends]
    known = getattr(block, "functions", None) or getattr(block, "law", None)
    variables = getattr(known, f"{direction}puts", ())
    units = block.units if isinstance(block, Box) else {entry.name: entry.unit for entry in variables}
    return [units.get(label, "") for label in labels]


def rate_note(period: float) -> str:
    """Of seconds between the instants of a block."""
    return f"T = {number(period * 1e3, 4)} ms" if period < 1 else f"T = {number(period, 4)} s"


def _symbol(block: Any, inputs: Sequence[Pin], outputs: Sequence[Pin]) -> Symbol:
    import control as ct

    mark = getattr(block, "symbol", "")
    if mark:
        kind, *lines = mark.split("\n")
        return Symbol(kind, tuple(lines))
    if isinstance(block, ct.StateSpace) and not block.nstates and len(outputs) == 1:
        found = _static(np.asarray(block.D, float), inputs, outputs[0].size)
        if found is not None:
            return found
    if isinstance(block, ct.StateSpace | ct.TransferFunction) and block.ninputs == block.noutputs == 1:
        return _fraction(block)
    if block.ninputs == block.noutputs == 1 and not block.nstates and not isinstance(block, ct.StateSpace):
        curve = _characteristic(block)
        if curve:
            return Symbol("curve", curve=curve)
    return Symbol("block")


def _static(D: FloatArray, inputs: Sequence[Pin], size: int) -> Symbol | None:
    """A sum, or a gain, if all its blocks are a number times I."""
    if any(pin.size != size for pin in inputs):
        return None
    parts = [D[:, k * size : (k + 1) * size] for k in range(len(inputs))]
    if any(not np.array_equal(part, part[0, 0] * np.eye(size)) for part in parts):
        return None
    gains = [float(part[0, 0]) for part in parts]
    if len(gains) == 1:
        return gain_symbol(gains[0])
    return Symbol("sum", signs=tuple(int(g) for g in gains)) if all(abs(g) == 1.0 for g in gains) else None


def _fraction(block: Any) -> Symbol:
    import control as ct

    if isinstance(block, ct.StateSpace) and block.nstates > _ORDER:
        return Symbol("block", note=f"{block.nstates} states")
    function = block if isinstance(block, ct.TransferFunction) else ct.ss2tf(block)
    numerator, denominator = (
        _cleaned(np.asarray(part[0][0], float)) for part in (function.num, function.den)
    )
    if max(len(numerator), len(denominator)) > _ORDER + 1 or not denominator.any():
        return Symbol("block", note=f"order {len(denominator) - 1}")
    if len(numerator) == len(denominator) == 1:
        return gain_symbol(float(numerator[0] / denominator[0]))
    variable = "z" if block.dt else "s"
    lines = polynomial(numerator.tolist(), variable), polynomial(denominator.tolist(), variable)
    if block.dt and lines[0] == "1" and not denominator[1:].any() and denominator[0] == 1.0:
        return Symbol("delay", (f"z^−{len(denominator) - 1}",))
    return Symbol("integrator" if lines == ("1", "s") else "fraction", lines)


def _cleaned(coefficients: FloatArray) -> FloatArray:
    """Without what rounding left, and without leading zeros."""
    small = abs(coefficients) < _NOISE * abs(coefficients).max(initial=0.0)
    trimmed = np.trim_zeros(np.where(small, 0.0, coefficients), "f")
    return trimmed if len(trimmed) else np.zeros(1)


def filter_note(filters: Sequence[Any]) -> str:
    """Orders and slowest poles of filters."""
    orders = sorted({entry.order for entry in filters})
    return _about(orders, sorted({float(abs(entry.poles[0])) for entry in filters}))


def _about(orders: Sequence[int], rates: Sequence[float]) -> str:
    span = [number(rates[0])] if rates[0] == rates[-1] else [number(rates[0]), number(rates[-1])]
    return f"order {', '.join(map(str, orders))}, {' … '.join(span)} rad/s"


def _bandwidth(A: FloatArray, dt: float, channels: int) -> str:
    poles = np.linalg.eigvals(A) if A.size else np.zeros(0)
    if dt:
        poles = np.log(poles[abs(poles) > _NOISE].astype(complex)) / dt
    rates = abs(poles)
    return _about([len(A) // channels], sorted(rates.tolist())[:1]) if len(rates) else ""


def _characteristic(block: Any) -> tuple[tuple[float, float], ...]:
    """Of a function of one signal, where it begins to bend; none where it cannot be had or is straight."""

    def values(inputs: FloatArray) -> FloatArray:
        with np.errstate(all="ignore"):
            found = [float(np.squeeze(block.output(0.0, np.zeros(0), np.array([u])))) for u in inputs]
        if not np.isfinite(found).all():
            raise ValueError("not finite")
        return np.array(found)

    try:
        wide = 10.0 ** (np.arange(-18, 31) / 6.0)
        u = np.concatenate([-wide[::-1], [0.0], wide])
        y = values(u)
        bends = {reach: _bend(np.interp(reach * _AXIS, u, y)) for reach in _REACHES}
        most = max(bends.values())
        if most < _BEND:
            return ()
        reach = next(reach for reach, bend in bends.items() if bend > _CLEAR * most)
        y = values(reach * _AXIS)
    except Exception:  # a block's own function: whatever it raises, its characteristic is not known
        return ()
    return tuple(zip(_AXIS.tolist(), (y / max(abs(y).max(), 1e-30)).tolist(), strict=True))


def _bend(y: FloatArray) -> float:
    """How far a characteristic is from a straight line, of its range."""
    line = np.polyval(np.polyfit(_AXIS, y, 1), _AXIS)
    return float(abs(y - line).max() / np.ptp(y)) if np.ptp(y) else 0.0
