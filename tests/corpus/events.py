"""Hybrid blocks: impacts, resets, memories, play."""

from __future__ import annotations

import math

import control as ct
import numpy as np

import phyfilter_ctl as pf
from tests.corpus.reference import Exit, Hybrid, relay
from tests.corpus.system import System, block

GRAVITY = 9.81


def _hybrid(
    name: str, rates, events, reference, end: float, start, source: str = "", short: bool = False,
    structure: str = "", movable=1.0, family: str = "events", times=None,
) -> System:  # fmt: skip
    return System(
        name, family, structure or name, lambda: pf.hybrid(block(rates, len(start)), events), reference, end, start,
        source=source, short=short, movable=movable, times=times,
    )  # fmt: skip


def _ball(
    restitution: float, end: float, height: float = 1.0, short: bool = False, source: str = ""
) -> System:
    """Bounces on the ground; after infinitely many of them it lies there."""

    def answer(times, x0):
        speed = math.sqrt(2.0 * GRAVITY * x0[0])
        landing = speed / GRAVITY
        rows = []
        for t in times:
            if t < landing:
                rows.append([x0[0] - 0.5 * GRAVITY * t * t, -GRAVITY * t])
                continue
            begin, up = landing, restitution * speed
            last = landing + 2.0 * up / GRAVITY / (1.0 - restitution)
            if t >= last:
                rows.append([0.0, 0.0])
                continue
            while begin + 2.0 * up / GRAVITY <= t:
                begin, up = begin + 2.0 * up / GRAVITY, up * restitution
            s = t - begin
            rows.append([up * s - 0.5 * GRAVITY * s * s, up - GRAVITY * s])
        return np.array(rows).T

    ground = pf.event(
        lambda t, x, u, p: x[0],
        lambda t, x, u, p: [0.0, -restitution * x[1]],
        direction="falling",
        name="hit",
    )
    rests = end > math.sqrt(2 * height / GRAVITY) * (1 + 2 * restitution / (1 - restitution))
    made = _hybrid(
        f"ball_{restitution:g}{'_rests' if rests else ''}", lambda t, x, u, p: [x[1], -GRAVITY], [ground],
            answer, end,
        (height, 0.0), source, short, "bouncing ball that comes to rest" if rests else "bouncing ball",
    )  # fmt: skip
    # Where it comes to rest the other start has jumps of speed at other times; all times are away from bounces.
    return made


def _ball_drag() -> System:
    """With air drag, and bounces that stay above rest."""

    def rates(t, x, u, p):
        return [x[1], -GRAVITY - 0.2 * np.abs(x[1]) * x[1]]

    def exits(mode):
        hit = Exit(lambda t, x: -x[0], 1, lambda t, x: [0.0, -0.95 * x[1]])
        return (hit, Exit(lambda t, x: -x[1], -1)) if mode == 1 else (hit,)

    ground = pf.event(
        lambda t, x, u, p: x[0], lambda t, x, u, p: [0.0, -0.95 * x[1]], direction="falling", name="hit"
    )
    reference = Hybrid(lambda t, x, mode: [x[1], -GRAVITY - 0.2 * mode * x[1] ** 2], exits, lambda t, x: 1)
    return _hybrid(
        "ball_drag",
        rates,
        [ground],
        reference,
        2.5,
        (1.0, 5.0),
        "PathSim examples_event/example_bouncingball_friction.py",
    )


def _bouncing_pendulum() -> System:
    def exits(mode):
        return (Exit(lambda t, x: -x[0], "", lambda t, x: [0.0, -0.9 * x[1]]),)

    wall = pf.event(
        lambda t, x, u, p: x[0], lambda t, x, u, p: [0.0, -0.9 * x[1]], direction="falling", name="wall"
    )
    return _hybrid(
        "bouncing_pendulum", lambda t, x, u, p: [x[1], -GRAVITY * np.sin(x[0])], [wall],
        Hybrid(lambda t, x, mode: [x[1], -GRAVITY * np.sin(x[0])], exits), 8.0, (0.9 * np.pi, 0.0),
        "PathSim examples_event/example_bouncing_pendulum.py", True,
    )  # fmt: skip


def _two_walls() -> System:
    def answer(times, x0):
        place, speed, now, rows = x0[0], x0[1], 0.0, []
        for t in times:
            while True:
                wall = 1.0 if speed > 0 else -1.0
                hit = now + (wall - place) / speed
                if hit > t:
                    break
                now, place, speed = hit, wall, -0.9 * speed
            rows.append([place + speed * (t - now), speed])
        return np.array(rows).T

    events = [
        pf.event(
            lambda t, x, u, p: x[0] - 1.0,
            lambda t, x, u, p: [1.0, -0.9 * x[1]],
            direction="rising",
            name="right",
        ),
        pf.event(
            lambda t, x, u, p: x[0] + 1.0,
            lambda t, x, u, p: [-1.0, -0.9 * x[1]],
            direction="falling",
            name="left",
        ),
    ]
    return _hybrid(
        "two_walls",
        lambda t, x, u, p: [x[1], 0.0],
        events,
        answer,
        5.0,
        (0.2, 1.7),
        "textbook: billiard between walls",
    )


def _moving_table() -> System:
    """A ball on a table that moves up and down."""

    def table(t):
        return 0.05 * np.sin(7.0 * t), 0.35 * np.cos(7.0 * t)

    def reset(t, x):
        v = 0.35 * np.cos(7.0 * t)
        return [0.05 * np.sin(7.0 * t), v - 0.85 * (x[1] - v)]

    hit = pf.event(
        lambda t, x, u, p: x[0] - 0.05 * np.sin(7.0 * t),
        lambda t, x, u, p: reset(t, x),
        direction="falling",
        name="hit",
    )
    reference = Hybrid(
        lambda t, x, mode: [x[1], -GRAVITY], lambda mode: (Exit(lambda t, x: table(t)[0] - x[0], "", reset),)
    )
    return _hybrid(
        "moving_table",
        lambda t, x, u, p: [x[1], -GRAVITY],
        [hit],
        reference,
        2.0,
        (0.6, 0.0),
        "textbook: bouncing on a vibrating table, P. J. Holmes, 1982",
    )


def _colliding_pair() -> System:
    """Two masses on springs that hit each other without loss of momentum."""

    def rates(t, x, *_):
        return [x[1], -4.0 * (x[0] + 0.5), x[3], -9.0 * (x[2] - 0.5) / 2.0]

    def reset(t, x):
        e, m1, m2 = 0.8, 1.0, 2.0
        mean, d = (m1 * x[1] + m2 * x[3]) / (m1 + m2), x[1] - x[3]
        return [x[0], mean - e * d * m2 / (m1 + m2), x[2], mean + e * d * m1 / (m1 + m2)]

    hit = pf.event(
        lambda t, x, u, p: x[2] - x[0], lambda t, x, u, p: reset(t, x), direction="falling", name="hit"
    )
    return _hybrid(
        "colliding_pair", rates, [hit], Hybrid(rates, lambda mode: (Exit(lambda t, x: x[0] - x[2], "", reset),)), 4.0,
        (-1.5, 0.0, 1.4, 0.0), "textbook: two bodies with restitution",
    )  # fmt: skip


def _fire(threshold: float) -> System:
    """Integrate and fire."""

    def answer(times, x0):
        fires = math.log((2.0 - x0[0]) / (2.0 - threshold))
        period = math.log(2.0 / (2.0 - threshold))
        since = np.where(times < fires, times, np.mod(times - fires, period))
        begin = np.where(times < fires, x0[0], 0.0)
        return (2.0 + (begin - 2.0) * np.exp(-since))[None]

    fire = pf.event(
        lambda t, x, u, p: x[0] - threshold, lambda t, x, u, p: [0.0], direction="rising", name="fire"
    )
    return _hybrid(
        f"integrate_and_fire_{threshold:g}", lambda t, x, u, p: [2.0 - x[0]], [fire], answer, 6.0, (0.1,),
        "textbook: leaky integrate-and-fire neuron" if threshold == 1.0 else "", threshold == 1.0,
            "integrate and fire",
    )  # fmt: skip


def _izhikevich() -> System:
    def rates(t, x, *_):
        return [0.04 * x[0] ** 2 + 5.0 * x[0] + 140.0 - x[1] + 10.0, 0.02 * (0.2 * x[0] - x[1])]

    fire = pf.event(
        lambda t, x, u, p: x[0] - 30.0,
        lambda t, x, u, p: [-65.0, x[1] + 8.0],
        direction="rising",
        name="fire",
    )
    reference = Hybrid(
        rates, lambda mode: (Exit(lambda t, x: x[0] - 30.0, "", lambda t, x: [-65.0, x[1] + 8.0]),)
    )
    return _hybrid(
        "izhikevich",
        rates,
        [fire],
        reference,
        100.3,
        (-65.0, -13.0),
        "E. M. Izhikevich, Simple model of spiking neurons, 2003",
    )


def _integrator_reset() -> System:
    def answer(times, x0):
        return np.where(times < 3.0 - x0[0], x0[0] + times, 2.0 + np.mod(times - 3.0 + x0[0], 1.0))[None]

    reset = pf.event(
        lambda t, x, u, p: x[0] - 3.0, lambda t, x, u, p: [x[0] - 1.0], direction="rising", name="reset"
    )
    return _hybrid(
        "integrator_reset",
        lambda t, x, u, p: [1.0],
        [reset],
        answer,
        9.7,
        (0.05,),
        "PathSim examples_event/example_integrator_reset.py",
    )


def _memory(
    name: str, rates, low, high, plain, end, start, source="", outputs=1, short=False, value=0
) -> System:
    """A continuous part whose last state is a memory that thresholds of state ``value`` set and clear.

    ``plain(t, x, on)`` are the rates of the continuous part."""
    n = len(start)

    def reset(mode):
        return lambda t, x, u, p: [*[x[k] for k in range(n - 1)], mode]

    events = [
        pf.event(lambda t, x, u, p: x[value] - high, reset(0.0), direction="rising", name="high"),
        pf.event(lambda t, x, u, p: x[value] - low, reset(1.0), direction="falling", name="low"),
    ]
    system = ct.nlsys(
        rates,
        lambda t, x, u, p: [x[k] for k in range(n - 1)],
        inputs=0,
        states=n,
        outputs=n - 1,
        name="plant",
    )
    reference = relay(
        lambda t, x: x[value], low, high, lambda t, x, mode: [*plain(t, x, 0.0 if mode == 1 else 1.0), 0.0],
        lambda x: -1 if x[-1] > 0.5 else 1, outputs=lambda t, x, mode: x[:-1],
    )  # fmt: skip
    return System(
        name, "hysteresis", name, lambda: pf.hybrid(system, events), reference, end, start, source=source,
        movable=(*(1.0,) * (n - 1), 0.0), short=short,
    )  # fmt: skip


def _tank(t, x, on):
    return [1.5 * on - 0.6 * np.sqrt(x[0])]


def _schmitt(t, x, on):
    return [2.0 * (on - x[0])]


def _heater(t, x, on):
    return [-0.45 * (x[0] - 15.0) + 5.0 * on]


def _two_rooms(t, x, on):
    return [4.0 * on - 0.3 * (x[0] - x[1]) - 0.1 * (x[0] - 5.0), 0.2 * (x[0] - x[1]) - 0.05 * (x[1] - 5.0)]


def _relaxation(t, x, on):
    return [x[1], -x[0] - 0.3 * x[1] + 2.0 * on - 1.0]


def _from(plain, n):
    return lambda t, x, u, p: [*plain(t, x, x[n - 1]), 0.0]


def _kick() -> System:
    """At a time that is known the speed changes."""

    def answer(times, x0):
        late = np.maximum(times - 1.3, 0.0)
        return np.array([x0[0] + x0[1] * times + 2.0 * late, x0[1] + 2.0 * (times >= 1.3)])

    kick = pf.event(
        lambda t, x, u, p: t - 1.3, lambda t, x, u, p: [x[0], x[1] + 2.0], direction="rising", name="kick"
    )
    return _hybrid("kick_at_time", lambda t, x, u, p: [x[1], 0.0], [kick], answer, 4.1, (0.2, 0.5))


def _gears() -> System:
    """A car that changes gear by its speed."""
    ratio, force = (3.0, 1.8, 1.0), 4.0

    def plain(t, x, gear):
        return [force * ratio[gear] / (1.0 + 0.05 * x[0]) - 0.02 * x[0] ** 2 - 0.3]

    def rates(t, x, u, p):
        r = np.where(x[1] < 0.5, ratio[0], np.where(x[1] < 1.5, ratio[1], ratio[2]))
        return [force * r / (1.0 + 0.05 * x[0]) - 0.02 * x[0] ** 2 - 0.3, 0.0]

    up = [
        pf.event(
            lambda t, x, u, p: x[0] - 8.0,
            lambda t, x, u, p: [x[0], np.maximum(x[1], 1.0)],
            direction="rising",
            name="second",
        ),
        pf.event(
            lambda t, x, u, p: x[0] - 11.0, lambda t, x, u, p: [x[0], 2.0], direction="rising", name="third"
        ),
    ]
    exits = {
        0: (Exit(lambda t, x: x[0] - 8.0, 1, lambda t, x: [x[0], 1.0]),),
        1: (Exit(lambda t, x: x[0] - 11.0, 2, lambda t, x: [x[0], 2.0]),),
        2: (),
    }
    reference = Hybrid(lambda t, x, gear: [*plain(t, x, gear), 0.0], exits.__getitem__, lambda t, x: 0)
    return _hybrid(
        "gears",
        rates,
        up,
        reference,
        4.0,
        (1.0, 0.0),
        "python-control: cruise control with gears, its idea",
        movable=(1.0, 0.0),
    )


def _stick_by_hand() -> System:
    """Stiction with a memory, as a user writes a hybrid block: mode 0 sticks, +1 and -1 slide."""
    level, rest = 0.6, 0.9

    def force(t):
        return 1.5 * np.sin(t)

    def rates(t, x, u, p):
        slides = np.abs(x[2])
        return [x[1] * slides, (force(t) - level * x[2]) * slides, 0.0]

    events = [
        pf.event(lambda t, x, u, p: np.where(np.abs(x[2]) > 0.5, -1.0, np.abs(force(t)) - rest),
                 lambda t, x, u, p: [x[0], 0.0, np.sign(force(t))], direction="rising", name="breaks_away"),
        pf.event(lambda t, x, u, p: np.where(np.abs(x[2]) > 0.5, x[1] * x[2], 1.0),
                 lambda t, x, u, p: [x[0], 0.0, 0.0], direction="falling", name="stops"),
    ]  # fmt: skip

    def exits(mode):
        if mode == 0:
            return tuple(
                Exit(lambda t, x, s=s: s * force(t) - rest, s, lambda t, x, s=s: [x[0], 0.0, s])
                for s in (1, -1)
            )
        # Stopped under more than it can hold it would slide the other way at once; here it never does.
        return (Exit(lambda t, x: -x[1] * mode, 0, lambda t, x: [x[0], 0.0, 0.0]),)

    reference = Hybrid(
        lambda t, x, mode: [x[1] * abs(mode), (force(t) - level * mode) * abs(mode), 0.0],
        exits,
        lambda t, x: 0,
    )
    return _hybrid("stiction_with_memory", rates, events, reference, 9.5, (0.0, 0.0, 0.0),
        structure="stiction above Coulomb friction, by hand",
                   source="Modelica.Mechanics.Rotational.Components.BearingFriction, its text")  # fmt: skip


def _backlash(gap: float) -> System:
    """A load that a driver pushes through a gap: it is still in the gap and moves with the faces (kinematic play)."""

    def drive(t):
        return np.sin(t), np.cos(t)

    # States: place of the load, contact -1, 0, +1.
    def rates(t, x, u, p):
        return [np.cos(t) * np.abs(x[1]), 0.0]

    events = [
        pf.event(lambda t, x, u, p: np.where(np.abs(x[1]) > 0.5, -1.0, np.abs(np.sin(t) - x[0]) - gap),
                 lambda t, x, u, p: [x[0], np.sign(np.sin(t) - x[0])], direction="rising", name="touches"),
        pf.event(lambda t, x, u, p: np.where(np.abs(x[1]) > 0.5, np.cos(t) * x[1], 1.0),
                 lambda t, x, u, p: [x[0], 0.0], direction="falling", name="leaves"),
    ]  # fmt: skip

    def exits(mode):
        if mode == 0:
            return tuple(
                Exit(lambda t, x, s=s: s * (drive(t)[0] - x[0]) - gap, s, lambda t, x, s=s: [x[0], s])
                for s in (1, -1)
            )
        return (Exit(lambda t, x: -mode * drive(t)[1], 0, lambda t, x: [x[0], 0.0]),)

    reference = Hybrid(lambda t, x, mode: [drive(t)[1] * abs(mode), 0.0], exits, lambda t, x: 0)
    return _hybrid(
        f"backlash_{gap:g}", rates, events, reference, 9.0, (0.0, 0.0), structure="play", family="hysteresis",
        source="python-control: friction_backlash_nonlinearity" if gap == 0.3 else "",
    )  # fmt: skip


def systems() -> list[System]:
    """Of the families events and hysteresis."""
    return [
        _ball(0.8, 1.9, short=True, source="PathSim examples_event/example_bouncingball.py"), _ball(0.9, 3.0),
            _ball(0.3, 2.0), _ball(0.5, 3.0), _ball(0.7, 4.0), _ball(0.8, 6.0,
                source="M. Tiller, Modelica by Example: bouncing ball"),
        _ball(0.1, 1.5), _ball_drag(), _bouncing_pendulum(), _two_walls(), _moving_table(), _colliding_pair(),
        _fire(1.0), _fire(1.7), _izhikevich(), _integrator_reset(), _kick(), _gears(), _stick_by_hand(),
        _backlash(0.3), _backlash(0.6),
        _memory("tank_two_levels", _from(_tank, 2), 1.0, 2.0, _tank, 20.0, (1.5, 1.0),
            "textbook: pump switched by two levels"),
        _memory("schmitt_oscillator", _from(_schmitt, 2), 0.3, 0.7, _schmitt, 3.0, (0.0, 1.0),
            "textbook: relaxation oscillator with a Schmitt trigger", short=True),
        _memory("heater_two_thresholds", _from(_heater, 2), 23.0, 25.0, _heater, 9.0, (15.0, 1.0),
            "PathSim examples_event/example_thermostat.py"),
        _memory("two_rooms", _from(_two_rooms, 3), 19.0, 21.0, _two_rooms, 15.0, (15.0, 12.0, 1.0)),
        _memory("relay_hysteresis_second_order", _from(_relaxation, 3), -0.4, 0.4, _relaxation, 12.0, (0.1, 0.0,
            1.0), "python-control: relay_hysteresis_nonlinearity"),
    ]  # fmt: skip
