"""Sampled laws on continuous plants, delays, filters, motors; diagrams in discrete time."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import control as ct
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.blocks import delay_line
from tests.corpus.reference import Exit, Hybrid, filippov, smooth
from tests.corpus.system import System


def _plant(rates, states: int = 1, measured=None, inputs: Sequence[str] = ("u",)) -> ct.NonlinearIOSystem:
    """x' = rates(t, x, u), y = x[0] or ``measured``."""
    return ct.nlsys(
        rates,
        measured or (lambda t, x, u, p: [x[0]]),
        inputs=list(inputs),
        outputs=["y"],
        states=states,
        name="plant",
    )


def _law(period: float, update, output, states: int, name: str = "law", inputs=("y",), outputs=("u",)):
    system = ct.nlsys(
        update,
        output,
        inputs=list(inputs),
        outputs=list(outputs),
        states=states or None,
        dt=period,
        name=name,
    )
    return pf.sampled_block(system)


def _closed(
    name: str, plant, law, rates, instants, end: float, outputs=None, states: int = 1, source: str = "",
    structure: str = "", short: bool = False, switching: bool = False, exits=None, begin=None, extra=(),
) -> System:  # fmt: skip
    """A plant under a law. The state of the reference is that of the plant, then what the law holds; it begins at 0."""

    def build():
        return ct.interconnect(
            [plant(), law(), *[each() for each in extra]],
            inputs=[],
            outputs=["y", "u"],
            inplist=[],
            name="loop",
        )

    reference = Hybrid(
        lambda t, x, mode: rates(t, x), exits or (lambda mode: ()), begin or (lambda t, x: ""),
        outputs or (lambda t, x, mode: [x[0], x[-1]]), instants,
    )  # fmt: skip
    return System(
        name, "sampled", structure or name, build, reference, end, hidden=(0.0,) * states,
        source=source, short=short, switching=switching,
    )  # fmt: skip


def _pi(period: float, limit: float | None) -> System:
    """A sampled PI law on a lag; with a limit, the integrator stops where the command is beyond it."""
    kp, ki = 2.0, 3.0

    def command(y, i):
        v = kp * (1.0 - y) + i
        return v if limit is None else np.clip(v, -limit, limit)

    def update(t, x, u, p):
        v = kp * (1.0 - u[0]) + x[0]
        grown = x[0] + ki * period * (1.0 - u[0])
        return [grown if limit is None else np.where(np.abs(v) > limit, x[0], grown)]

    def at(t, x):
        v, u = kp * (1.0 - x[0]) + x[1], command(x[0], x[1])
        stops = limit is not None and abs(v) > limit
        return [x[0], x[1] if stops else x[1] + ki * period * (1.0 - x[0]), u]

    return _closed(
        f"pi_sampled_{period:g}{'' if limit is None else f'_{limit:g}'}",
        lambda: _plant(lambda t, x, u, p: [-x[0] + u[0]]),
        lambda: _law(period, update, lambda t, x, u, p: [command(u[0], x[0])], 1),
        lambda t, x: [-x[0] + x[2], 0.0, 0.0], [(period, at)], 4.03, states=3,
        structure="sampled PI law on a lag" + ("" if limit is None else ", with limits"), short=limit is None,
        source="K. J. Astrom and B. Wittenmark, Computer-Controlled Systems" if limit is None else "",
    )  # fmt: skip


def _quantised(step: float) -> System:
    """A converter: the law sees the place to the nearest step."""
    period = 0.1

    def at(t, x):
        seen = step * np.round(x[0] / step)
        return [x[0], x[1], seen, 2.03 * (0.8317 - seen) - 1.17 * (seen - x[2]) / period]

    return _closed(
        f"quantised_measurement_{step:g}",
        lambda: _plant(lambda t, x, u, p: [x[1], u[0]], 2),
        lambda: _law(
            period, lambda t, x, u, p: [step * np.round(u[0] / step)],
            lambda t, x, u, p: [
                2.03 * (0.8317 - step * np.round(u[0] / step)) - 1.17 * (step * np.round(u[0] / step) - x[0]) / period
            ], 1,
        ),
        lambda t, x: [x[1], x[3], 0.0, 0.0], [(period, at)], 6.04, states=4, structure="law on a quantised place",
        source="Modelica.Clocked.RealSignals.Sampler.SampleWithADeffects, its text" if step == 0.02 else "",
    )  # fmt: skip


def _relay_sampled() -> System:
    period = 0.13

    def at(t, x):
        return [x[0], x[1], -1.0 if x[0] + 0.7 * x[1] > 0.01 else 1.0]

    return _closed(
        "relay_sampled", lambda: _plant(lambda t, x, u, p: [x[1], u[0] - 0.213], 2, lambda t, x, u,
            p: [x[0] + 0.7 * x[1]]),
        lambda: _law(period, None, lambda t, x, u, p: [np.where(u[0] > 0.01, -1.0, 1.0)], 0),
        lambda t, x: [x[1], x[2] - 0.213, 0.0], [(period, at)], 5.07, lambda t, x, mode: [x[0] + 0.7 * x[1],
            x[2]], states=3,
    )  # fmt: skip


def _hysteresis_sampled() -> System:
    period = 0.2

    def at(t, x):
        on = 0.0 if x[0] > 22.0 else 1.0 if x[0] < 19.0 else x[1]
        return [x[0], on, 4.0 * on]

    return _closed(
        "thermostat_sampled", lambda: _plant(lambda t, x, u, p: [-0.2 * (x[0] - 10.0) + u[0]]),
        lambda: _law(
            period, lambda t, x, u, p: [np.where(u[0] > 22.0, 0.0, np.where(u[0] < 19.0, 1.0, x[0]))],
            lambda t, x, u, p: [4.0 * np.where(u[0] > 22.0, 0.0, np.where(u[0] < 19.0, 1.0, x[0]))], 1,
        ),
        lambda t, x: [-0.2 * (x[0] - 10.0) + x[2], 0.0, 0.0], [(period, at)], 30.1, states=3,
        source="Modelica.Blocks.Logical.OnOffController, its text",
    )  # fmt: skip


def _two_rates() -> System:
    """Position outside at 10 Hz, speed inside at 50 Hz."""

    def outer(t, x):
        return [x[0], x[1], 1.5 * (1.0 - x[0]), x[3]]

    def inner(t, x):
        return [x[0], x[1], x[2], 4.0 * (x[2] - x[1])]

    def plant():
        return ct.nlsys(
            lambda t, x, u, p: [x[1], u[0] - 0.4 * x[1]], lambda t, x, u, p: [x[0], x[1]], inputs=["u"],
            outputs=["y", "v"], states=2, name="plant",
        )  # fmt: skip

    return _closed(
        "two_rates", plant,
        lambda: _law(0.1, None, lambda t, x, u, p: [1.5 * (1.0 - u[0])], 0, "outer", ("y",), ("want",)),
        lambda t, x: [x[1], x[3] - 0.4 * x[1], 0.0, 0.0], [(0.1, outer), (0.02, inner)], 5.011, states=4,
        extra=(lambda: _law(0.02, None, lambda t, x, u, p: [4.0 * (u[0] - u[1])], 0, "inner", ("want", "v"),
            ("u",)),),
        source="PathSim examples/example_cascade.py, its idea",
    )  # fmt: skip


def _held_sine() -> System:
    """A sine through a sampler and a hold into a lag."""

    def plant():
        return _plant(lambda t, x, u, p: [2.0 * (u[0] - x[0])])

    def law():
        return _law(0.15, None, lambda t, x, u, p: [u[0]], 0, inputs=("s",))

    def source():
        return ct.nlsys(None, lambda t, x, u, p: [np.sin(2.0 * t)], inputs=[], outputs=["s"], name="sine")

    return _closed(
        "held_sine", plant, law, lambda t, x: [2.0 * (x[1] - x[0]), 0.0], [(0.15, lambda t, x: [x[0],
            np.sin(2.0 * t)])],
        4.02, states=2, extra=(source,), source="Modelica.Blocks.Discrete.ZeroOrderHold, its text",
    )  # fmt: skip


def _delayed(steps: int) -> System:
    """A proportional law whose command comes late by whole samples."""
    period = 0.05

    def at(t, x):
        wanted = 1.5 * (1.0 - x[0])
        line = [*x[1:-1], wanted]
        return [x[0], *line[1:], line[0]] if steps else [x[0], wanted]

    def law():
        return _law(period, None, lambda t, x, u, p: [1.5 * (1.0 - u[0])], 0, outputs=("w",))

    def line():
        return delay_line(["w"], steps, period, name="line", outputs=["u"])

    return _closed(
        f"delay_line_{steps}", lambda: _plant(lambda t, x, u, p: [u[0] - 0.1 * x[0]]), law,
        lambda t, x: [x[-1] - 0.1 * x[0], *[0.0] * (len(x) - 1)], [(period, at)], 5.03, states=2 + steps,
            extra=(line,),
        structure="sampled law and delay line",
    )  # fmt: skip


def _pade(delay: float, limited: bool) -> System:
    """A loop with a dead time as Pade's approximant of second order."""

    def build():
        num, den = ct.pade(delay, 2)
        late = ct.ss(ct.tf(num, den), inputs=["u"], outputs=["d"], name="delay")
        plant = ct.nlsys(
            lambda t, x, u, p: [u[0] - 0.5 * x[0]],
            lambda t, x, u, p: [x[0]],
            inputs=["d"],
            outputs=["y"],
            states=1,
            name="plant",
        )
        law = ct.nlsys(
            lambda t, x, u, p: [1.0 - u[0]],
            lambda t, x, u, p: [np.clip(1.2 * (1.0 - u[0]) + 0.8 * x[0], -0.7,
            0.7) if limited else 1.2 * (1.0 - u[0]) + 0.8 * x[0]],
            inputs=["y"], outputs=["u"], states=1, name="law",
        )  # fmt: skip
        return ct.interconnect([plant, law, late], inputs=[], outputs=["y"], inplist=[], name="late")

    T = delay

    def raw(x):
        return 1.2 * (1.0 - x[0]) + 0.8 * x[1]

    def rates(t, x, k):
        u = (-0.7, raw(x), 0.7)[k] if limited else raw(x)
        return [u - x[3] - 0.5 * x[0], 1.0 - x[0], x[3] / T, (-12.0 * x[2] - 6.0 * x[3] + 12.0 * u) / T]

    def exits(k):
        found = []
        if limited and k < 2:
            found.append(Exit(lambda t, x: raw(x) - (-0.7, 0.7)[k], k + 1))
        if limited and k > 0:
            found.append(Exit(lambda t, x: (-0.7, 0.7)[k - 1] - raw(x), k - 1))
        return found

    reference = Hybrid(
        rates,
        exits,
        lambda t, x: int(np.searchsorted([-0.7, 0.7], raw(x))) if limited else 1,
        lambda t, x, k: [x[0]],
    )
    return System(
        f"pade_{delay:g}{'_limited' if limited else ''}", "delays",
            "loop with Pade's delay" + (", limited" if limited else ""),
        build, reference, 8.0, hidden=(0.0,) * 4, switching=False,
        source="PathSim examples/example_pid_antiwindup.py, its idea" if limited else "python-control: pade",
    )  # fmt: skip


def _pwm() -> System:
    """A pulse width from a law, compared with a saw of time: a buck converter."""
    period, supply = 0.02, 10.0

    def build():
        plant = ct.nlsys(
            lambda t, x, u, p: [
                (np.where(np.mod(t, period) < period * u[0], supply, 0.0) - x[1] - 0.1 * x[0]) / 0.5,
                (x[0] - x[1] / 2.0) / 0.2,
            ],
            lambda t, x, u, p: [x[1]], inputs=["u"], outputs=["y"], states=2, name="plant",
        )  # fmt: skip
        law = _law(period, None, lambda t, x, u, p: [np.clip(0.4 + 0.05 * (4.0 - u[0]), 0.05, 0.95)], 0)
        return ct.interconnect([plant, law], inputs=[], outputs=["y", "u"], inplist=[], name="converter")

    def rates(t, x, on):
        return [((supply if on else 0.0) - x[1] - 0.1 * x[0]) / 0.5, (x[0] - x[1] / 2.0) / 0.2, 0.0, 0.0]

    def at(t, x):
        return [x[0], x[1], t, float(np.clip(0.4 + 0.05 * (4.0 - x[1]), 0.05, 0.95))]

    reference = Hybrid(
        rates, lambda on: (Exit(lambda t, x: t - x[2] - period * x[3], False),) if on else (),
        lambda t, x: t - x[2] < period * x[3], lambda t, x, mode: [x[1], x[3]], [(period, at)],
    )  # fmt: skip
    return System(
        "buck_converter", "sampled", "pulse width by a sampled law", build,
        reference, 0.61, hidden=(0.0,) * 4, source="Modelica.Electrical.PowerConverters.DCDC, its idea",
    )  # fmt: skip


def _delta_sigma() -> System:
    period = 0.01

    def build():
        plant = ct.nlsys(
            lambda t, x, u, p: [np.sin(2 * np.pi * t) - u[0]],
            lambda t, x, u, p: [x[0]],
            inputs=["u"],
            outputs=["y"],
            states=1,
            name="plant",
        )
        return ct.interconnect(
            [plant, _law(period, None, lambda t, x, u, p: [np.where(u[0] > 0.001, 1.0, -1.0)], 0)],
            inputs=[],
            outputs=["y", "u"],
            inplist=[],
            name="modulator",
        )

    reference = Hybrid(
        lambda t, x, mode: [np.sin(2 * np.pi * t) - x[1], 0.0], outputs=lambda t, x, mode: [x[0], x[1]],
        instants=[(period, lambda t, x: [x[0], 1.0 if x[0] > 0.001 else -1.0])],
    )  # fmt: skip
    return System("delta_sigma", "sampled", "delta-sigma modulator", build, reference, 0.804, hidden=(0.0,) * 2,
                  source="PathSim examples/example_deltasigma.py", switching=False)  # fmt: skip


def _sampled_friction() -> System:
    """A sampled PD law that moves a mass with Coulomb friction: it stops short of the set point."""
    period, level = 0.05, 0.3

    def build():
        plant = ct.nlsys(
            lambda t, x, u, p: [x[1], u[0] - level * np.sign(x[1])], lambda t, x, u, p: [x[0], x[1]], inputs=["u"],
            outputs=["y", "v"], states=2, name="plant",
        )  # fmt: skip
        law = _law(period, None, lambda t, x, u, p: [4.0 * (1.0 - u[0]) - 2.0 * u[1]], 0, inputs=("y", "v"))
        return ct.interconnect([plant, law], inputs=[], outputs=["y", "v"], inplist=[], name="servo")

    reference = filippov(
        lambda t, x, s: [x[1], x[2] - level * s[0], 0.0], lambda t, x: [x[1]], lambda t, x, s: [x[2] - level * s[0]],
        lambda t, x, s: [x[0], x[1]], instants=[(period, lambda t, x: [x[0], x[1], 4.0 * (1.0 - x[0]) - 2.0 * x[1]])],
    )  # fmt: skip
    return System(
        "servo_stops_short",
        "sampled",
        "sampled law, Coulomb friction",
        build,
        reference,
        5.02,
        hidden=(0.0,) * 3,
        short=True,
    )


# -- motors -------------------------------------------------------------------------------------------------------

R, L, K, J, B, COULOMB = 1.0, 0.02, 0.1, 0.01, 0.002, 0.06
KP, KI, WANT, POLE, LATE = 0.3, 1.5, 5.0, 30.0, 0.01


def _motor_rates(i: float, w: float, volt: float, s: float) -> tuple[float, float]:
    return (volt - R * i - K * w) / L, (K * i - B * w - COULOMB * s) / J


def _motor_block() -> ct.NonlinearIOSystem:
    return ct.nlsys(
        lambda t, x, u, p: [
            (u[0] - R * x[0] - K * x[1]) / L, (K * x[0] - B * x[1] - COULOMB * np.sign(x[1])) / J,
        ],
        lambda t, x, u, p: [x[0], x[1], K * x[0]], inputs=["v"], outputs=["i", "x[0]", "g[0]"], states=2,
            name="motor",
    )  # fmt: skip


def _zero() -> ct.NonlinearIOSystem:
    return ct.nlsys(None, lambda t, x, u, p: [0.0], inputs=[], outputs=["f_theta[0]"], name="unlearned")


def _motor_continuous() -> System:
    """A motor with Coulomb friction from rest: PI law, estimate of a filter fed back, Pade's delay of the voltage."""

    def build():
        law = ct.nlsys(
            lambda t, x, u, p: [WANT - u[0]],
            lambda t, x, u, p: [KP * (WANT - u[0]) + KI * x[0] - 0.5 * R / K * u[1]],
            inputs=["x[0]", "f_hat[0]"], outputs=["c"], states=1, name="law",
        )  # fmt: skip
        late = ct.ss(ct.tf(*ct.pade(LATE, 2)), inputs=["c"], outputs=["v"], name="delay")
        filter = pf.phyfilter_block(pf.PhyFilter([POLE]), 1, inertia=J)
        return ct.interconnect(
            [_motor_block(), law, late, filter, _zero()], inputs=[], outputs=["x[0]", "i", "f_hat[0]"], inplist=[],
            name="drive",
        )  # fmt: skip

    # States: i, w, integral, z of the filter (z = f_hat - POLE J w, f_theta = 0), two of the delay.
    def estimate(x):
        return x[3] + POLE * J * x[1]

    def rates(t, x, s):
        command = KP * (WANT - x[1]) + KI * x[2] - 0.5 * R / K * estimate(x)
        volt = command - x[5]
        di, dw = _motor_rates(x[0], x[1], volt, s[0])
        return [
            di, dw, WANT - x[1], POLE * (-K * x[0] - estimate(x)), x[5] / LATE,
            (-12.0 * x[4] - 6.0 * x[5] + 12.0 * command) / LATE,
        ]  # fmt: skip

    reference = filippov(
        rates,
        lambda t, x: [x[1]],
        lambda t, x, s: [rates(t, x, s)[1]],
        lambda t, x, s: [x[1], x[0], estimate(x)],
    )
    return System(
        "motor_filter_delay", "motors", "DC motor, Coulomb friction, PI, filter, Pade's delay", build,
        reference, 3.0, hidden=(0.0,) * 6, short=True,
    )  # fmt: skip


def _motor_sampled() -> System:
    """The same with a computer: PI law and filter every 5 ms, the voltage comes a sample later."""
    h = 0.005
    keep = float(np.exp(-POLE * h))

    def build():
        law = _law(
            h, lambda t, x, u, p: [x[0] + h * (WANT - u[0])],
            lambda t, x, u, p: [KP * (WANT - u[0]) + KI * x[0] - 0.5 * R / K * u[1]], 1,
            inputs=("x[0]", "f_hat[0]"), outputs=("c",),
        )  # fmt: skip
        filter = pf.sampled_block(pf.PhyFilter([POLE]).sampled(h), 1, inertia=J)
        line = delay_line(["c"], 1, h, name="line", outputs=["v"])
        return ct.interconnect(
            [_motor_block(), law, filter, line, _zero()], inputs=[], outputs=["x[0]", "i", "f_hat[0]"], inplist=[],
            name="drive",
        )  # fmt: skip

    # States: i, w, integral, estimate, w and g at the last sample, command of the last sample, voltage, count.
    def at(t, x):
        i, w, integral, estimate, before, known, last, _, count = x
        if count > 0.5:
            estimate = keep * estimate + (1.0 - keep) * (J * (w - before) / h - known)
        command = KP * (WANT - w) + KI * integral - 0.5 * R / K * estimate
        return [i, w, integral + h * (WANT - w), estimate, w, K * i, command, last, count + 1.0]

    def rates(t, x, s):
        return [*_motor_rates(x[0], x[1], x[7], s[0]), *[0.0] * 7]

    reference = filippov(
        rates, lambda t, x: [x[1]], lambda t, x, s: [rates(t, x, s)[1]], lambda t, x, s: [x[1], x[0], x[3]],
        instants=[(h, at)],
    )  # fmt: skip
    return System(
        "motor_sampled", "motors", "DC motor, Coulomb friction, sampled PI and filter, sample of delay", build,
        reference, 2.0, hidden=(0.0,) * 9, times=np.linspace(0.0, 2.0, 41) + np.linspace(0, 1e-3, 41),
    )  # fmt: skip


def _motor_plain(name: str, want: float, viscous: bool) -> System:
    """Without a filter: a PI law, friction with or without Coulomb's."""
    level = 0.0 if viscous else COULOMB

    def build():
        motor = ct.nlsys(
            lambda t, x, u, p: [(u[0] - R * x[0] - K * x[1]) / L, (K * x[0] - B * x[1] - level * np.sign(x[1])) / J],
            lambda t, x, u, p: [x[1]], inputs=["v"], outputs=["w"], states=2, name="motor",
        )  # fmt: skip
        law = ct.nlsys(
            lambda t, x, u, p: [want - u[0]], lambda t, x, u, p: [KP * (want - u[0]) + KI * x[0]], inputs=["w"],
            outputs=["v"], states=1, name="law",
        )  # fmt: skip
        return ct.interconnect([motor, law], inputs=[], outputs=["w", "v"], inplist=[], name="drive")

    def rates(t, x, s):
        volt = KP * (want - x[1]) + KI * x[2]
        di, dw = (volt - R * x[0] - K * x[1]) / L, (K * x[0] - B * x[1] - level * s[0]) / J
        return [di, dw, want - x[1]]

    def outputs(t, x, s):
        return [x[1], KP * (want - x[1]) + KI * x[2]]

    if viscous:
        reference = smooth(lambda t, x: rates(t, x, [0.0]), outputs=lambda t, x, mode: outputs(t, x, None))
    else:
        reference = filippov(rates, lambda t, x: [x[1]], lambda t, x, s: [rates(t, x, s)[1]], outputs)
    return System(
        name, "motors", "DC motor and PI law" + ("" if viscous else ", Coulomb friction"), build, reference,
            4.0, (0.0,) * 3,
        source="PathSim examples/example_dcmotor.py" if viscous else "", switching=not viscous,
    )  # fmt: skip


def _motor_reversal() -> System:
    """Turned back and forth under a sine of voltage: it sticks at each reversal."""

    def build():
        return ct.nlsys(
            lambda t, x, u, p: [
                (2.0 * np.sin(3.0 * t) - R * x[0] - K * x[1]) / L,
                (K * x[0] - B * x[1] - COULOMB * np.sign(x[1])) / J,
            ],
            None, inputs=0, outputs=2, states=2, name="motor",
        )  # fmt: skip

    def rates(t, x, s):
        return _motor_rates(x[0], x[1], 2.0 * np.sin(3.0 * t), s[0])

    return System(
        "motor_reversals", "motors", "DC motor under a sine, Coulomb friction", build,
        filippov(rates, lambda t, x: [x[1]], lambda t, x, s: [rates(t, x, s)[1]]), 5.0, (0.0, 0.0),
        source="Modelica.Electrical.Machines: DC permanent magnet, with friction losses, its text",
    )  # fmt: skip


# -- discrete time ------------------------------------------------------------------------------------------------


def _discrete(name: str, step: Callable, start, count: int, source: str = "") -> System:
    def build():
        return ct.nlsys(
            lambda t, x, u, p: step(x),
            None,
            inputs=0,
            outputs=len(start),
            states=len(start),
            dt=0.1,
            name=name,
        )

    def answer(times, x0):
        rows = [np.array(x0)]
        for _ in times[1:]:
            rows.append(np.array(step(rows[-1]), dtype=float))
        return np.array(rows).T

    return System(
        name,
        "discrete",
        name,
        build,
        answer,
        0.1 * count,
        start,
        times=0.1 * np.arange(count + 1),
        source=source,
        switching=False,
        fmu=False,
    )


def _rounds(x):
    return [0.9 * x[0] + 0.3 * np.round(3.0 * x[1]) / 3.0, np.clip(x[1] - 0.4 * x[0], -1.0, 1.0)]


def systems() -> list[System]:
    """Of the families sampled, delays, motors and discrete."""
    return [
        _pi(0.1, None), _pi(0.3, None), _pi(0.1, 1.3), _quantised(0.02), _quantised(0.1), _relay_sampled(),
            _hysteresis_sampled(),
        _two_rates(), _held_sine(), _delayed(1), _delayed(4), _delayed(9), _pade(0.3, False), _pade(0.6, False),
            _pade(0.3, True),
        _pwm(), _delta_sigma(), _sampled_friction(), _motor_continuous(), _motor_sampled(),
            _motor_plain("motor_coulomb", 5.0, False),
        _motor_plain("motor_viscous", 5.0, True), _motor_plain("motor_coulomb_backwards", -3.0, False),
            _motor_reversal(),
        _discrete("logistic_map", lambda x: [3.2 * x[0] * (1.0 - x[0])], (0.3,), 40,
            "python-control: simulating_discrete_nonlinear.ipynb, its kind"),
        _discrete("rounding_map", _rounds, (1.0, 0.2), 40), _discrete("parity_map",
            lambda x: [np.where(np.mod(x[0], 2.0) < 0.5, x[0] / 2.0, 3.0 * x[0] + 1.0)], (27.0,), 60,
            "textbook: Collatz"),
    ]  # fmt: skip
