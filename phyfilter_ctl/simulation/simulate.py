"""Time responses of any diagram."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args

import control as ct
import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from .. import _signals
from .._renamed import takes_limits
from ..diagram import FlatModel, flatten
from ..diagram.fixed_step import rates
from ..diagram.switches import located
from ..execution import Executor
from ..execution.limits import Limits, limits_of
from . import compiled, vm
from .algebraic import jumps, unsolved
from .arguments import (
    Inputs,
    Interpolation,
    Parameters,
    Run,
    Start,
    Times,
    completed,
    given_times,
    prepare,
)
from .cost import expected_cost
from .flow import is_flow, run_flow, runs_in_numpy, suits
from .limits import Budget, steps_allowed
from .response import Backend, SimulationResponse, response_of, shares_of, with_outputs_checked
from .signals import SimulationBatch
from .steplength import default_step

__all__ = ["as_flat", "simulate", "simulate_batch"]

MethodChoice = Literal["auto", "rk4", "adaptive", "stiff", "exact"]
BackendChoice = Literal["auto", "vm", "c", "numpy"]
# Time constants of the fastest decaying mode that a run is long, and those for each of its nodes, to call it stiff.
_STIFF_STEPS, _STIFF_NODE_STEPS = 30_000.0, 100.0
# Jobs for each worker of another process.
_JOBS = 2


@dataclass(frozen=True)
class Options:
    """How a run is to be done."""

    method: MethodChoice
    backend: BackendChoice
    max_step: float | None
    rtol: float
    atol: float
    squeeze: bool | None
    limits: Limits
    explanation: str = ""

    def __post_init__(self) -> None:
        for name, choices in (("method", MethodChoice), ("backend", BackendChoice)):
            if getattr(self, name) not in get_args(choices):
                raise ValueError(f"{name}: expected one of {get_args(choices)}, got {getattr(self, name)!r}")
        if self.method in ("exact", "stiff") and self.backend == "c":
            raise ValueError(
                f"method={self.method!r} runs in the virtual machine: expected backend='vm', got 'c'"
            )
        if self.method not in ("auto", "exact") and self.backend == "numpy":
            raise ValueError(f"backend='numpy' takes method='exact', got {self.method!r}")
        if self.max_step is not None and not 0.0 < self.max_step < np.inf:
            raise ValueError(
                f"max_step: expected a positive number of seconds or None, got {self.max_step!r}"
            )
        if not (0.0 < self.rtol < 1.0 and 0.0 < self.atol < np.inf):
            raise ValueError(
                f"rtol, atol: expected 0 < rtol < 1 and a positive atol, got {self.rtol!r} and {self.atol!r}"
            )


@takes_limits
def simulate(
    sys: ct.InputOutputSystem | FlatModel,
    timepts: Times,
    inputs: Inputs | None = None,
    initial_state: Start | None = None,
    *,
    params: Parameters | None = None,
    method: MethodChoice = "auto",
    backend: BackendChoice = "auto",
    max_step: float | None = None,
    rtol: float = 1e-8,
    atol: float = 1e-10,
    interpolation: Interpolation = "linear",
    limits: Limits | Mapping[str, object] | None = None,
) -> SimulationResponse:
    """Response of a diagram to inputs: ``control.input_output_response``, compiled, and with sampled blocks.

    Parameters
    ----------
    sys : control.InputOutputSystem or FlatModel
        Any python-control system, or what :func:`flatten` made of it (once, for many runs). Of a block without numbers
        of states, inputs or outputs these are taken from what is given.
    timepts : (N,) array, or a pair of arrays
        Seconds, increasing; need not be evenly spaced. Of a pair, the first are the times of the inputs, (N,), the
        second, within them, those of the response. A discrete diagram wants its sampling interval between them; one
        with ``dt=True`` takes it from them.
        Sampled blocks have their first instant at the first time.
    inputs : number, (n_u, N) array, (N,) array or list, optional
        Inputs at the times; a number for all, or a list of numbers and arrays that are stacked. None means the defaults
        of the inputs (0 for python-control's).
    initial_state : array, list, mapping or number, optional
        Start of the n_x states; a list of arrays is put together, and where it is shorter the rest is 0, with a
        ``UserWarning`` unless it ends in 0; a mapping changes the named ones. None means the start values of the
        blocks (0 for python-control's).
    params : mapping, optional
        Parameters by name, as for :meth:`FlatModel.start_parameters`; also what is no number, such as
        ``{"correct": False}`` of python-control's estimators.
    method : {"auto", "rk4", "adaptive", "stiff", "exact"}
        "rk4": classical Runge-Kutta, equal steps between events (times and instants of sampled blocks). "adaptive":
        Dormand-Prince with error control, 8(5,3) in the virtual machine and 5(4) in C; starts anew at instants and at
        kinks of the inputs. "stiff": Rosenbrock with error control, Rodas5P (G. Steinebach, BIT 63, 27, 2023).
        "exact": matrix exponentials from instant to instant, for diagrams affine in states, inputs, time and held
        outputs between them. "auto": exact for such a diagram, else adaptive; in the virtual machine it goes over to
        stiff where the fastest decaying mode, measured on the way, bounds the steps.
    backend : {"auto", "vm", "c", "numpy"}
        CasADi's virtual machine, C compiled on the spot (kept for the next run), or, for "exact" without sampled
        blocks, one product of a matrix by the state for each time. "auto": what is
        predicted to take least time, C where a compiler is found; ``explanation`` of the response says why.
    max_step : float, optional
        Longest step in seconds. None: for "rk4", 0.2 of the time constant of the fastest pole at the start, and never
        beyond the next event; for the others, no bound.
    rtol, atol : float
        Adaptive: error of a step relative to, and beside, the size of the states.
    interpolation : {"linear", "hold"}
        Inputs between the times: on straight lines as in python-control, or each held until the next.
    limits : Limits or mapping, optional
        What the run may take: {"max_steps": 10_000, "time_limit": 5.0}, steps and seconds of this machine's time, and
        {"progress": True} for a progress bar; see :class:`Limits`.

    Returns
    -------
    SimulationResponse
        A ``control.TimeResponseData``. At an instant of a sampled block the outputs are those after it has run. A
        run that meets numbers that are not finite, steps that become too small or one of its limits, has ``success``
        False, NaN from there on and a ``message`` that says what to try. A
        ``RuntimeWarning`` (and ``notes``) tells where the solution of an algebraic loop jumped to another one. Blocks
        whose functions cannot be traced run as Python, in the virtual machine: ``callbacks`` has their names and
        shares of the time.

    Raises
    ------
    ValueError
        For wrong shapes, unknown names and options, or a diagram that cannot be flattened.
    CompilerError
        For backend="c" without a compiler, or with one that fails.

    Examples
    --------
    >>> lag = ct.tf([2.0], [1.0, 2.0])
    >>> response = simulate(lag, [0.0, 0.5, 1.0], 1.0)
    >>> response.outputs.round(6).tolist()
    [0.0, 0.632121, 0.864665]
    """
    allowed = limits_of(limits, "simulate")
    squeeze = None
    if isinstance(sys, ct.NonlinearIOSystem) and None in (sys.ninputs, sys.noutputs):
        squeeze = False  # as python-control, for which that is not of one input and one output
    times, shown = given_times(timepts)
    if not isinstance(sys, FlatModel):
        sys = completed(sys, times if shown is None else shown, inputs, initial_state, params)
    flat = as_flat(sys, params)
    options = Options(method, backend, max_step, rtol, atol, squeeze, allowed)
    run = prepare(flat, times, inputs, initial_state, params, interpolation, shown)
    return _simulate(flat, run, _decided(flat, run, options, 1))


@takes_limits
def simulate_batch(
    sys: ct.InputOutputSystem | FlatModel,
    timepts: Times,
    inputs: Inputs | None = None,
    initial_state: Start | None = None,
    *,
    params: Mapping[str, ArrayLike] | None = None,
    method: MethodChoice = "auto",
    backend: BackendChoice = "auto",
    max_step: float | None = None,
    rtol: float = 1e-8,
    atol: float = 1e-10,
    interpolation: Interpolation = "linear",
    limits: Limits | Mapping[str, object] | None = None,
) -> SimulationBatch:
    """Many runs of one diagram, over the cores.

    Parameters
    ----------
    sys, timepts
        As for :func:`simulate`.
    inputs
        As for :func:`simulate`, or (B, n_u, N): one for each run, e.g. noise of B seeds.
    initial_state
        As for :func:`simulate`, or (B, n_x).
    params : mapping, optional
        By name: numbers for all runs, or arrays whose first axis are the B runs.
    method, backend, max_step, rtol, atol, interpolation
        As for :func:`simulate`; backend="auto" compiles where that makes the whole batch faster.
    limits : Limits or mapping, optional
        As for :func:`simulate`, for each run; and {"workers": 4}, threads or an ``Executor``.

    Returns
    -------
    SimulationBatch
        B responses of type SimulationResponse, equal bit for bit to single runs with the same method and backend, as a
        ``control.TimeResponseList``; its own ``outputs``, ``states`` and ``inputs`` have all runs, (B, n, N), and by
        name (B, k, N).

    Raises
    ------
    ValueError
        As for :func:`simulate`, and where nothing tells B, or several things contradict each other; for blocks that run
        as Python with an executor of other processes.

    Examples
    --------
    >>> lag = ct.nlsys(lambda t, x, u, p: [p["rate"] * (u[0] - x[0])], None, inputs=1, outputs=1, states=1,
    ...                params={"rate": 1.0}, name="lag")
    >>> runs = simulate_batch(lag, [0.0, 1.0], 1.0, params={"rate": [1.0, 2.0]})
    >>> [float(run.outputs[-1].round(4)) for run in runs]
    [0.6321, 0.8647]
    >>> runs.outputs["y[0]"].shape  # runs, times
    (2, 2)
    """
    allowed = limits_of(limits, "simulate_batch", batch=True)
    arguments = _batch(inputs, initial_state, params)
    flat = as_flat(sys, arguments[0][2])
    asked = allowed.workers
    chosen = asked if isinstance(asked, Executor) else Executor(asked, kind="threads")
    options = Options(
        method, backend, max_step, rtol, atol, None, replace(allowed, workers=None, progress=False)
    )
    if flat.callbacks and not chosen.shares_memory:
        raise ValueError(
            f"workers: block {flat.callbacks[0].block} runs as Python ({flat.callbacks[0].reason}), which other "
            "processes cannot be given; a number runs the batch in threads of this one"
        )
    times, shown = given_times(timepts)
    runs = [prepare(flat, times, u, x0, p, interpolation, shown) for u, x0, p in arguments]
    decided = _decided(flat, runs[0], options, len(runs))
    try:
        with tqdm(total=len(runs), disable=not allowed.progress, unit="run") as bar:
            answers: list[SimulationResponse] = []
            for some in _spread(chosen, partial(_simulate_all, flat=flat, options=decided), runs):
                answers += some
                bar.update(len(some))
            return SimulationBatch(answers)
    finally:
        if chosen is not asked:  # the other is its owner's to close
            chosen.close()


def _spread(
    executor: Executor, work: Callable[[Sequence[Run]], list[SimulationResponse]], runs: Sequence[Run]
) -> Iterator[list[SimulationResponse]]:
    if executor.shares_memory:
        # The first run builds (or compiles) all functions; then the threads only run them.
        yield work(runs[:1])
        yield from executor.map(work, [[run] for run in runs[1:]])
    else:
        # Every job builds them for itself: a few jobs for each worker.
        length = -(-len(runs) // (_JOBS * executor.size))
        yield from executor.map(work, [runs[k : k + length] for k in range(0, len(runs), length)])


def _simulate_all(runs: Sequence[Run], flat: FlatModel, options: Options) -> list[SimulationResponse]:
    return [_simulate(flat, run, options) for run in runs]


def as_flat(sys: ct.InputOutputSystem | FlatModel, params: Parameters | None = None) -> FlatModel:
    """The flat model of a system."""
    return sys if isinstance(sys, FlatModel) else flatten(sys, params=params)


def _decided(flat: FlatModel, run: Run, options: Options, runs: int) -> Options:
    """Options without "auto"."""
    method, backend, why = options.method, options.backend, ""
    if method == "exact" and flat.states and flat.dt == 0.0 and not is_flow(flat):
        raise ValueError(
            f"method='exact': {flat.name} is not affine in its states, inputs, time and held outputs between instants, "
            "or has switches or events there; take method='stiff' for fast modes, or 'adaptive'"
        )
    exact = (
        is_flow(flat) and backend != "c" and (method == "exact" or (method == "auto" and suits(flat, run)))
    )
    method = "exact" if exact else method
    if flat.events:
        if method == "rk4" and backend != "c":
            raise ValueError(
                f"method='rk4' steps over the events of {flat.name}: expected 'auto', 'adaptive' or 'stiff', or 'rk4' "
                "with backend='c'"
            )
        if backend == "auto":
            backend, why = "vm", "vm: it records the events"
    if (not flat.states and not flat.memories) or flat.dt > 0.0:
        method = "rk4"  # nothing to integrate
    if backend == "numpy" and not (exact and runs_in_numpy(flat)):
        raise ValueError(
            "backend='numpy': expected an affine diagram without sampled blocks and nonlinear algebraic loops; take "
            "backend='auto'"
        )
    if backend == "auto" and method == "exact":
        backend = "numpy" if runs_in_numpy(flat) else "vm"
        why = f"{backend}: the diagram is affine between instants, {len(run.times)} times"
    elif backend == "auto" and method == "stiff":
        backend, why = "vm", "vm: stiff"
    elif backend == "auto":
        decaying, fastest = _rates(flat, run)
        cost = expected_cost(flat, run, fastest, fixed=method == "rk4", max_step=options.max_step, runs=runs)
        if method == "auto" and _starts_stiff(flat, run, decaying):
            backend, why = "vm", f"vm: stiff, a mode decays at {decaying:.3g} 1/s"
        else:
            backend = "c" if cost.c < cost.vm and compiled.compiles(flat) else "vm"
            why = cost.explained(backend)
    if backend == "c" and method == "auto":
        method = "adaptive"
    return replace(options, method=method, backend=backend, explanation=why or f"{backend}: asked for")


def _rates(flat: FlatModel, run: Run) -> tuple[float, float]:
    """Of the fastest mode that decays, and of any, where the run starts."""
    if not flat.states or flat.dt > 0.0:
        return 0.0, 0.0
    z = np.array([variable.start for variable in flat.held])
    start = float(run.times[0])
    below = _stiff_steps(flat, run) / max(float(run.times[-1]) - start, 1e-300)
    return rates(flat, start, run.start, run.inputs[0], run.parameters, z, below=below)


def _starts_stiff(flat: FlatModel, run: Run, rate: float) -> bool:
    """Whether stability would bound the explicit steps of a run, if it went on as it starts."""
    return rate * float(run.times[-1] - run.times[0]) > _stiff_steps(flat, run)


def _stiff_steps(flat: FlatModel, run: Run) -> float:
    nodes = len(run.times) + sum((run.times[-1] - run.times[0]) / task.period for task in flat.tasks)
    return _STIFF_STEPS + _STIFF_NODE_STEPS * nodes


def _simulate(flat: FlatModel, run: Run, options: Options) -> SimulationResponse:
    with ExitStack() as stack:
        for running in flat.exclusive:
            stack.enter_context(running())
        return _run(flat, run, options)


def _run(flat: FlatModel, run: Run, options: Options) -> SimulationResponse:
    method: MethodChoice = options.method
    progress = options.limits.progress
    controlled = method in ("adaptive", "stiff", "auto")
    shares = shares_of(flat)
    longest = options.max_step
    limits = Budget(steps_allowed(flat, run, options.limits.max_steps, controlled), options.limits.time_limit)
    if longest is None and method == "rk4" and flat.dt == 0.0:
        longest = default_step(flat, run)
    model = located(flat) if controlled and options.backend != "c" and flat.dt == 0.0 else flat
    if options.backend == "c":
        assert method in ("rk4", "adaptive")
        outcome = compiled.run_compiled(
            flat,
            run,
            method=method,
            max_step=longest,
            rtol=options.rtol,
            atol=options.atol,
            limits=limits,
            progress=progress,
        )
    elif flat.dt > 0.0:
        outcome, _ = vm.run_pieces(flat, run, vm.discrete_pieces(flat, run), limits=limits, progress=progress)
    elif method == "adaptive" or method == "stiff" or method == "auto":
        outcome, method = vm.run_adaptive(
            model,
            run,
            control=method,
            rtol=options.rtol,
            atol=options.atol,
            max_step=longest,
            limits=limits,
            progress=progress,
        )
    elif options.backend == "numpy":
        outcome = run_flow(flat, run, limits, progress)
    else:
        pieces = vm.fixed_pieces(flat, run, method, longest)
        outcome, _ = vm.run_pieces(flat, run, pieces, limits=limits, progress=progress)
    assert method != "auto"
    backend: Backend = "vm" if options.backend == "auto" else options.backend
    outcome = with_outputs_checked(flat, run, outcome)
    notes = jumps(flat, run, outcome.x)
    for note in notes:
        warnings.warn(note, RuntimeWarning, stacklevel=5)
    if outcome.message:
        without = unsolved(flat, run, outcome.x, outcome.failed_at)
        outcome = outcome._replace(message=outcome.message + without)
    return response_of(
        flat, run, outcome, notes=notes, method="discrete" if flat.dt > 0.0 else method,
        backend=backend, explanation=options.explanation, squeeze=options.squeeze,
        callbacks=shares(),
    )  # fmt: skip


def _batch(
    inputs: Inputs | None, initial_state: Start | None, params: Mapping[str, ArrayLike] | None
) -> list[tuple[Inputs | None, Start | None, dict[str, ArrayLike]]]:
    """Arguments of each run."""
    per_run = {name: _signals.real(f"params[{name!r}]", value) for name, value in (params or {}).items()}
    several_u = inputs if isinstance(inputs, np.ndarray) and inputs.ndim == 3 else None
    several_x = initial_state if isinstance(initial_state, np.ndarray) and initial_state.ndim == 2 else None
    sizes = {f"params[{name!r}]": len(value) for name, value in per_run.items() if value.ndim}
    if several_u is not None:
        sizes["inputs"] = len(several_u)
    if several_x is not None:
        sizes["initial_state"] = len(several_x)
    if len(set(sizes.values())) != 1 or 0 in sizes.values():
        raise ValueError(
            "expected one number B of runs from params (arrays of B), inputs (an array (B, n_u, N)) or initial_state "
            f"(an array (B, n_x)), got {sizes or 'none of them'}"
        )
    return [
        (
            inputs if several_u is None else several_u[i],
            initial_state if several_x is None else several_x[i],
            {name: value[i] if value.ndim else value for name, value in per_run.items()},
        )
        for i in range(next(iter(sizes.values())))
    ]
