"""Smooth systems; the reference integrates the same equations, written for numbers."""

from __future__ import annotations

import math
from itertools import pairwise

import control as ct
import numpy as np
from scipy.linalg import expm

from tests.corpus.reference import smooth
from tests.corpus.system import System, block


def _equations(
    name: str, write, end: float, start, source: str = "", structure: str = "", short: bool = False,
    stiff: bool = False, times=None, plain=None,
) -> System:  # fmt: skip
    """``write(t, x)`` is what the user writes; ``plain`` the same for numbers where it is written another way."""
    return System(
        name, "smooth", structure or name, lambda: block(lambda t, x, u, p: write(t, x), len(start)),
        smooth(plain or write, solver="Radau" if stiff else "DOP853"), end, start, source=source, switching=False,
        stiff=stiff, short=short, times=times,
    )  # fmt: skip


def _linear(name: str, A, end: float, start, source: str = "") -> System:
    A = np.array(A, dtype=float)

    def build():
        n = len(A)
        return ct.ss(A, np.zeros((n, 1)), np.eye(n), np.zeros((n, 1)), inputs=1, outputs=n, name=name)

    return System(
        name, "smooth", "linear, free", build, lambda times, x0: np.array([expm(A * t) @ x0 for t in times]).T, end,
        start, source=source, switching=False, inputs=lambda times: np.zeros((1, len(times))),
    )  # fmt: skip


def _driven(name: str, num, den, end: float, source: str = "") -> System:
    """A transfer function under a sine given as an input: straight lines between the times."""
    times = np.linspace(0.0, end, 81)
    samples = np.sin(1.7 * times)
    gain, order = num / den[0], len(den) - 1

    def rates(t, x):
        u = np.interp(t, times, samples)
        return [*x[1:], gain * u - sum(c / den[0] * x[order - 1 - k] for k, c in enumerate(den[1:]))]

    def answer(points, x0):
        # Input of straight lines: piece by piece, each smooth.
        x, rows = np.zeros(order), [np.zeros(order)]
        for begin, finish in pairwise(points):
            x = smooth(rates)(np.array([begin, finish]), x)[:, -1]
            rows.append(x)
        return np.array(rows).T[:1]

    return System(
        name, "smooth", "transfer function driven by an input", lambda: ct.tf([num], den, inputs="u",
            outputs="y", name=name),
        answer, end, (0.0,) * order, times=times, source=source, switching=False,
        inputs=lambda points: np.sin(1.7 * points)[None], movable=0.0,
    )  # fmt: skip


def _robertson(t, x):
    return [
        -0.04 * x[0] + 1e4 * x[1] * x[2], 0.04 * x[0] - 1e4 * x[1] * x[2] - 3e7 * x[1] ** 2, 3e7 * x[1] ** 2,
    ]  # fmt: skip


def _three_bodies(t, x):
    """Three equal masses in a plane: positions (x, y) of each, then velocities."""
    pull = [0.0] * 6
    for i in range(3):
        for j in range(3):
            if i != j:
                dx, dy = x[2 * j] - x[2 * i], x[2 * j + 1] - x[2 * i + 1]
                r3 = (dx * dx + dy * dy) ** 1.5
                pull[2 * i] = pull[2 * i] + dx / r3
                pull[2 * i + 1] = pull[2 * i + 1] + dy / r3
    return [*[x[6 + k] for k in range(6)], *pull]


_EIGHT = (
    0.97000436, -0.24308753, -0.97000436, 0.24308753, 0.0, 0.0,
    0.466203685, 0.43236573, 0.466203685, 0.43236573, -0.93240737, -0.86473146,
)  # fmt: skip


def _cruise(t, x):
    """A car with a PI cruise controller on a hill that begins smoothly; forces in N, speed in m/s."""
    m, g, rho, cd, area, roll = 1600.0, 9.81, 1.3, 0.32, 2.4, 0.01
    slope = 4.0 / 180.0 * np.pi * 0.5 * (1.0 + np.tanh(2.0 * (t - 5.0)))
    error = 20.0 - x[0]
    throttle = 0.5 * error + x[1]
    omega = 12.0 * x[0]
    torque = 190.0 * (1.0 - 0.4 * (omega / 420.0 - 1.0) ** 2)
    drive = 12.0 * torque * throttle
    return [
        (drive - m * g * roll - 0.5 * rho * cd * area * x[0] ** 2 - m * g * np.sin(slope)) / m, 0.1 * error,
    ]  # fmt: skip


def _vehicle(t, x):
    """Kinematic bicycle with a steering sine."""
    delta = 0.3 * np.sin(0.7 * t)
    beta = np.arctan(0.5 * np.tan(delta))
    return [
        8.0 * np.cos(x[2] + beta), 8.0 * np.sin(x[2] + beta), 8.0 / 3.0 * np.cos(beta) * np.tan(delta),
    ]  # fmt: skip


def _vtol(t, x):
    """Planar vertical take-off aircraft in hover with small thrusts; x, y, theta and their rates."""
    m, J, r, g, c = 4.0, 0.0475, 0.25, 9.8, 0.05
    f1, f2 = 0.02 * np.sin(t), m * g + 0.5 * np.cos(0.5 * t)
    s, k = np.sin(x[2]), np.cos(x[2])
    return [
        x[3], x[4], x[5], (f1 * k - f2 * s - c * x[3]) / m, (f1 * s + f2 * k - m * g - c * x[4]) / m, r / J * f1,
    ]  # fmt: skip


def _tanks(t, x):
    a, k = 0.2, 0.5
    return [0.3 - a * np.sqrt(x[0]), a * np.sqrt(x[0]) - k * a * np.sqrt(x[1])]


def _cart_pole(t, x):
    m, M, g, L = 0.3, 1.0, 9.81, 0.6
    s, c = np.sin(x[1]), np.cos(x[1])
    force = 0.5 * np.sin(2.0 * t)
    down = M + m * s * s
    return [
        x[2], x[3], (force + m * s * (L * x[3] ** 2 + g * c)) / down,
        (-force * c - m * L * x[3] ** 2 * c * s - (M + m) * g * s) / (L * down),
    ]  # fmt: skip


def _double_pendulum(t, x):
    d = x[0] - x[1]
    s, c = np.sin(d), np.cos(d)
    down = 2.0 - c * c
    first = (-9.81 * (2 * np.sin(x[0]) - np.sin(x[1]) * c) - s * (x[3] ** 2 + x[2] ** 2 * c)) / down
    second = (-9.81 * 2 * (np.sin(x[1]) - np.sin(x[0]) * c) + s * (2 * x[2] ** 2 + x[3] ** 2 * c)) / down
    return [x[2], x[3], first, second]


def _heat(t, x):
    """A rod of eight cells whose ends are held at 1 and 0."""
    ends = [1.0, *[x[k] for k in range(8)], 0.0]
    return [40.0 * (ends[k] - 2 * ends[k + 1] + ends[k + 2]) for k in range(8)]


def systems() -> list[System]:
    """Of the family smooth."""
    late = np.concatenate([[0.0], np.logspace(-4, 4, 25)])
    return [
        _equations("pendulum", lambda t, x: [x[1], -9.81 * np.sin(x[0]) - 0.1 * x[1]], 10.0, (2.0, 0.0), short=True,
                   source="PathSim examples/example_pendulum.py"),
        _equations("van_der_pol_1", lambda t, x: [x[1], (1 - x[0] ** 2) * x[1] - x[0]], 20.0, (2.0, 0.0),
                   "textbook: B. van der Pol, 1926", "van der Pol"),
        _equations("van_der_pol_5", lambda t, x: [x[1], 5 * (1 - x[0] ** 2) * x[1] - x[0]], 15.0, (2.0, 0.0),
            structure="van der Pol"),
        _equations("van_der_pol_1000", lambda t, x: [x[1], 1000 * (1 - x[0] ** 2) * x[1] - x[0]], 700.0, (2.0, 0.0),
                   "PathSim examples_odes/example_vanderpol.py", "van der Pol", stiff=True),
        _equations("lotka_volterra", lambda t, x: [x[0] * (1.1 - 0.4 * x[1]), x[1] * (0.1 * x[0] - 0.4)], 30.0,
            (10.0, 5.0),
                   "PathSim examples_odes/example_volterralotka.py"),
        _equations("predator_prey_hare_lynx", lambda t, x: [
            1.6 * x[0] * (1 - x[0] / 125.0) - 3.2 * x[1] * x[0] / (50.0 + x[0]),
            0.6 * 3.2 * x[1] * x[0] / (50.0 + x[0]) - 0.56 * x[1]], 30.0, (20.0, 35.0),
                   "python-control examples/cds110-L4a_predprey-statefbk.ipynb"),
        _equations("robertson", _robertson, 1e4, (1.0, 0.0, 0.0),
            "PathSim examples_odes/example_robertson.py", stiff=True, times=late),
        _equations("lorenz", lambda t, x: [10 * (x[1] - x[0]), x[0] * (28.0 - x[2]) - x[1],
            x[0] * x[1] - 8 / 3 * x[2]], 6.0,
                   (1.0, 1.0, 1.0), "PathSim examples_odes/example_lorenz.py"),
        _equations("rossler", lambda t, x: [-x[1] - x[2], x[0] + 0.2 * x[1], 0.2 + x[2] * (x[0] - 5.7)], 15.0,
            (1.0, 1.0, 0.0)),
        _equations("three_bodies_eight", _three_bodies, 3.0, _EIGHT,
            "A. Chenciner and R. Montgomery, 2000: the figure eight"),
        _equations("kepler", lambda t, x: [x[2], x[3], -x[0] / (x[0] ** 2 + x[1] ** 2) ** 1.5,
            -x[1] / (x[0] ** 2 + x[1] ** 2) ** 1.5],
                   12.0, (0.5, 0.0, 0.0, math.sqrt(3.0)), "E. Hairer, S. Norsett, G. Wanner: the Kepler problem"),
        _equations("brusselator", lambda t, x: [1 + x[0] ** 2 * x[1] - 4 * x[0], 3 * x[0] - x[0] ** 2 * x[1]],
            15.0, (1.5, 3.0),
                   "PathSim examples_odes/example_brusselator.py"),
        _equations("fitzhugh_nagumo", lambda t, x: [x[0] - x[0] ** 3 / 3 - x[1] + 0.5,
            0.08 * (x[0] + 0.7 - 0.8 * x[1])], 60.0, (-1.0, 1.0),
                   "PathSim examples_odes/example_fitzhughnagumo.py"),
        _equations("duffing", lambda t, x: [x[1], x[0] - x[0] ** 3 - 0.2 * x[1] + 0.3 * np.cos(t)], 15.0, (1.0,
            0.0), "PathSim examples_odes/example_duffing.py"),
        _equations("inverted_pendulum", lambda t, x: [x[1],
            np.sin(x[0]) - np.cos(x[0]) * (1.6 * x[0] + 1.1 * x[1])], 10.0, (0.6, 0.0),
                   "python-control examples/cds110-L2_invpend-dynamics.ipynb"),
        _equations("oscillator_supercritical", lambda t, x: [x[1] + x[0] * (1 - x[0] ** 2 - x[1] ** 2),
            -x[0] + x[1] * (1 - x[0] ** 2 - x[1] ** 2)],
                   8.0, (0.1, 0.0), "python-control examples/phase_plane_plots.py"),
        _equations("cruise_control", _cruise, 20.0, (20.0, 0.1616), "python-control examples/cruise-control.py",
            short=True),
        _equations("vehicle_steering", _vehicle, 10.0, (0.0, 0.0, 0.0), "python-control examples/vehicle.py"),
        _equations("vtol", _vtol, 5.0, (0.0, 0.0, 0.1, 0.0, 0.0, 0.0),
            "python-control examples/pvtol.py"),
        _equations("two_tanks", _tanks, 30.0, (0.5, 1.0), "textbook: two tanks in series, Torricelli"),
        _equations("cart_pole", _cart_pole, 6.0, (0.0, 1.0, 0.0, 0.0),
            "Modelica.Mechanics.MultiBody: pendulum on a cart, its text"),
        _equations("double_pendulum", _double_pendulum, 4.0, (1.0, 0.6, 0.0, 0.0),
            "Modelica.Mechanics.MultiBody.Examples.Elementary.DoublePendulum"),
        _equations("logistic", lambda t, x: [2.0 * x[0] * (1.0 - x[0])], 6.0, (0.05,), "textbook: Verhulst"),
        _equations("sir", lambda t, x: [-0.4 * x[0] * x[1], 0.4 * x[0] * x[1] - 0.1 * x[1], 0.1 * x[1]], 60.0,
            (0.99, 0.01, 0.0), "textbook: SIR epidemic"),
        _equations("chemical_reactor", lambda t, x: [1.0 - x[0] - 7.2e10 / 60 * np.exp(-8750.0 / x[1]) * x[0],
                   350.0 - x[1] + 209.2 * 7.2e10 / 60 * np.exp(-8750.0 / x[1]) * x[0] + 2.09 * (300.0 - x[1])],
                       8.0, (0.9, 310.0), "textbook: stirred tank, D. Seborg et al."),
        _equations("rod_heat", _heat, 0.5, (0.0,) * 8, "Modelica.Thermal.HeatTransfer: conduction in a rod"),
        _equations("rigid_body", lambda t, x: [-2.0 * x[1] * x[2], 1.25 * x[0] * x[2], -0.5 * x[0] * x[1]],
            12.0, (1.0, 0.0, 0.9), "E. Hairer et al.: rigid body of Euler"),
        _equations("linear_drag", lambda t, x: [x[1], -9.81 - 0.1 * np.abs(x[1]) * x[1]], 3.0, (0.0, 25.0),
            structure="throw with quadratic drag"),
        _equations("glycolysis", lambda t, x: [-x[0] + 0.08 * x[1] + x[0] ** 2 * x[1],
            0.6 - 0.08 * x[1] - x[0] ** 2 * x[1]],
                   40.0, (0.0, 0.0), "PathSim examples_odes/example_glycolysis.py"),
        _equations("fairen_velarde", lambda t, x: [3.0 - x[0] - x[0] * x[1] / (1 + 6.5 * x[0] ** 2),
            2.0 - x[0] * x[1] / (1 + 6.5 * x[0] ** 2)],
                   30.0, (0.0, 0.0), "PathSim examples_odes/example_fairen_velarde.py"),
        _equations("morse", lambda t, x: [x[1],
            -0.8 * x[1] - 8.0 * (1 - np.exp(-x[0])) * np.exp(-x[0]) + 2.5 * np.cos(4.171 * t)],
                   12.0, (2.0, 3.0), "PathSim examples_odes/example_morse.py"),
        _equations("thomas", lambda t, x: [np.sin(x[1]) - 0.22 * x[0], np.sin(x[2]) - 0.22 * x[1],
            np.sin(x[0]) - 0.22 * x[2]],
                   20.0, (1.0, 1.0, -3.0), "PathSim examples_odes/example_thomas_cyclic.py"),
        _equations("chemical_oscillator", lambda t, x: [10.0 - x[0] - 4 * x[0] * x[1] / (1 + x[0] ** 2),
            x[0] * (1 - x[1] / (1 + x[0] ** 2))],
                   20.0, (0.0, 0.0), "PathSim examples_odes/example_chemical.py"),
        _equations("bonhoeffer", lambda t, x: [x[0] - x[0] ** 3 / 3 - x[1] + 0.6 * np.cos(t),
            0.1 * (x[0] + 0.7 - 0.8 * x[1])],
                   40.0, (0.0, 0.0), "PathSim examples_odes/example_bonhoeffer_vanderpol.py"),
        _equations("genetic_switch", lambda t, x: [4.0 / (1 + x[1] ** 2) - x[0], 4.0 / (1 + x[0] ** 2) - x[1]],
                   10.0, (1.0, 5.0), "python-control examples/genswitch.py"),
        _equations("adaptive_control", lambda t, x: [-x[0] + 0.5 * (x[3] * x[0] + x[2] * np.sin(t)),
            -2.0 * x[1] + 2.0 * np.sin(t),
                   -x[4] * (x[1] - x[0]), -x[5] * (x[1] - x[0]), -2.0 * x[4] - 2.0 * np.sin(t),
                       -2.0 * x[5] - 2.0 * x[0]],
                   20.0, (0.0,) * 6, "python-control examples/mrac_siso_mit.py"),
        _linear("two_mass_spring", [[0, 1, 0, 0], [-2, -0.1, 1, 0.05], [0, 0, 0, 1], [1, 0.05, -1, -0.05]],
            12.0, (1.0, 0, 0, 0),
                "python-control: mass-spring system"),
        _linear("decay_stiff_linear", [[-1.0, 1.0], [0.0, -300.0]], 4.0, (1.0, 2.0)),
        _linear("jordan", [[-1.0, 1.0, 0], [0, -1.0, 1.0], [0, 0, -1.0]], 6.0, (1.0, -1.0, 2.0)),
        _driven("lag_driven", 2.0, [1.0, 2.0], 6.0, "python-control: forced_response"),
        _driven("second_order_driven", 4.0, [1.0, 0.8, 4.0], 8.0, "Modelica.Blocks.Continuous.SecondOrder"),
        _driven("third_order_driven", 3.0, [1.0, 3.0, 4.0, 3.0], 8.0),
    ]  # fmt: skip
