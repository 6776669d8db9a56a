"""What a check of an FMU tries out: its state put back, its dependencies, its derivatives."""

from __future__ import annotations

import numpy as np

from .._sections import FloatArray
from .check_report import Checker
from .instance import FmuInstance
from .signals import Signals

__all__ = ["dependencies", "derivatives", "round_trip"]

_PROBES = 4
# Central differences with a step of 1e-5 of a value of order one: truncation about 1e-10, rounding about 1e-11.
_DIFFERENCE, _DERIVATIVES_AGREE = 1e-5, 1e-6
_ADJOINT = 1e-9  # of the sum of sizes: both kinds of derivatives are exact but for rounding
_FLOATS = ("Float64", "Float32")


def _movable(instance: FmuInstance) -> Signals:
    """Inputs that may take any value now: discrete ones of model exchange are for event mode."""
    entries = [
        entry
        for entry in instance.description.of("input")
        if entry.type in _FLOATS and (instance.kind == "cs" or entry.variability == "continuous")
    ]
    return Signals(entries, instance.description.fmi)


def _within(instance: FmuInstance, signals: Signals, values: FloatArray) -> FloatArray:
    """Values brought into the range that the FMU says it takes."""
    entries = {label: entry for entry in instance.description.variables for label in entry.labels}
    ranges = [(entries[label].minimum, entries[label].maximum) for label in signals.labels]
    low = np.array([-np.inf if least is None else least for least, _ in ranges])
    high = np.array([np.inf if most is None else most for _, most in ranges])
    return np.clip(values, low, high)


def round_trip(checker: Checker, instance: FmuInstance, t0: float, h: float) -> None:
    """Take the state, run on, put it back, and run on again: the same bits.

    Parameters
    ----------
    checker : Checker
    instance : FmuInstance
        For co-simulation, initialised.
    t0, h : float
        Seconds.
    """
    outputs, inputs = instance.signals("output"), _movable(instance)
    rng = np.random.default_rng(0)
    drive = _within(instance, inputs, inputs.read(instance) + 0.1 * rng.standard_normal((20, len(inputs))))

    def run(first: int, last: int) -> FloatArray:
        rows = []
        for k in range(first, last):
            inputs.write(instance, drive[k])
            instance.do_step(t0 + k * h, h, final=False)
            rows.append(outputs.read(instance))
        return np.array(rows)

    run(0, 10)
    state = instance.save()
    before = run(10, 20)
    instance.restore(state)
    after = run(10, 20)
    instance.forget(state)
    if not np.array_equal(before, after, equal_nan=True):
        worst = outputs.labels[int(np.argmax(np.max(np.abs(before - after), axis=0)))]
        checker.error(
            f"after the state was put back the rest of the run differs by {np.max(np.abs(before - after)):.3g} (in "
            f"{worst}); expected the same bits"
        )


def dependencies(checker: Checker, instance: FmuInstance) -> None:
    """Move one input at a time and see which outputs move, against what the model structure says.

    Parameters
    ----------
    checker : Checker
    instance : FmuInstance
        Initialised.
    """
    description = instance.description
    inputs, outputs = _movable(instance), instance.signals("output")
    owner = {label: entry.name for entry in description.variables for label in entry.labels}
    owners, results = [owner[label] for label in inputs.labels], [owner[label] for label in outputs.labels]
    start = inputs.read(instance)
    rng = np.random.default_rng(0)
    seen: set[tuple[str, str]] = set()
    for _ in range(_PROBES):
        base = _within(instance, inputs, start + rng.standard_normal(len(start)))
        inputs.write(instance, base)
        before = outputs.read(instance)
        for j, owner in enumerate(owners):
            inputs.write(instance, _within(instance, inputs, base + np.eye(len(base))[j]))
            moved = outputs.read(instance) != before
            seen |= {(result, owner) for result, m in zip(results, moved, strict=True) if m}
        inputs.write(instance, base)
    for result in dict.fromkeys(results):
        known = description.dependencies.get(result)
        for owner in dict.fromkeys(owners):
            if known is not None and (result, owner) in seen and owner not in known:
                checker.error(f"{result} depends on {owner}, which its dependencies leave out")
            elif known is not None and owner in known and (result, owner) not in seen:
                checker.hint(f"{result} is said to depend on {owner}; it did not move with it at once")


def derivatives(checker: Checker, instance: FmuInstance, t: float) -> None:
    """Directional derivatives along a random direction against central differences, adjoint ones against them.

    Parameters
    ----------
    checker : Checker
    instance : FmuInstance
        For model exchange, initialised.
    t : float
        Seconds.
    """
    description = instance.description
    by_name = {entry.name: entry for entry in description.variables}
    rates = [by_name[name] for name in description.dependencies if by_name[name].derivative_of]
    states = [by_name[entry.derivative_of] for entry in rates]
    inputs = [e for e in description.of("input") if e.type == "Float64" and e.variability == "continuous"]
    # An output that is a state or an input is known, and another name of one too: FMI defines no derivative of it.
    known = {entry.reference for entry in (*states, *inputs)}
    outputs = [
        entry
        for entry in description.of("output")
        if entry.type == "Float64" and entry.variability == "continuous" and entry.reference not in known
    ]
    unknowns = Signals([*rates, *outputs], description.fmi)
    if not len(unknowns):
        checker.hint("nothing has a derivative")
        return
    input_signals = Signals(inputs, description.fmi)
    n = description.states
    rng = np.random.default_rng(1)
    x, u = instance.states(), input_signals.read(instance)
    x = x + 0.1 * rng.standard_normal(n)
    u = u + 0.1 * rng.standard_normal(len(u))
    seed = rng.standard_normal(n + len(u))

    def at(scale: float) -> FloatArray:
        instance.set_point(t, x + scale * seed[:n])
        input_signals.write(instance, u + scale * seed[n:])
        return unknowns.read(instance)

    difference = (at(_DIFFERENCE) - at(-_DIFFERENCE)) / (2 * _DIFFERENCE)
    at(0.0)
    found = instance.directional(
        [*unknowns.references], [e.reference for e in [*states, *inputs]], seed, len(unknowns)
    )
    scale = 1.0 + np.abs(difference)
    worst = int(np.argmax(np.abs(found - difference) / scale)) if len(scale) else 0
    if len(scale) and np.abs(found - difference)[worst] > _DERIVATIVES_AGREE * scale[worst]:
        checker.error(
            f"directional derivative of {unknowns.labels[worst]}: {found[worst]:.6g}; differences give "
            f"{difference[worst]:.6g}"
        )
    if instance.ability.adjoint_derivatives:
        weights = rng.standard_normal(len(unknowns))
        references = [entry.reference for entry in [*states, *inputs]]
        back = instance.adjoint([*unknowns.references], references, weights, len(seed))
        if abs(back @ seed - weights @ found) > _ADJOINT * (
            np.abs(back) @ np.abs(seed) + np.abs(weights) @ np.abs(found)
        ):
            checker.error(
                f"adjoint derivatives give {back @ seed:.6g} where directional ones give {weights @ found:.6g}: one is "
                "not the other's transpose"
            )
