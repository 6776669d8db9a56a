"""One run after another beside python-control: a diagram simulated for the first time, once more, and again and again.

Both sides get the same python-control system, the same times and inputs, and python-control's own tolerances (RK45,
rtol 1e-3, atol 1e-6); errors are those of the states at all times against a reference of its own. No compiler is found.
Linear systems are held against ``forced_response``; a sampled law, for which python-control has no block, against its
plant discretised and closed by hand, which ``input_output_response`` then runs step by step.

``first``: the first such system in a process that has run another one before; ``one-shot``: a further such system,
flattened and run at once; ``warm``: the same system (here: flattened) again. Milliseconds of processor time of one
thread, the least of all processes. Exits 1 where a ratio is above ``--limit``.

    python benchmarks/against_python_control.py [--quick] [--limit 1.0] [ROW ...]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import control as ct
import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import phyfilter_ctl as pf

RTOL, ATOL = 1e-3, 1e-6  # what scipy.integrate.solve_ivp takes where nobody says more
PERIOD = 1e-3
SHOTS, WARM = 5, 7


@dataclass(frozen=True)
class Row:
    """What both sides are asked for.

    ``make`` builds a fresh system for ours, ``twin`` for theirs; ``reference`` gives the first outputs (N, k).
    """

    name: str
    times: np.ndarray
    inputs: Any  # python-control says float, and means arrays too
    start: Any
    make: Callable[[], ct.InputOutputSystem]
    twin: Callable[[], Any]
    theirs: Callable[[Any, Row], ct.TimeResponseData]
    reference: Callable[[Row], np.ndarray]


def pendulum() -> ct.NonlinearIOSystem:
    return ct.nlsys(
        lambda t, x, u, params: [x[1], u[0] - 9.8 * np.sin(x[0]) - 0.2 * x[1]],
        lambda t, x, u, params: x[:1], inputs=1, outputs=1, states=2, name="pendulum",
    )  # fmt: skip


def pendulum_rates(x: np.ndarray, u: float) -> list[float]:
    return [x[1], u - 9.8 * np.sin(x[0]) - 0.2 * x[1]]


def cruise() -> ct.InputOutputSystem:
    plant = ct.nlsys(
        lambda t, x, u, params: [(u[0] - params["drag"] * x[0] * np.abs(x[0])) / params["m"]], None, inputs="f",
        outputs="v", states="v", params={"m": 2.0, "drag": 0.5}, name="plant",
    )  # fmt: skip
    law = ct.tf([3.0, 1.0], [1.0, 0.0], inputs="e", outputs="f", name="pi")
    error = ct.summing_junction(["r", "-v"], "e", name="error")
    return ct.interconnect([plant, law, error], inputs="r", outputs="v", name="cruise")


def cruise_rates(x: np.ndarray, u: float) -> list[float]:
    error = u - x[0]
    return [(3.0 * error + x[1] - 0.5 * x[0] * abs(x[0])) / 2.0, error]


def oscillator(mu: float) -> ct.NonlinearIOSystem:
    return ct.nlsys(
        lambda t, x, u, params: [x[1], mu * (1.0 - x[0] ** 2) * x[1] - x[0]],
        lambda t, x, u, params: x[:1], inputs=0, outputs=1, states=2, name="van_der_pol",
    )  # fmt: skip


def dense(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A stable system with poles all over the left half-plane, every entry of A filled."""
    rng = np.random.default_rng(n)
    A = rng.normal(size=(n, n)) / np.sqrt(n)
    A -= (1.1 + np.linalg.eigvals(A).real.max()) * np.eye(n)
    return A, rng.normal(size=(n, 1)), rng.normal(size=(1, n)) / n


def linear(n: int) -> ct.InputOutputSystem:
    A, B, C = dense(n)
    return ct.ss(A, B, C, 0.0, name="linear")


def loop_parts(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A plant of n states and its gain at rest, 1."""
    A, B, C = dense(n)
    return A, B, C / -(C @ np.linalg.solve(A, B))


def sampled_loop(n: int) -> ct.InputOutputSystem:
    """A PI law at 1 kHz on the plant."""
    A, B, C = loop_parts(n)
    plant = ct.ss(A, B, C, 0.0, name="plant", inputs="u", outputs="y")
    law = ct.ss(1.0, PERIOD, 0.5, 0.5, PERIOD, name="law", inputs="e", outputs="u")
    error = ct.summing_junction(["r", "-y"], "e", name="error")
    return ct.interconnect(
        [plant, pf.sampled_block(law, name="law"), error], inputs="r", outputs="y", name="loop"
    )


def sampled_twin(n: int) -> ct.InterconnectedSystem:
    A, B, C = loop_parts(n)
    plant = ct.sample_system(ct.ss(A, B, C, 0.0), PERIOD, "zoh")
    plant = ct.ss(plant.A, plant.B, plant.C, plant.D, PERIOD, name="plant", inputs="u", outputs="y")
    law = ct.ss(1.0, PERIOD, 0.5, 0.5, PERIOD, name="law", inputs="e", outputs="u")
    error = ct.summing_junction(["r", "-y"], "e", name="error", dt=PERIOD)
    return ct.interconnect([plant, law, error], inputs="r", outputs="y", name="loop", dt=PERIOD)


def response(system: Any, row: Row) -> ct.TimeResponseData:
    given = row.inputs if len(row.inputs) else 0.0
    return ct.input_output_response(system, row.times, given, row.start)


def forced(system: Any, row: Row) -> ct.TimeResponseData:
    return ct.forced_response(system, row.times, row.inputs, row.start)


def integrated(rates: Callable[[np.ndarray, float], list[float]]) -> Callable[[Row], np.ndarray]:
    """SciPy at tolerances far below, on inputs as straight lines between the times."""

    def reference(row: Row) -> np.ndarray:
        found = [np.array(row.start)]
        given = row.inputs[0] if len(row.inputs) else np.zeros(len(row.times))
        for k, (begin, end) in enumerate(pairwise(row.times)):

            def slope(
                t: float, x: np.ndarray, k: int = k, begin: float = begin, end: float = end
            ) -> list[float]:
                part = (t - begin) / (end - begin)
                return rates(x, (1.0 - part) * given[k] + part * given[k + 1])

            solved = solve_ivp(slope, (begin, end), found[-1], method="DOP853", rtol=1e-11, atol=1e-13)
            found.append(solved.y[:, -1])
        return np.array(found)[:, :1]

    return reference


def stepped(n: int) -> Callable[[Row], np.ndarray]:
    """Dense linear system by one exponential of (A, B, lines)."""

    def reference(row: Row) -> np.ndarray:
        A, B, C = dense(n)
        h = row.times[1] - row.times[0]
        big = np.zeros((n + 2, n + 2))
        big[:n, :n], big[:n, n : n + 1], big[n, n + 1] = A, B, 1.0
        power = expm(big * h)
        x, found = np.zeros(n), []
        u = row.inputs[0]
        for k in range(len(u)):
            found.append(C @ x)
            if k + 1 < len(u):
                x = power[:n] @ np.concatenate([x, [u[k], (u[k + 1] - u[k]) / h]])
        return np.array(found)

    return reference


def looped(n: int) -> Callable[[Row], np.ndarray]:
    def reference(row: Row) -> np.ndarray:
        A, B, C = loop_parts(n)
        power = expm(np.block([[A, B], [np.zeros((1, n + 1))]]) * PERIOD)
        x, s, found = np.zeros(n), 0.0, []
        for r in row.inputs[0]:
            y = C @ x
            found.append(y)
            u, s = 0.5 * s + 0.5 * (r - y[0]), s + PERIOD * (r - y[0])
            x = power[:n] @ np.append(x, u)
        return np.array(found)

    return reference


def rows() -> list[Row]:
    t10, t20, t30 = (np.linspace(0.0, end, 501) for end in (10.0, 20.0, 30.0))
    t5 = PERIOD * np.arange(5001)
    none = np.zeros((0, 501))

    def vdp(mu: float) -> Callable[[], ct.InputOutputSystem]:
        return lambda: oscillator(mu)

    found = [
        Row("pendulum", t10, np.sin(t10)[None], [0.0, 0.0], pendulum, pendulum, response, integrated(pendulum_rates)),
        Row("cruise control", t20, np.sin(t20)[None], [0.0, 0.0], cruise, cruise, response, integrated(cruise_rates)),
    ]  # fmt: skip
    for mu, times in ((1.0, t20), (5.0, t30)):

        def rates(x: np.ndarray, u: float, mu: float = mu) -> list[float]:
            return [x[1], mu * (1.0 - x[0] ** 2) * x[1] - x[0]]

        found.append(
            Row(f"van der Pol, mu = {mu:g}", times, none, [2.0, 0.0], vdp(mu), vdp(mu), response, integrated(rates))
        )  # fmt: skip
    for n in (10, 50, 200):
        made = linear_maker(n)
        found.append(
            Row(f"linear, {n} states", t10, np.sin(t10)[None], [0.0] * n, made, made, forced, stepped(n))
        )
    for n in (6, 30):
        ours, twin = loop_makers(n)
        found.append(
            Row(
                f"sampled law, {n} states",
                t5,
                np.sin(t5)[None],
                [0.0] * (n + 1),
                ours,
                twin,
                response,
                looped(n),
            )
        )
    return found


def linear_maker(n: int) -> Callable[[], ct.InputOutputSystem]:
    return lambda: linear(n)


def loop_makers(n: int) -> tuple[Callable[[], Any], Callable[[], Any]]:
    return lambda: sampled_loop(n), lambda: sampled_twin(n)


def simulate(system: Any, row: Row) -> ct.TimeResponseData:
    given = row.inputs if len(row.inputs) else None
    start = row.start[: len(row.start) - 1] if row.name.startswith("sampled") else row.start
    return pf.simulate(system, row.times, given, start, rtol=RTOL, atol=ATOL)


def measured(side: str, row: Row) -> dict[str, Any]:
    """Times of one side in this process."""
    make, work = (row.make, simulate) if side == "ours" else (row.twin, row.theirs)
    warm_up(side)
    systems = [make() for _ in range(SHOTS + 1)]
    shots = []
    answer: Any = None
    for system in systems:
        begin = time.thread_time()
        answer = work(system, row)
        shots.append(time.thread_time() - begin)
    kept = pf.flatten(systems[-1]) if side == "ours" else systems[-1]
    again = []
    for _ in range(WARM + 1):
        begin = time.thread_time()
        work(kept, row)
        again.append(time.thread_time() - begin)
    error = float(
        np.abs(np.reshape(answer.outputs, (-1, len(row.times)))[0] - row.reference(row)[:, 0]).max()
    )
    note = f"{answer.method}/{answer.backend}" if side == "ours" else ""
    return {
        "first": shots[0],
        "one-shot": min(shots[1:]),
        "warm": min(again[1:]),
        "error": error,
        "note": note,
    }


def warm_up(side: str) -> None:
    """Other systems of each kind, so that imports and the first use of each library are behind."""
    t = np.linspace(0.0, 1.0, 11)
    ones: Any = np.ones(11)
    wave: Any = np.sin(t)
    lag = ct.ss([[-1.0, 1.0], [0.0, -3.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0.0)
    drag = ct.nlsys(
        lambda t, x, u, params: [u[0] - x[0] ** 3], None, inputs=1, outputs=1, states=1, name="drag"
    )
    discrete = ct.ss(0.5, 1.0, 1.0, 0.0, 0.1)
    if side == "ours":
        pf.simulate(lag, t, 1.0)
        pf.simulate(drag, t, wave)
        return
    ct.forced_response(lag, t, ones)
    ct.input_output_response(drag, t, wave)
    ct.input_output_response(discrete, t, ones)


def least(side: str, name: str, processes: int) -> dict[str, Any]:
    """The least of several processes that find no compiler."""
    found: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as empty:
        bare = os.environ | {"PATH": empty, "CC": "", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        for _ in range(processes):
            command = [sys.executable, __file__, "--side", side, name]
            done = subprocess.run(command, env=bare, stdout=subprocess.PIPE, text=True, check=True)
            found.append(json.loads(done.stdout))
    return {key: min(one[key] for one in found) for key in found[0]}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*")
    parser.add_argument("--quick", action="store_true", help="one process a side")
    parser.add_argument("--limit", type=float, help="of every ratio")
    parser.add_argument("--side", help=argparse.SUPPRESS)
    options = parser.parse_args()
    known = {row.name: row for row in rows()}
    if options.side:
        print(json.dumps(measured(options.side, known[options.rows[0]])))
        return 0
    print(f"{'ms':22} {'first':>24} {'one-shot':>24} {'warm':>24} {'errors':>18}")
    largest = 0.0
    for name in [name for name in known if not options.rows or any(part in name for part in options.rows)]:
        ours, theirs = (least(side, name, 1 if options.quick else 3) for side in ("ours", "theirs"))
        cells = []
        for key in ("first", "one-shot", "warm"):
            ratio = ours[key] / theirs[key]
            largest = max(largest, ratio)
            cells.append(f"{1e3 * ours[key]:7.2f} /{1e3 * theirs[key]:7.2f} ={ratio:5.2f}")
        errors = f"{ours['error']:.1e} / {theirs['error']:.1e}"
        print(
            f"{name:22} " + " ".join(f"{cell:>24}" for cell in cells) + f" {errors:>18} {ours['note']}",
            flush=True,
        )
    print(f"largest ratio {largest:.2f}")
    return int(options.limit is not None and largest > options.limit)


if __name__ == "__main__":
    sys.exit(main())
