"""Runs in CasADi's virtual machine."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..diagram import FlatModel
from .adaptive import Control, Integrator, Leaps, StepError
from .arguments import Run
from .chains import Chain
from .flow import SAME_LENGTH, advance_flow, step_lengths, tables
from .limits import Budget, diverged, progress_bar
from .response import Method, Outcome
from .schedule import WINDOW, Nodes, Steps, nodes, steps_between
from .steps import Layout, advance_rk4, at_node, discrete_step, full_step, outputs_at, split_step, start_state

__all__ = [
    "Piece",
    "chattering_from",
    "discrete_pieces",
    "fixed_pieces",
    "run_adaptive",
    "run_pieces",
]

# Steps that show whether something chatters.
_DIAGNOSIS = 3000
_STIFF = (
    "The diagram is stiff or has a singularity there: try method='stiff', larger rtol and atol, or method='rk4' with a "
    "max_step you choose; max_steps and time_limit in limits= allow more"
)


class Piece(NamedTuple):
    """Steps of a run that one function takes."""

    step: ca.Function
    p: FloatArray
    data: FloatArray  # (S, n_d)
    rows: NDArray[np.intp]  # (S,) row of the record, -1 for none


def fixed_pieces(
    flat: FlatModel, run: Run, method: Literal["rk4", "exact"], max_step: float | None
) -> Iterator[Piece]:
    """RK4 or the exact flow, in steps no longer than ``max_step`` between nodes."""
    layout = Layout(flat)
    node = at_node(flat)
    for window in nodes(run.times, [task.period for task in flat.tasks]):
        for steps in steps_between(window, max_step):
            data = _data(layout, run, window, steps)
            rows = np.where(steps.first, window.row[steps.node], -1)

            def joined(advance: ca.Function, first: NDArray[np.bool_] = steps.first) -> ca.Function:
                return full_step(node, advance) if first.all() else split_step(node, advance, layout.node)

            if method == "rk4":
                yield Piece(joined(advance_rk4(flat)), run.parameters, data, rows)
                continue
            # The step of no length that ends a run is apart: the others often need one matrix alone.
            last = len(data) - int(len(data) > 1 and data[-1, 1] == 0.0)
            for part in (slice(last), slice(last, None)):
                if len(data[part]):
                    advance, p = _flowing(flat, run, data[part])
                    yield Piece(joined(advance), p, data[part], rows[part])


def _flowing(flat: FlatModel, run: Run, data: FloatArray) -> tuple[ca.Function, FloatArray]:
    """The exact step, and its parameters with a table for each length in the data, whose numbers are filled in."""
    lengths, data[:, Layout(flat).table] = step_lengths(data[:, 1], run.times)
    pattern, columns = tables(flat, run.parameters, lengths)
    capacity = 1 << (len(lengths) - 1).bit_length()
    columns = np.vstack([columns, np.zeros((capacity - len(columns), columns.shape[1]))])
    return advance_flow(flat, pattern.tobytes(), capacity), np.concatenate([run.parameters, columns.ravel()])


def discrete_pieces(flat: FlatModel, run: Run) -> Iterator[Piece]:
    """A discrete diagram: one step from time to time."""
    layout = Layout(flat)
    for start in range(0, len(run.times), WINDOW):
        rows = np.arange(start, min(start + WINDOW, len(run.times)))
        data = np.zeros((len(rows), layout.data))
        data[:, 0] = run.times[rows]
        data[:, layout.input(0)] = run.inputs[rows]
        yield Piece(discrete_step(flat), run.parameters, data, rows)


def run_pieces(
    flat: FlatModel,
    run: Run,
    pieces: Iterator[Piece],
    *,
    state: FloatArray | None = None,
    limits: Budget | None = None,
    progress: bool = False,
) -> tuple[Outcome, FloatArray]:
    """Run them one after another; stops where the state is no longer finite.

    Returns also what the steps record behind x and y, (N, more).
    """
    n_x, n_y = len(flat.states), len(flat.outputs)
    record: FloatArray | None = None
    state = start_state(flat, run.start) if state is None else state
    chain: Chain | None = None
    count, message, failed_at = 0, "", np.inf
    with progress_bar(run, progress) as bar:
        for step, p, data, rows in pieces:
            granted, refusal = limits.grant(len(data)) if limits is not None else (len(data), "")
            if refusal:
                failed_at = float(data[granted, 0])
                record = np.full((len(run.times), n_x + n_y), np.nan) if record is None else record
                message = (
                    f"{refusal} at t = {failed_at:.9g} s: a longer max_step or method='adaptive' needs fewer, "
                    "max_steps and time_limit in limits= allow more"
                )
                if not granted:
                    break
                data, rows = data[:granted], rows[:granted]
            if chain is None or chain.step is not step:
                chain = Chain(step, state if chain is None else chain.state, p)
            chain.p = p
            part = chain.run(data)
            if record is None:
                record = np.full((len(run.times), part.shape[1]), np.nan)
            wanted = rows >= 0
            record[rows[wanted]] = part[wanted]
            count += len(data)
            good = np.all(np.isfinite(part[wanted][:, :n_x]), axis=1)
            if not good.all() or not np.all(np.isfinite(chain.state)):
                times = data[wanted, 0][~good]
                failed_at = float(times[0]) if len(times) else float(data[-1, 0] + data[-1, 1])
                record[run.times >= failed_at] = np.nan
                message = diverged(flat, record[:, :n_x], failed_at)
            if message:
                break
            bar.update(float(data[-1, 0] - bar.n - run.times[0]))
    assert record is not None  # a run has at least one time
    outcome = Outcome(record[:, :n_x], record[:, n_x : n_x + n_y], count, message, failed_at)
    return outcome, record[:, n_x + n_y :]


def run_adaptive(
    flat: FlatModel,
    run: Run,
    *,
    control: Control,
    rtol: float,
    atol: float,
    max_step: float | None,
    limits: Budget,
    progress: bool,
) -> tuple[Outcome, Method]:
    """Steps with error control from one discontinuity to the next, and the method they ended with."""
    layout = Layout(flat)
    n_x, n_s, n_z = layout.sizes
    x = np.full((len(run.times), n_x), np.nan)
    z = np.zeros((len(run.times), n_z))
    y = np.full((len(run.times), len(flat.outputs)), np.nan) if flat.memories else None
    until = float(run.times[-1])
    integrator = Integrator(
        flat, run.parameters, limits, control=control, rtol=rtol, atol=atol, max_step=max_step, until=until
    )
    state = start_state(flat, run.start)
    chain = (
        Chain(at_node(flat), state, run.parameters)
        if flat.tasks or (flat.unknowns is not None and not flat.loops)
        else None
    )
    leaps = (
        Leaps(flat, integrator, run.parameters) if n_x and integrator.watch is None and y is None else None
    )
    failed_at, message = np.inf, ""
    with progress_bar(run, progress) as bar:
        try:
            state[:n_x] = integrator.begin(
                state[:n_x], state[n_x + n_s :], float(run.times[0]), run.inputs[0]
            )
        except StepError as error:
            assert y is not None
            return Outcome(x, y, 0, str(error), error.time), integrator.pair.method
        for window in nodes(run.times, [task.period for task in flat.tasks]):
            data = _data(layout, run, window, next(steps_between(window, None, size=len(window.due) + 1)))
            breaks = _breaks(layout, window, data)
            later = np.zeros(0, dtype=np.intp)
            place, passed = 0, False
            try:
                while place < len(breaks) - 1:
                    first, stop = breaks[place : place + 2]
                    if leaps is not None and not passed and leaps.size:
                        ready = min(leaps.size, _apart(breaks, place, data, integrator.longest))
                        taken, states = leaps.run(state, data[first : first + ready])
                        rows = window.row[first : first + taken]
                        x[rows[rows >= 0]], z[rows[rows >= 0]] = (
                            states[:taken][rows >= 0][:, part]
                            for part in (slice(n_x), slice(n_x + n_s, None))
                        )
                        # The node after the last step that was taken has been passed where a step was refused there.
                        state, passed = states[taken], taken < ready
                        place += taken
                        if taken or passed:
                            continue
                    place += 1
                    if chain is not None and not passed:
                        chain.state = state
                        chain.run(data[first : first + 1])
                        state = chain.state
                    passed = False
                    held = state[n_x + n_s :]
                    begin, end = float(window.times[first]), float(window.times[stop])
                    rows = window.row[first:stop]
                    rows = rows[rows >= 0]
                    z[rows] = held
                    later = rows[run.times[rows] > begin] if y is None or end == begin else rows
                    x[rows[: len(rows) - len(later)]] = state[:n_x]
                    u = data[first, layout.input(0)], data[stop - 1, layout.input(2)]
                    if y is not None and end == begin:
                        y[rows] = integrator.output(begin, state[:n_x], held, u[0])
                    if (n_x or y is not None) and end > begin:
                        count = integrator.steps
                        state[:n_x], x[later] = integrator.run(
                            state[:n_x], held, (begin, end), u, run.times[later]
                        )
                        z[later], state[n_x + n_s :] = integrator.held_inside, integrator.held
                        if leaps is not None and integrator.steps == count + 1:
                            leaps.encourage()
                        if y is not None:
                            y[later] = integrator.outputs_inside
            except StepError as error:
                x[later[: len(error.inside)]] = error.inside
                if y is not None and integrator.outputs_inside is not None:
                    y[later[: len(error.inside)]] = integrator.outputs_inside[: len(error.inside)]
                failed_at = error.time
                row = int(np.argmin(np.abs(run.times - failed_at)))
                same = abs(run.times[row] - failed_at) <= SAME_LENGTH * max(abs(failed_at), 1.0)
                last = integrator.last_outputs if same else None
                if y is not None and last is not None:
                    x[row], y[row] = integrator.x, last
                message = (
                    str(error) if error.advice is not None else f"{error}. {integrator.chattering or _STIFF}"
                )
                break
            bar.update(float(window.times[-1] - bar.n - run.times[0]))
    good = np.asarray(np.isfinite(x).all(axis=1))
    happened = () if integrator.watch is None else tuple(integrator.watch.declared)
    found = outputs_at(flat, run, x, z, good) if y is None else y
    outcome = Outcome(x, found, integrator.steps, message, failed_at, happened)
    return outcome, integrator.pair.method


def _apart(breaks: list[int], place: int, data: FloatArray, longest: float) -> int:
    """How many intervals from one node to the next follow a break, which one step each may pass."""
    first = breaks[place]
    ends = np.array(breaks[place + 1 : place + 1 + Leaps.MOST])
    good = (
        (ends == first + 1 + np.arange(len(ends)))
        & (data[ends - 1, 1] > 0.0)
        & (data[ends - 1, 1] <= longest)
    )
    return int(np.argmin(np.append(good, False)))


def chattering_from(flat: FlatModel, run: Run, t: float, x: FloatArray) -> str:
    """What chatters near a point where a run without sampled blocks was given up; "" for nothing."""
    if flat.tasks or not t < run.times[-1] or not np.all(np.isfinite(x)):
        return ""
    row = max(int(np.searchsorted(run.times, t, side="right")) - 1, 0)
    begin, end = run.times[row : row + 2]
    held = run.interpolation == "hold"
    ahead = run.inputs[row] if held else run.inputs[row + 1]
    here = run.inputs[row] + (t - begin) / (end - begin) * (ahead - run.inputs[row])
    held = start_state(flat, x)[len(x) :]
    integrator = Integrator(flat, run.parameters, Budget(_DIAGNOSIS), rtol=1e-6, atol=1e-9)
    try:
        integrator.run(x, held, (t, float(end)), (here, ahead), np.zeros(0))
    except StepError:
        return integrator.chattering
    return ""


def _breaks(layout: Layout, window: Nodes, data: FloatArray) -> list[int]:
    """Nodes at which integration starts anew: instants, and kinks and jumps of the inputs; and the end."""
    begin, end = data[:, layout.input(0)], data[:, layout.input(2)]
    length = np.diff(window.times)[:, None]
    new = np.array(window.due.any(axis=1))
    new[0] = True
    if layout.inputs and len(new) > 1:
        rate = (end - begin) / np.where(length > 0.0, length, 1.0)
        size = np.maximum(np.abs(begin[1:]), np.abs(end[1:])) + np.abs(end[:-1])
        # Rates differ by the rounding of the inputs and of the times.
        same = np.abs(rate[1:] - rate[:-1]) * length[1:] <= 1e-12 * size
        joined = np.abs(begin[1:] - end[:-1]) <= 1e-14 * size
        new[1:] |= ~(same & joined).all(axis=1)
    return [*np.flatnonzero(new).tolist(), len(new)]


def _data(layout: Layout, run: Run, window: Nodes, steps: Steps) -> FloatArray:
    """Data columns of steps, row by row."""
    data = np.zeros((len(steps.times), layout.data))
    data[:, 0] = steps.times
    data[:, 1] = steps.ends - steps.times
    if layout.inputs:
        left = window.left[steps.node]
        right = np.minimum(left + 1, len(run.times) - 1)
        begin = run.times[left]
        span = np.where(right > left, run.times[right] - begin, 1.0)
        middle = steps.times + 0.5 * (steps.ends - steps.times)
        for stage, at in enumerate((steps.times, middle, steps.ends)):
            weight = np.clip((at - begin) / span, 0.0, 1.0)[:, None] * (run.interpolation == "linear")
            data[:, layout.input(stage)] = (1.0 - weight) * run.inputs[left] + weight * run.inputs[right]
    data[:, layout.due] = window.due[steps.node] & steps.first[:, None]
    data[:, layout.node] = steps.first
    return data
