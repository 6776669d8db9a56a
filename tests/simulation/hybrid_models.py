"""Diagrams with events, and where their events are by closed forms or by a tight piecewise integration."""

import control as ct
import numpy as np
from scipy.integrate import solve_ivp

import phyfilter_ctl as pf

GRAVITY, BOUNCE = 9.81, 0.8


def bouncing_ball(rest=0.0):
    """Falls, and keeps 0.8 of its speed at the ground; slower than ``rest`` it stays there (state ``flying``)."""
    fall = ct.nlsys(
        lambda t, x, u, p: [x[1] * x[2], -p["g"] * x[2], 0.0], None,
        inputs=0, outputs=["z", "v", "flying"], states=["z", "v", "flying"], params={"g": GRAVITY, "e": BOUNCE},
        name="ball",
    )  # fmt: skip

    def hit(t, x, u, p):
        back = -p["e"] * x[1]
        flies = np.where(back > rest, 1.0, 0.0)
        return [0.0, back * flies, flies]

    return pf.hybrid(fall, [pf.event(lambda t, x, u, p: x[0], hit, direction="falling", name="hit")])


def bounces(height, count):
    """Times at which the ball hits the ground, from rest at a height."""
    first = np.sqrt(2 * height / GRAVITY)
    return first * (1 + 2 * np.concatenate([[0.0], np.cumsum(BOUNCE ** np.arange(1, count))]))


AMBIENT, HEATING, RATE, LOW, HIGH = 10.0, 20.0, 0.2, 18.0, 22.0


def thermostat():
    """A room in a diagram with its switch: T' = -0.2 (T - 10) + 0.2 * 20 heat, on below 18, off above 22."""
    room = ct.nlsys(
        lambda t, x, u, p: [-RATE * (x[0] - AMBIENT) + RATE * HEATING * u[0]], lambda t, x, u, p: [x[0]],
        inputs=["heat"], outputs=["T"], states=["T"], name="room",
    )  # fmt: skip
    relay = ct.nlsys(
        lambda t, x, u, p: [0.0], lambda t, x, u, p: [x[0]],
        inputs=["T"], outputs=["heat"], states=["on"], params={"low": LOW, "high": HIGH}, name="relay",
    )  # fmt: skip
    switch = pf.hybrid(
        relay,
        [
            pf.event(
                lambda t, x, u, p: u[0] - p["low"], lambda t, x, u, p: [1.0], direction="falling", name="cold"
            ),
            pf.event(
                lambda t, x, u, p: u[0] - p["high"], lambda t, x, u, p: [0.0], direction="rising", name="warm"
            ),
        ],
    )
    return ct.interconnect([room, switch], inputs=[], outputs=["T", "heat"], inplist=[], name="house")


def thermostat_times(count):
    """From 20 degrees, heating: exponentials towards 30 and 10."""
    warm_up = np.log((AMBIENT + HEATING - LOW) / (AMBIENT + HEATING - HIGH)) / RATE
    cool_down = np.log((HIGH - AMBIENT) / (LOW - AMBIENT)) / RATE
    first = np.log((AMBIENT + HEATING - 20.0) / (AMBIENT + HEATING - HIGH)) / RATE
    return first + np.concatenate([[0.0], np.cumsum(np.resize([cool_down, warm_up], count - 1))])


BELT, SPRING, STATIC, KINETIC = 0.5, 4.0, 1.5, 1.0


def stick_slip():
    """A block of 1 kg on a belt, held by a spring: sticks up to 1.5 N, slips with 1 N against the belt's motion."""
    sled = ct.nlsys(
        lambda t, x, u, p: [
            np.where(x[2] > 0.5, BELT, x[1]),
            np.where(x[2] > 0.5, 0.0, -SPRING * x[0] + KINETIC),
            0.0,
        ],
        None, inputs=0, outputs=3, states=["position", "speed", "sticks"], name="sled",
    )  # fmt: skip
    return pf.hybrid(
        sled,
        [
            pf.event(
                lambda t, x, u, p: np.where(x[2] > 0.5, SPRING * x[0] - STATIC, -1.0),
                lambda t, x, u, p: [x[0], x[1], 0.0], direction="rising", name="slip",
            ),
            pf.event(
                lambda t, x, u, p: np.where(x[2] > 0.5, -1.0, x[1] - BELT),
                lambda t, x, u, p: [x[0], BELT, 1.0], direction="rising", name="stick",
            ),
        ],
    )  # fmt: skip


def stick_slip_times(count):
    """Sticking is a ramp, slipping a harmonic around 1 N / k: both in closed form."""
    w, centre = np.sqrt(SPRING), KINETIC / SPRING
    break_away = STATIC / SPRING
    # v = 0.5 cos(w s) - w d sin(w s) from d = break_away - centre is 0.5 again at the full turn less twice the phase.
    slipping = 2 * (np.pi - np.arctan2(w * (break_away - centre), BELT)) / w
    back = centre - (break_away - centre)
    sticking = (break_away - back) / BELT
    return break_away / BELT + np.concatenate([[0.0], np.cumsum(np.resize([slipping, sticking], count - 1))])


LEG, STIFFNESS, DAMPING, MASS = 0.5, 4000.0, 8.0, 3.0


def hopper():
    """A mass on a massless leg with spring and damper; the leg touches down at its length and lifts off at no force."""

    def force(x):
        return STIFFNESS * (LEG - x[0]) - DAMPING * x[1]

    body = ct.nlsys(
        lambda t, x, u, p: [x[1], -GRAVITY + x[2] * force(x) / MASS, 0.0], None,
        inputs=0, outputs=3, states=["height", "speed", "stance"], name="hopper",
    )  # fmt: skip
    return pf.hybrid(
        body,
        [
            pf.event(
                lambda t, x, u, p: np.where(x[2] > 0.5, -1.0, x[0] - LEG), lambda t, x, u, p: [x[0], x[1], 1.0],
                direction="falling", name="touchdown",
            ),
            pf.event(
                lambda t, x, u, p: np.where(x[2] > 0.5, force(x), 1.0), lambda t, x, u, p: [x[0], x[1], 0.0],
                direction="falling", name="liftoff",
            ),
        ],
    )  # fmt: skip


def hopper_times(height, until):
    """Flight and stance one after the other by SciPy, each ended by an event of its own."""

    def force(x):
        return STIFFNESS * (LEG - x[0]) - DAMPING * x[1]

    def touches(t, x):
        return x[0] - LEG

    def lifts(t, x):
        return force(x)

    touches.terminal, touches.direction = True, -1
    lifts.terminal, lifts.direction = True, -1
    phases = (
        (lambda t, x: [x[1], -GRAVITY], touches),
        (lambda t, x: [x[1], -GRAVITY + force(x) / MASS], lifts),
    )
    t, x, times, phase = 0.0, np.array([height, 0.0]), [], 0
    while True:
        slope, end = phases[phase]
        run = solve_ivp(slope, [t, until], x, method="DOP853", rtol=1e-13, atol=1e-14, events=end)
        if run.status != 1:
            return np.array(times)
        t, x = float(run.t[-1]), run.y[:, -1]
        times.append(t)
        phase = 1 - phase
