"""What diagrams cost: one-shot, warm, compiled, in batches; beside python-control, LSODA, handwritten C and others.

One-shot times are of a fresh diagram, flattened and run at once with the defaults. python-control runs at its own
defaults (rtol 1e-3) and at those of this library (rtol 1e-8, atol 1e-10). SciPy's LSODA gets each case's equations as a
Python function, as its users write them, the input interpolated as python-control does. Processor seconds of this
process, the least of some runs; compilers are children and counted apart, with an empty cache.

    python benchmarks/diagram_cost.py [--quick]
"""

from __future__ import annotations

import argparse
import ctypes
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import control as ct
import numpy as np
from scipy.integrate import solve_ivp

import phyfilter_ctl as pf
from phyfilter_ctl.codegen import compile_model

Slope = Callable[[np.ndarray, float], Sequence[float] | np.ndarray]
TIGHT: dict[str, Any] = {"rtol": 1e-8, "atol": 1e-10}
# RK4 of the same pendulum as a control engineer would write it by hand.
BY_HAND = r"""
#include <math.h>
static void slope(const double *x, double u, double *dx) {
  dx[0] = x[1];
  dx[1] = u - 9.8 * sin(x[0]) - 0.2 * x[1];
}
void run(double *x, const double *u, int n, double h, double *y) {
  double k1[2], k2[2], k3[2], k4[2], at[2];
  for (int k = 0; k < n; k++) {
    const double half = 0.5 * (u[k] + u[k + 1]);
    y[k] = x[0];
    slope(x, u[k], k1);
    for (int i = 0; i < 2; i++) at[i] = x[i] + h / 2 * k1[i];
    slope(at, half, k2);
    for (int i = 0; i < 2; i++) at[i] = x[i] + h / 2 * k2[i];
    slope(at, half, k3);
    for (int i = 0; i < 2; i++) at[i] = x[i] + h * k3[i];
    slope(at, u[k + 1], k4);
    for (int i = 0; i < 2; i++) x[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
  }
  y[n] = x[0];
}
"""


def least(work: Callable[[], object], runs: int = 3, clock: Callable[[], float] = time.process_time) -> float:
    """Seconds of the quickest run."""
    seconds = np.inf
    for _ in range(runs):
        begin = clock()
        work()
        seconds = min(seconds, clock() - begin)
    return seconds


def pendulum(name: str = "pendulum") -> ct.NonlinearIOSystem:
    return ct.nlsys(
        lambda t, x, u, params: [x[1], u[0] - 9.8 * np.sin(x[0]) - 0.2 * x[1]],
        lambda t, x, u, params: x[:1], inputs=1, outputs=1, states=2, name=name,
    )  # fmt: skip


def cruise() -> ct.InputOutputSystem:
    plant = ct.nlsys(
        lambda t, x, u, params: [(u[0] - params["drag"] * x[0] * np.abs(x[0])) / params["m"]], None, inputs="f",
        outputs="v", states="v", params={"m": 2.0, "drag": 0.5}, name="plant",
    )  # fmt: skip
    law = ct.tf([3.0, 1.0], [1.0, 0.0], inputs="e", outputs="f", name="pi")
    error = ct.summing_junction(["r", "-v"], "e", name="error")
    return ct.interconnect([plant, law, error], inputs="r", outputs="v", name="cruise")


def oscillator() -> ct.NonlinearIOSystem:
    return ct.nlsys(
        lambda t, x, u, params: [x[1], 5.0 * (1.0 - x[0] ** 2) * x[1] - x[0] + u[0]], None, inputs=1, outputs=2,
        states=2, name="van_der_pol",
    )  # fmt: skip


def ring(n: int) -> ct.InterconnectedSystem:
    """n blocks x' = tanh(u) - x, each fed by the one before."""
    blocks = [
        ct.nlsys(lambda t, x, u, params: [np.tanh(u[0]) - x[0]], None, inputs=1, outputs=1, states=1, name=f"b{i}")
        for i in range(n)
    ]  # fmt: skip
    return ct.InterconnectedSystem(
        blocks, connections=[[(i, 0), ((i - 1) % n, 0)] for i in range(n)], inplist=[(0, 0)], outlist=[(n - 1, 0)],
        inputs="u", outputs="y", name="ring",
    )  # fmt: skip


def pendulums(n: int) -> ct.NonlinearIOSystem:
    """n pendulums in a row, coupled by springs."""

    def rates(t, x, u, params):
        angle, rate = x[:n], x[n:]
        right = np.concatenate([angle[1:], angle[-1:]])
        left = np.concatenate([angle[:1], angle[:-1]])
        return np.concatenate([rate, u[0] - 9.8 * np.sin(angle) + 3.0 * (left - 2 * angle + right)])

    return ct.nlsys(rates, lambda t, x, u, params: x[:1], inputs=1, outputs=1, states=2 * n, name="pendulums")


def reaction(n: int) -> ct.NonlinearIOSystem:
    """Reaction and diffusion on n nodes: x' = 400 (left - 2 x + right) + x - x^3 + u."""

    def rates(t, x, u, params):
        left, right = np.concatenate([x[:1], x[:-1]]), np.concatenate([x[1:], x[-1:]])
        return 400.0 * (left - 2 * x + right) + x - x**3 + u[0]

    return ct.nlsys(rates, lambda t, x, u, params: x[:1], inputs=1, outputs=1, states=n, name="reaction")


def two_lags() -> ct.InputOutputSystem:
    return ct.ss([[-1.0, 1.0], [0.0, -3.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0.0)


# The same equations as Python functions of state and input.
def pendulum_slope(x: np.ndarray, u: float) -> list[float]:
    return [x[1], u - 9.8 * math.sin(x[0]) - 0.2 * x[1]]


def cruise_slope(x: np.ndarray, u: float) -> list[float]:
    speed, summed = x
    error = u - speed
    return [(3.0 * error + summed - 0.5 * speed * abs(speed)) / 2.0, error]


def oscillator_slope(x: np.ndarray, u: float) -> list[float]:
    return [x[1], 5.0 * (1.0 - x[0] ** 2) * x[1] - x[0] + u]


def two_lags_slope(x: np.ndarray, u: float) -> list[float]:
    return [x[1] - x[0], u - 3.0 * x[1]]


def ring_slope(x: np.ndarray, u: float) -> np.ndarray:
    before = np.roll(x, 1)
    before[0] += u
    return np.tanh(before) - x


def one_shot(quick: bool) -> None:
    cases: list[tuple[str, Callable[[], ct.InputOutputSystem], Slope, float]] = [
        ("pendulum", pendulum, pendulum_slope, 10.0),
        ("cruise control", cruise, cruise_slope, 20.0),
        ("two lags", two_lags, two_lags_slope, 10.0),
    ]
    if not quick:
        cases += [
            ("van der Pol, mu = 5", oscillator, oscillator_slope, 30.0),
            ("ring of 10", lambda: ring(10), ring_slope, 10.0),
            ("ring of 100", lambda: ring(100), ring_slope, 10.0),
        ]
    print("one-shot, flatten included: ratio of times to python-control's")
    ratios = []
    for name, make, slope, end in cases:
        t = np.linspace(0.0, end, 50 if quick else 500)
        u: Any = np.sin(t)  # python-control says float, and means arrays too
        systems = iter([make() for _ in range(12)])
        own = least(lambda t=t, u=u, s=systems: ct.input_output_response(next(s), t, u))
        tight = least(
            lambda t=t, u=u, s=systems: ct.input_output_response(next(s), t, u, solve_ivp_kwargs=TIGHT)
        )
        answer: list[pf.SimulationResponse] = []
        ours = least(lambda t=t, u=u, s=systems, a=answer: a.append(pf.simulate(next(s), t, u)))
        flat = pf.flatten(make())
        response = pf.simulate(flat, t, u)
        warm = least(lambda f=flat, t=t, u=u: pf.simulate(f, t, u))
        plain = partial(lsoda_states, slope, len(flat.states), t, u)
        lsoda = least(plain)
        off = np.abs(plain()[0] - response.states[0]).max()
        assert off < 1e-5, f"{name}: the equations for LSODA are others, {off:.1e}"
        ratios.append((ours / own, ours / tight, warm / own, warm / lsoda))
        print(
            f"  {name:20} {ours / own:6.2f} at its tolerance, {ours / tight:5.2f} at equal tolerance; warm "
            f"{warm / own:5.2f}, over LSODA {warm / lsoda:5.2f}; {answer[-1].explanation}"
        )
    medians = np.median(ratios, axis=0)
    print(
        f"  {'median':20} {medians[0]:6.2f}, {medians[1]:5.2f}; warm {medians[2]:5.2f}, {medians[3]:5.2f}\n"
    )


def lsoda_states(slope: Slope, n: int, t: np.ndarray, u: np.ndarray) -> np.ndarray:
    def rates(time: float, x: np.ndarray) -> Sequence[float] | np.ndarray:
        return slope(x, float(np.interp(time, t, u)))

    return solve_ivp(rates, (t[0], t[-1]), np.zeros(n), "LSODA", t, **TIGHT).y


def linear(sizes: Sequence[int]) -> None:
    print("dense linear systems, 1,001 times: over control.forced_response")
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 10.0, 1001)
    u: Any = np.sin(t)
    for n in sizes:
        A = rng.normal(size=(n, n)) / np.sqrt(n) - 1.5 * np.eye(n)
        sys = ct.ss(A, rng.normal(size=(n, 1)), rng.normal(size=(1, n)), 0.0)
        theirs = least(lambda s=sys: ct.forced_response(s, t, u))
        once = least(lambda s=sys: pf.simulate(s, t, u), 1)
        flat = pf.flatten(sys)
        response = pf.simulate(flat, t, u)
        warm = least(lambda f=flat: pf.simulate(f, t, u))
        error = np.abs(response.outputs - ct.forced_response(sys, t, u).outputs).max()
        print(f"  {n:4} states: one-shot {once / theirs:6.2f}, warm {warm / theirs:5.2f}; error {error:.1e}")
    print()


def chosen(quick: bool) -> None:
    print("long runs: seconds in the virtual machine, and as chosen, with compilation; wall clock")
    n = 50 if quick else 2000
    for name, system, end in (
        (f"{n} pendulums", pendulums(n), 1.0 if quick else 10.0),
        ("reaction, 200 nodes", reaction(50 if quick else 200), 0.1 if quick else 1.0),
    ):
        flat = pf.flatten(system)
        t = np.linspace(0.0, end, 101)
        u = np.sin(3.0 * t)
        machine = least(
            lambda f=flat, t=t, u=u: pf.simulate(f, t, u, backend="vm", method="adaptive"), 1, time.perf_counter
        )  # fmt: skip
        flat = pf.flatten(system)
        begin = time.perf_counter()
        response = pf.simulate(flat, t, u)
        taken = time.perf_counter() - begin
        print(f"  {name:20} {machine:7.2f} {taken:7.2f}  {response.explanation}")
    print()


def compilers(sizes: Sequence[int]) -> None:
    print("tanh blocks in a ring: seconds of the processor to flatten and to compile")
    for n in sizes:
        sys = ring(n)
        flat: list[pf.FlatModel] = []
        flattened = least(lambda s=sys, f=flat: f.append(pf.flatten(s)), 1)
        before = os.times().children_user
        compile_model(flat[0])
        print(f"  {n:5} blocks: flatten {flattened:5.2f}, compile {os.times().children_user - before:5.2f}")
    print()


def batch(runs: int) -> None:
    flat = pf.flatten(oscillator())
    t = np.linspace(0.0, 500.0, 201)
    starts = np.random.default_rng(0).normal(size=(runs, 2))
    pf.simulate_batch(flat, t, 0.0, starts[:2], backend="c")
    times = {
        workers: least(
            lambda w=workers: pf.simulate_batch(flat, t, 0.0, starts, backend="c", limits={"workers": w}),
            2,
            time.perf_counter,
        )
        for workers in (1, 2)
    }  # fmt: skip
    print(
        f"batch of {runs} van der Pol oscillators, 500 s each, in C, wall clock (on a busy machine it says little): "
        f"two threads {times[1] / times[2]:.2f} times as fast as one\n"
    )


def by_hand() -> None:
    """RK4 of the pendulum: the generated C in one call over handwritten C, both without Python in between."""
    n, h = 200_000, 1e-3
    u = np.sin(h * np.arange(n + 1))
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "hand.c"), Path(folder, "hand.so")
        source.write_text(BY_HAND)
        flags = ["-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC"]
        subprocess.run(["cc", *flags, str(source), "-o", str(library), "-lm"], check=True)
        run = ctypes.CDLL(str(library)).run
        x, y = np.zeros(2), np.zeros(n + 1)
        pointers = (x.ctypes.data, u.ctypes.data, n, ctypes.c_double(h), y.ctypes.data)
        run.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_double, ctypes.c_void_p]
        run.restype = None

        def work() -> None:
            x[:] = 0.0
            run(*pointers)

        hand = least(work)
    model = compile_model(pf.flatten(pendulum()))
    times, inputs = h * np.arange(n + 1), u[:, None]
    answer = model.simulate(times, inputs, method="rk4")
    ours = least(lambda: model.simulate(times, inputs, method="rk4"))
    print(
        f"pendulum, RK4, {n} steps in C: {ours / hand:.2f} times handwritten C, which keeps one output; "
        f"difference {np.abs(answer.outputs[:, 0] - y).max():.1e}"
    )


def beside_pathsim(end: float) -> None:
    """Van der Pol's oscillator left alone, at equal tolerances: Dormand-Prince 8(5,3) over PathSim's faster pair.

    It has two of Dormand and Prince, 8(7) and 5(4).
    """
    if find_spec("pathsim") is None:
        print("pathsim: not installed, skipped")
        return
    blocks, solvers = import_module("pathsim.blocks"), import_module("pathsim.solvers")
    simulation = import_module("pathsim").Simulation
    ends: list[Any] = []

    def theirs(solver: Any) -> None:
        block = blocks.ODE(
            lambda x, u, t: np.array([x[1], 5.0 * (1.0 - x[0] ** 2) * x[1] - x[0]]), np.array([2.0, 0.0])
        )
        given = {"tolerance_lte_abs": TIGHT["atol"], "tolerance_lte_rel": TIGHT["rtol"], "log": False}
        simulation([block], [], dt=0.01, Solver=solver, **given).run(end)
        ends.append(block.engine.get())

    sys = oscillator()
    flat, t = pf.flatten(sys), [0.0, end]
    seconds = {pair: least(partial(theirs, getattr(solvers, pair))) for pair in ("RKDP87", "RKDP54")}
    faster = min(seconds, key=seconds.__getitem__)
    theirs(getattr(solvers, faster))
    ratios = [
        least(work) / seconds[faster]
        for work in (
            lambda: pf.simulate(sys, t, 0.0, [2.0, 0.0]),
            lambda: pf.simulate(flat, t, 0.0, [2.0, 0.0]),
        )
    ]
    off = np.abs(pf.simulate(flat, t, 0.0, [2.0, 0.0]).states[:, -1] - ends[-1]).max()
    spent = ", ".join(f"{pair} {value:.2f} s" for pair, value in seconds.items())
    print(
        f"van der Pol over PathSim's {faster} ({spent}): one-shot {ratios[0]:.2f}, warm {ratios[1]:.3f}; difference "
        f"{off:.1e}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small: does everything run?")
    quick: bool = parser.parse_args().quick
    with tempfile.TemporaryDirectory() as cache:
        os.environ["PHYFILTER_CTL_CACHE"] = cache
        one_shot(quick)
        linear((10, 50) if quick else (10, 100, 200))
        chosen(quick)
        compilers((50,) if quick else (100, 300, 1000))
        batch(10 if quick else 100)
        by_hand()
    beside_pathsim(30.0)
    return 0


if __name__ == "__main__":
    sys.exit(main())
