"""A model compiled by the system's C compiler and run from Python: whole simulations in one call."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._renamed import takes_limits
from ..diagram.model import FlatModel
from ..execution.limits import Limits, limits_of
from ..results import Result
from .binding import Library, Progress, address, glue_source
from .casadi_source import Real
from .compiler import cached_library
from .diagram_source import diagram_model, runtime_sources
from .instance import Instance
from .model import CModel

__all__ = ["CompiledModel", "CompiledRun", "compile_model"]

FloatArray = NDArray[np.float64]

_METHODS = {"rk4": 0, "adaptive": 1}
_POLL = 0.05  # s between two looks at the progress of a run
_SHORTEST_POLL = 1e-3
_STOPPED, _LATE = (4, 100), 101  # what a run says that was stopped; what became of it
_MESSAGES = {
    0: "done",
    1: "the states are not finite from t = {t:.9g} s on: the diagram diverges, or the step is too long; shorten "
    "max_step or look at the states before",
    2: "a Newton iteration in the diagram does not converge at t = {t:.9g} s: in an algebraic loop or a block's solver",
    3: "the step became too small at t = {t:.9g} s: a singularity, a jump, or a stiff diagram; relax rtol and atol, or "
    "use method='rk4' with a given max_step",
    4: "the steps allowed were spent at t = {t:.9g} s",
    5: "damaged parameters, or flags of the compiler that give no IEEE arithmetic",
    6: "events follow each other without time in between at t = {t:.9g} s, last {event}: a sliding mode, or ever "
    "shorter bounces. Give a switch hysteresis; let a reset bring to rest what is slower than a threshold",
    100: "cancelled at t = {t:.9g} s",
    101: "the time limit was reached at t = {t:.9g} s",
}


@dataclass(frozen=True, eq=False, repr=False)
class CompiledRun(Result):
    """What a compiled simulation found.

    Parameters
    ----------
    states : (N, n_x) array
        NaN in the rows that were not reached.
    outputs : (N, n_y) array
    sampled_states : (N, n_s) array
        Of the sampled blocks, after those due had run.
    status : int
        0 done, 1 not finite, 2 no convergence, 3 step too small, 4 too many steps, 5 not usable, 6 endless events,
        100 cancelled, 101 time limit.
    message : str
        What happened, and what to try.
    t_reached : float
        Seconds, as far as the run came.
    rows : int
        Number of times reached.
    last_state : (n_x,) array
        Continuous states at ``t_reached``.
    """

    states: FloatArray
    outputs: FloatArray
    sampled_states: FloatArray
    status: int
    message: str
    t_reached: float
    rows: int
    last_state: FloatArray

    @property
    def success(self) -> bool:
        """Whether the run came to its end."""
        return self.status == 0


@dataclass(frozen=True, eq=False)
class CompiledModel:
    """A model in a loaded shared library; made by :func:`compile_model`. Safe to use from several threads.

    Parameters
    ----------
    model : CModel
        Its sources and names.
    library : Library
    path : Path
        Of the shared library.
    """

    model: CModel
    library: Library
    path: Path

    def instance(self) -> Instance:
        """One instance of the model, to be run step by step."""
        return Instance(self.model, self.library)

    @takes_limits
    def simulate(
        self,
        timepts: ArrayLike,
        inputs: ArrayLike | None = None,
        *,
        initial_state: ArrayLike | None = None,
        sampled_state: ArrayLike | None = None,
        params: Mapping[str, float] | ArrayLike | None = None,
        method: Literal["rk4", "adaptive"] = "rk4",
        max_step: float | None = None,
        rtol: float = 1e-8,
        atol: float = 1e-10,
        interpolation: Literal["linear", "hold"] = "linear",
        limits: Limits | Mapping[str, object] | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> CompiledRun:
        """A whole run in one call of C, other Python threads running meanwhile.

        Parameters
        ----------
        timepts : (N,) array
            Seconds, increasing; the sampled blocks start at the first.
        inputs : (N, n_u) array, optional
            At the times; default: the start values of the inputs throughout.
        initial_state : (n_x,) array, optional
            Default: the start values.
        sampled_state : (n_s,) array, optional
            States of the sampled blocks before their first instant, in the order of ``model.sampled_states``; those
            of a PhyFilter are not set. Default: the start values.
        params : mapping of str to float, or (n_p,) array, optional
            By name, the others at their defaults; or all.
        method : {"rk4", "adaptive"}
            Classical Runge-Kutta, equal steps from stop to stop (times and instants), or Dormand-Prince 5(4) with step
            control.
        max_step : float, optional
            Longest step in seconds; default: from stop to stop, no bound where adaptive.
        rtol, atol : float
            Adaptive: error of a step below atol + rtol |x|, state by state.
        interpolation : {"linear", "hold"}
            Inputs between the times: on straight lines, or held until the next.
        limits : Limits or mapping, optional
            {"max_steps": 10_000, "time_limit": 5.0}: steps that may be tried, and seconds of this machine's time; None
            means no bound.
        progress : callable, optional
            Called every 50 ms with the number of times reached. Then Ctrl-C ends the run too.

        Returns
        -------
        CompiledRun

        Raises
        ------
        ValueError
            If a shape, a name or a number is not as said, or the model refuses the parameters.
        """
        library = self.library
        allowed = limits_of(limits, "CompiledModel.simulate")
        if allowed.progress:
            raise ValueError("limits: progress is a callable here, progress=...")
        times = _times(timepts)
        u = None if inputs is None else self._matrix("inputs", inputs, len(times), len(self.model.inputs))
        if method not in _METHODS:
            raise ValueError(f"method: expected 'rk4' or 'adaptive', got {method!r}")
        if interpolation not in ("linear", "hold"):
            raise ValueError(f"interpolation: expected 'linear' or 'hold', got {interpolation!r}")
        if max_step is not None and not max_step > 0.0:
            raise ValueError(f"max_step: expected a positive number of seconds, got {max_step!r}")
        if not (rtol >= 0.0 and atol >= 0.0 and rtol + atol > 0.0):
            raise ValueError(f"rtol, atol: expected numbers >= 0, not both 0, got {rtol!r} and {atol!r}")
        instance = self.instance()
        if params is not None:
            instance.set_parameters(params)
        if initial_state is not None:
            instance.x[:] = self._matrix("initial_state", initial_state, None, len(self.model.states))
        if sampled_state is not None:
            instance.set_sampled_states(sampled_state)
        longest = 0.0 if max_step is None or max_step == float("inf") else float(max_step)
        solver = library.solver(_METHODS[method], longest, rtol, atol, allowed.max_steps or 0)
        shape = [len(self.model.states), len(self.model.outputs), len(self.model.sampled_states)]
        results = [np.full((len(times), n), np.nan, library.dtype) for n in shape]
        reached, shared = ct.c_double(), Progress()
        work = np.empty(library.work_reals, library.dtype)

        def run() -> int:
            return library.simulate(
                instance.address, address(work), ct.byref(solver), len(times), address(times), address(u),
                interpolation == "linear", *map(address, results), ct.byref(shared), ct.byref(reached),
            )  # fmt: skip

        if progress is None and allowed.time_limit is None:
            status = run()
        else:
            status = _watched(run, shared, solver, progress, allowed.time_limit)
        states, outputs, sampled = (np.asarray(result, dtype=np.float64) for result in results)
        message = _MESSAGES.get(status, "status {status} at t = {t:.9g} s").format(
            t=reached.value, status=status, event=self._latest_event(instance)
        )
        return CompiledRun(
            states, outputs, sampled, status, message, reached.value, int(shared.rows),
            np.array(instance.x, dtype=float),
        )  # fmt: skip

    def _latest_event(self, instance: Instance) -> str:
        table = self.library.table.events
        if not (table and self.model.events):
            return ""
        return self.model.events[table.contents.clock(instance.address).contents.latest]

    def _matrix(self, name: str, values: ArrayLike, rows: int | None, columns: int) -> NDArray[np.floating]:
        shape = (columns,) if rows is None else (rows, columns)
        matrix = np.ascontiguousarray(values, dtype=self.library.dtype)
        if matrix.shape != shape:
            raise ValueError(f"{name}: expected shape {shape}, got {matrix.shape}")
        return matrix


def compile_model(
    model: FlatModel | CModel,
    *,
    compiler: str | Path | Sequence[str] | None = None,
    real: Real = "double",
    derivatives: bool = False,
    tunable: bool = False,
    flags: Sequence[str] = (),
) -> CompiledModel:
    """Compiles a model, or takes it from the cache, and loads it.

    Parameters
    ----------
    model : FlatModel or CModel
    compiler : str, Path or sequence of str, optional
        See :func:`find_compiler`.
    real : {"double", "float"}
        Numbers of the C code of a flat model.
    derivatives : bool
        Of a flat model: with directional and adjoint products, which take longer to compile.
    tunable : bool
        Of a flat model: coefficients of its sampled PhyFilters are parameters too.
    flags : sequence of str
        For the compiler.

    Returns
    -------
    CompiledModel

    Raises
    ------
    CompilerError
        If there is no compiler, or it fails.
    ValueError
        If there is no C code for a part of the model.

    Examples
    --------
    >>> import casadi as ca
    >>> from phyfilter_ctl.blocks.functions import Variable
    >>> t, x, u, p, z = (ca.SX.sym(n, m) for n, m in (("t", 1), ("x", 1), ("u", 1), ("p", 1), ("z", 0)))
    >>> lag = FlatModel(
    ...     "lag", (Variable("x"),), (Variable("u", 1.0),), (Variable("y"),), (Variable("rate", 2.0, "1/s"),), (),
    ...     ca.Function("f", [t, x, u, p, z], [p * (u - x)]), ca.Function("h", [t, x, u, p, z], [x]))
    >>> run = compile_model(lag).simulate([0.0, 0.5], max_step=0.01)
    >>> run.outputs.round(6).tolist(), run.message
    ([[0.0], [0.632121]], 'done')
    """
    text = (
        diagram_model(model, real=real, derivatives=derivatives, tunable=tunable)
        if isinstance(model, FlatModel)
        else model
    )
    sources = text.sources | runtime_sources(("pf_simulate.h", "pf_simulate.c"))
    sources["pf_exported.c"] = glue_source(text)
    path = cached_library(sources, name=text.name, compiler=compiler, flags=flags)
    return CompiledModel(text, Library(path), path)


def _times(timepts: ArrayLike) -> FloatArray:
    return np.ascontiguousarray(_signals.sample_times("timepts", timepts))


def _watched(
    run: Callable[[], int],
    shared: Progress,
    solver: ct.Structure,
    progress: Callable[[int], None] | None,
    time_limit: float | None,
) -> int:
    """Runs in a thread and reports; whatever stops the reports stops the run, and so does the time limit."""
    show = progress or (lambda rows: None)
    deadline = np.inf if time_limit is None else monotonic() + time_limit
    late = False
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(run)
        try:
            while not wait([future], min(_POLL, max(deadline - monotonic(), _SHORTEST_POLL))).done:
                show(int(shared.rows))
                if monotonic() >= deadline:
                    late, shared.cancel, solver.budget = True, 1, -1
            show(int(shared.rows))
        except BaseException:
            shared.cancel, solver.budget = 1, -1
            raise
        status = future.result()
        return _LATE if late and status in _STOPPED else status
