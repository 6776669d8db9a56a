"""Relays with and without hysteresis, Coulomb friction that slides and sticks."""

from __future__ import annotations

import control as ct
import numpy as np

import phyfilter_ctl as pf
from tests.corpus.reference import filippov, relay
from tests.corpus.system import System, block

# -- relays -------------------------------------------------------------------------------------------------------


def _relay_sliding(gain: float, load: float) -> System:
    """x' = load sin t - gain sign x: comes to 0 in finite time and stays, for gain > load."""

    def build():
        return block(lambda t, x, u, p: [load * np.sin(t) - gain * np.sign(x[0])])

    reference = filippov(
        lambda t, x, s: [load * np.sin(t) - gain * s[0]],
        lambda t, x: [x[0]],
        lambda t, x, s: [load * np.sin(t) - gain * s[0]],
    )
    return System(
        f"relay_sliding_{gain:g}_{load:g}", "relays", "x' = d(t) - k sign(x)", build, reference, 4.0, (0.8,),
        source="A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, 1988" if load == 0.5 else "",
        short=load == 0.5,
    )  # fmt: skip


def _sliding_surface(slope: float) -> System:
    """A double integrator under a relay on x2 + c x1."""

    def build():
        return block(lambda t, x, u, p: [x[1], -np.sign(x[1] + slope * x[0])], 2)

    reference = filippov(
        lambda t, x, s: [x[1], -s[0]],
        lambda t, x: [x[1] + slope * x[0]],
        lambda t, x, s: [-s[0] + slope * x[1]],
    )
    return System(
        f"sliding_surface_{slope:g}", "relays", "x'' = -sign(x' + c x)", build, reference, 5.0, (1.0, 0.2),
        source="V. I. Utkin, Sliding Modes in Control and Optimization, 1992" if slope == 1.0 else "",
        short=slope == 1.0,
    )  # fmt: skip


def _sliding_disturbed() -> System:
    """The same under a disturbance that throws it off the surface once."""

    def push(t):
        return 1.6 * np.sin(1.5 * t)

    def build():
        return block(lambda t, x, u, p: [x[1], push(t) - 1.2 * np.sign(x[1] + 0.8 * x[0])], 2)

    reference = filippov(
        lambda t, x, s: [x[1], push(t) - 1.2 * s[0]], lambda t, x: [x[1] + 0.8 * x[0]],
        lambda t, x, s: [push(t) - 1.2 * s[0] + 0.8 * x[1]],
    )  # fmt: skip
    return System(
        "sliding_thrown_off", "relays", "x'' = d(t) - k sign(x' + c x)", build, reference, 6.0, (0.6, 0.0)
    )


def _bang_bang() -> System:
    """Time-optimal control of a double integrator: u = -sign(x1 + x2 |x2| / 2), at rest in 0 afterwards."""

    def build():
        return block(lambda t, x, u, p: [x[1], -np.sign(x[0] + 0.6 * x[1] * np.abs(x[1]))], 2)

    reference = filippov(
        lambda t, x, s: [x[1], -s[0]], lambda t, x: [x[0] + 0.6 * x[1] * abs(x[1])],
        lambda t, x, s: [x[1] - 1.2 * abs(x[1]) * s[0]],
    )  # fmt: skip
    return System(
        "bang_bang", "relays", "x'' = -sign(x + a x' |x'|)", build, reference, 2.0, (1.0, 0.0),
        source="K. J. Astrom and R. M. Murray, Feedback Systems: minimum-time double integrator",
    )  # fmt: skip


def _relay_feedback(order: int) -> System:
    """A relay around a lag of second or third order, outside a sliding mode."""

    def build():
        if order == 2:
            return block(lambda t, x, u, p: [x[1], -x[0] - 0.5 * x[1] - 1.5 * np.sign(x[0] - 0.3)], 2)
        return block(
            lambda t, x, u, p: [
                x[1],
                x[2],
                -x[0] - 3 * x[1] - 1.2 * x[2] - 2.0 * np.where(x[0] > 0, 1.0, -1.0),
            ],
            3,
        )

    if order == 2:
        reference = filippov(
            lambda t, x, s: [x[1], -x[0] - 0.5 * x[1] - 1.5 * s[0]],
            lambda t, x: [x[0] - 0.3],
            lambda t, x, s: [x[1]],
        )
    else:
        reference = filippov(
            lambda t, x, s: [x[1], x[2], -x[0] - 3 * x[1] - 1.2 * x[2] - 2.0 * s[0]], lambda t, x: [x[0]],
            lambda t, x, s: [x[1]],
        )  # fmt: skip
    return System(
        f"relay_feedback_{order}", "relays", f"relay around a lag of order {order}", build, reference, 5.0,
        (1.0, 0.0, 0.5)[:order],
        source="K. J. Astrom and T. Hagglund, relay tuning of PID controllers, 1984" if order == 3 else "",
    )  # fmt: skip


def _thermostat(low: float, high: float) -> System:
    """A room with a switch that remembers, as a hybrid block."""

    def build():
        room = ct.nlsys(
            lambda t, x, u, p: [-0.2 * (x[0] - 10.0) + 4.0 * u[0]], lambda t, x, u, p: [x[0]], inputs=["heat"],
            outputs=["T"], states=["T"], name="room",
        )  # fmt: skip
        switch = ct.nlsys(
            lambda t, x, u, p: [0.0], lambda t, x, u, p: [x[0]], inputs=["T"], outputs=["heat"], states=["on"],
            name="switch",
        )  # fmt: skip
        switch = pf.hybrid(
            switch,
            [
                pf.event(
                    lambda t, x, u, p: u[0] - low, lambda t, x, u, p: [1.0], direction="falling", name="cold"
                ),
                pf.event(
                    lambda t, x, u, p: u[0] - high, lambda t, x, u, p: [0.0], direction="rising", name="warm"
                ),
            ],
        )
        return ct.interconnect([room, switch], inputs=[], outputs=["T"], inplist=[], name="house")

    # In mode 1 it is warm enough: heating is off.
    reference = relay(
        lambda t, x: x[0], low, high, lambda t, x, mode: [-0.2 * (x[0] - 10.0) + (0.0 if mode == 1 else 4.0), 0.0],
        lambda x: -1 if x[1] > 0.5 else 1, outputs=lambda t, x, mode: [x[0]],
    )  # fmt: skip
    return System(
        f"thermostat_{low:g}_{high:g}", "relays", "thermostat with memory (hybrid)", build, reference, 20.0,
        (19.7, 1.0), movable=(1.0, 0.0),
        source="M. Tiller, Modelica by Example: hysteresis" if low == 18.0 else "", short=low == 18.0,
    )  # fmt: skip


# -- friction -----------------------------------------------------------------------------------------------------


def _mass(
    name: str, force, level: float, viscous: float = 0.0, spring: float = 0.0, mass: float = 1.0, end: float = 4.0,
    start=(0.0, 0.0), source: str = "", short: bool = False, structure: str = "", pace: float = 0.0,
) -> System:  # fmt: skip
    """m x'' = force(t) - spring x - viscous x' - level sign(x')."""

    def build():
        return block(
            lambda t, x, u, p: [
                x[1], (force(t) - spring * x[0] - viscous * x[1] - level * np.sign(x[1])) / mass
            ], 2,
        )  # fmt: skip

    def rate(t, x, s):
        return (force(t) - spring * x[0] - viscous * x[1] - level * s[0]) / mass

    reference = filippov(
        lambda t, x, s: [x[1], rate(t, x, s)], lambda t, x: [x[1]], lambda t, x, s: [rate(t, x, s)]
    )
    return System(
        name, "friction", structure or "m x'' = F(t) - k x - d x' - Fc sign(x')", build, reference, end, start,
        source=source, short=short, pace=pace,
    )  # fmt: skip


def _stribeck(name: str, force, end: float, start=(0.0, 0.0), source: str = "") -> System:
    def curve(v):
        return 0.6 + 0.5 * np.exp(-((v / 0.1) ** 2))

    def build():
        return block(lambda t, x, u, p: [x[1], force(t) - 0.2 * x[1] - curve(x[1]) * np.sign(x[1])], 2)

    def rate(t, x, s):
        return force(t) - 0.2 * x[1] - curve(x[1]) * s[0]

    reference = filippov(
        lambda t, x, s: [x[1], rate(t, x, s)], lambda t, x: [x[1]], lambda t, x, s: [rate(t, x, s)]
    )
    return System(name, "friction", "Stribeck curve", build, reference, end, start, source=source)


def _belt(speed: float, end: float) -> System:
    """A block on a belt, held by a spring: it sticks to the belt and slips back."""

    def curve(v):
        return 0.5 + 0.5 / (1.0 + 2.0 * np.abs(v))

    def build():
        return block(lambda t, x, u, p: [x[1], -x[0] - curve(x[1] - speed) * np.sign(x[1] - speed)], 2)

    def rate(t, x, s):
        return -x[0] - curve(x[1] - speed) * s[0]

    reference = filippov(
        lambda t, x, s: [x[1], rate(t, x, s)], lambda t, x: [x[1] - speed], lambda t, x, s: [rate(t, x, s)]
    )
    return System(
        f"belt_{speed:g}", "friction", "block on a belt, stick-slip", build, reference, end, (0.0, 0.0),
        source="R. I. Leine et al., Stick-slip vibrations by alternate friction models, 1998" if speed == 0.2 else "",
    )  # fmt: skip


def _driven_belt() -> System:
    """A damped block on a belt that moves back and forth."""
    m, k, d, grip, v, w = 20.0, 70.0, 10.0, 1.5 * 9.81 * 20.0, 3.0, 2 * np.pi / 50.0

    def build():
        return block(
            lambda t, x, u, p: [x[1], -(k * x[0] + d * x[1] + grip * np.sign(x[1] - v * np.sin(w * t))) / m],
            2,
        )

    def rate(t, x, s):
        return -(k * x[0] + d * x[1] + grip * s[0]) / m

    reference = filippov(
        lambda t, x, s: [x[1], rate(t, x, s)], lambda t, x: [x[1] - v * np.sin(w * t)],
        lambda t, x, s: [rate(t, x, s) - v * w * np.cos(w * t)],
    )  # fmt: skip
    return System(
        "belt_back_and_forth", "friction", "block on a belt that turns back", build, reference, 60.0, (0.0, 0.0),
        source="PathSim examples/example_stickslip.py",
    )  # fmt: skip


def _two_masses(push: float) -> System:
    """Two masses on the ground, coupled by a spring; each sticks and slides by itself."""

    def force(t):
        return push * np.sin(0.8 * t)

    def build():
        def rates(t, x, u, p):
            spring = 4.0 * (x[0] - x[2]) + 0.3 * (x[1] - x[3])
            return [
                x[1], force(t) - spring - 0.5 * np.sign(x[1]), x[3], (spring - 0.8 * np.sign(x[3])) / 2.0,
            ]  # fmt: skip

        return block(rates, 4)

    def accelerations(t, x, s):
        spring = 4.0 * (x[0] - x[2]) + 0.3 * (x[1] - x[3])
        return [force(t) - spring - 0.5 * s[0], (spring - 0.8 * s[1]) / 2.0]

    def rates(t, x, s):
        first, second = accelerations(t, x, s)
        return [x[1], first, x[3], second]

    reference = filippov(rates, lambda t, x: [x[1], x[3]], accelerations)
    return System(
        f"two_masses_{push:g}",
        "friction",
        "two masses with friction and a spring",
        build,
        reference,
        8.0,
        (0.0,) * 4,
    )


def _stacked() -> System:
    """A load on a sledge: friction between them, a push on the sledge; they stick together until it pushes too hard."""

    def force(t):
        return 3.0 * np.sin(t)

    def build():
        def rates(t, x, u, p):
            grip = 0.5 * np.sign(x[0] - x[1])
            return [(force(t) - 0.4 * x[0] - grip) / 2.0, grip / 0.5]

        return block(rates, 2)

    def rates(t, x, s):
        return [(force(t) - 0.4 * x[0] - 0.5 * s[0]) / 2.0, s[0]]

    reference = filippov(rates, lambda t, x: [x[0] - x[1]], lambda t, x, s: [rates(t, x, s)[0] - s[0]])
    return System("stacked_masses", "friction", "load on a sledge", build, reference, 6.0, (0.0, 0.0))


def _brake() -> System:
    """A clutch that closes: torque of the pressure times the sign of the difference of speeds."""

    def pressure(t):
        return 0.5 * t

    def build():
        def rates(t, x, u, p):
            torque = pressure(t) * np.sign(x[0] - x[1])
            return [(2.0 - 0.1 * x[0] - torque) / 1.5, (torque - 0.8) / 0.5]

        return block(rates, 2)

    def rates(t, x, s):
        torque = pressure(t) * s[0]
        return [(2.0 - 0.1 * x[0] - torque) / 1.5, (torque - 0.8) / 0.5]

    reference = filippov(
        rates, lambda t, x: [x[0] - x[1]], lambda t, x, s: [rates(t, x, s)[0] - rates(t, x, s)[1]]
    )
    return System(
        "clutch", "friction", "clutch that closes", build, reference, 8.0, (10.0, 0.0),
        source="Modelica.Mechanics.Rotational.Components.Clutch, its text",
    )  # fmt: skip


def _pid_stick() -> System:
    """A mass that a PID law with integral holds: it hunts about the set point by friction."""

    def rates(t, x, s):
        force = 4.0 * (1.0 - x[0]) - 2.0 * x[1] + 1.5 * x[2]
        return [x[1], force - 0.6 * s[0], 1.0 - x[0]]

    def build():
        return block(
            lambda t, x, u, p: [
                x[1], 4.0 * (1.0 - x[0]) - 2.0 * x[1] + 1.5 * x[2] - 0.6 * np.sign(x[1]), 1.0 - x[0]
            ], 3,
        )  # fmt: skip

    reference = filippov(rates, lambda t, x: [x[1]], lambda t, x, s: [rates(t, x, s)[1]])
    return System(
        "pid_hunting", "friction", "PID law and Coulomb friction", build, reference, 12.0, (0.0, 0.0, 0.0),
        source="B. Armstrong-Helouvry et al., survey of friction models and control, 1994", short=True,
    )  # fmt: skip


def _pendulum_friction() -> System:
    def rates(t, x, s):
        return [x[1], -9.81 * np.sin(x[0]) - 1.5 * s[0]]

    def build():
        return block(lambda t, x, u, p: [x[1], -9.81 * np.sin(x[0]) - 1.5 * np.sign(x[1])], 2)

    return System(
        "pendulum_coulomb", "friction", "pendulum with dry friction", build,
        filippov(rates, lambda t, x: [x[1]], lambda t, x, s: [rates(t, x, s)[1]]), 5.0, (2.0, 0.0),
    )  # fmt: skip


def _branches() -> System:
    """Friction with stiction as a user writes it with ifs: at rest the force is met up to its level."""

    def rates(t, x, u, p):
        if x[1] > 0:
            friction = 0.5
        elif x[1] < 0:
            friction = -0.5
        else:
            friction = 0.0
        return [x[1], 0.8 * np.sin(t) - friction]

    def rate(t, x, s):
        return 0.8 * np.sin(t) - 0.5 * s[0]

    return System(
        "friction_by_ifs", "friction", "Coulomb friction by if and elif", lambda: block(rates, 2),
        filippov(lambda t, x, s: [x[1], rate(t, x, s)], lambda t, x: [x[1]], lambda t, x, s: [rate(t, x, s)]),
        9.0, (0.0, 0.0),
    )  # fmt: skip


def systems() -> list[System]:
    """Of the families relays and friction."""
    return [
        _relay_sliding(1.0, 0.5), _relay_sliding(2.0, 0.0), _relay_sliding(0.7, 1.2),
        _sliding_surface(1.0), _sliding_surface(2.0), _sliding_disturbed(), _bang_bang(),
        _relay_feedback(2), _relay_feedback(3), _thermostat(18.0, 22.0), _thermostat(19.5, 20.5),
        _mass("slides_to_rest", lambda t: 0.0, 0.7, start=(0.0, 2.0), short=True,
              source="textbook: a block thrown onto a rough floor"),
        _mass("slides_to_rest_viscous", lambda t: 0.0, 0.4, 0.3, mass=2.0, start=(0.0, 2.0), end=9.0),
        _mass("ramp_breaks_away", lambda t: 0.5 * t, 0.8, 0.2, end=4.0, short=True,
            structure="stiction broken by a ramp"),
        _mass("ramp_breaks_away_heavy", lambda t: 0.3 * t, 1.1, 0.5, mass=4.0, end=7.0,
            structure="stiction broken by a ramp"),
        _mass("sine_stick_slide", lambda t: 1.4 * np.sin(2.0 * t), 0.8, end=8.0, short=True,
              source="Modelica.Mechanics.Translational.Examples.Friction, its text"),
        _mass("sine_never_sticks", lambda t: 3.0 * np.sin(2.0 * t), 0.4, 0.2, end=6.0),
        _mass("sine_never_moves", lambda t: 0.6 * np.sin(2.0 * t), 0.8, end=4.0, pace=1.4),
        _mass("spring_dry_decay", lambda t: 0.0, 0.3, 0.0, 4.0, end=6.0, start=(1.3, 0.0), short=True,
              source="textbook: oscillator under Coulomb damping, J. P. Den Hartog, 1931"),
        _mass("spring_dry_driven", lambda t: 1.5 * np.cos(1.3 * t), 0.5, 0.1, 2.0, end=9.0, start=(0.5, 0.0),
              source="J. P. Den Hartog, Forced vibrations with combined Coulomb and viscous friction, 1931"),
        _mass("spring_dry_stops", lambda t: np.sin(0.5 * t), 0.8, 0.2, 3.0, end=14.0, start=(0.1, 0.3)),
        _stribeck("stribeck_ramp", lambda t: 0.4 * t, 5.0,
            source="C. Canudas de Wit et al., LuGre paper: break-away"),
        _stribeck("stribeck_sine", lambda t: 1.5 * np.sin(1.2 * t), 7.0),
        _belt(0.2, 12.0), _belt(0.5, 9.0), _driven_belt(), _two_masses(2.0), _two_masses(3.5), _stacked(), _brake(),
        _pid_stick(), _pendulum_friction(), _branches(),
    ]  # fmt: skip
