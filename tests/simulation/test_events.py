"""Events: when they happen, against closed forms and a piecewise integration; what ends a run; what is refused."""

import re
import subprocess

import control as ct
import hybrid_models as models
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.codegen.compiler import compile_sources
from phyfilter_ctl.simulation.adaptive import Integrator
from phyfilter_ctl.simulation.limits import Budget

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
MAIN = """
#include <stdio.h>
#include "ball.h"
int main(void) {
  static ball self;
  pf_real u[1] = {0}, y[BALL_N_Y];
  if (ball_init(&self)) return 1;
  self.x[0] = 1;
  self.x[2] = 1;
  for (int k = 0; k < 300; k++) {
    if (ball_step(&self, u, y)) return 2;
    printf("%.17g\\n", (double)y[0]);
  }
  return 0;
}
"""
# Free fall is a polynomial that the integrator takes exactly: rounding of times, and of 60 products of 0.8, is left.
EXACT = 1e-12
# Each phase may err by the tolerance of a step over the slope of its condition, and starts from the errors of those
# before: here some 20 phases, rtol = 1e-10, slopes of 0.4 to 5 in units of the states' size.
INTEGRATED = 1e-7
TIGHT = {"rtol": 1e-10, "atol": 1e-12}


def close(found, expected, atol):
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=atol)


def times_of(response, name=None):
    return np.array([time for time, event in response.events if name is None or event == name])


def test_bouncing_ball():
    """t_k = sqrt(2 h/g) (1 + 2 (e + ... + e^k)); between bounces a parabola."""
    times = np.linspace(0.0, 3.9, 40)
    answer = pf.simulate(models.bouncing_ball(), times, initial_state=[1.0, 0.0, 1.0], backend="vm")
    assert answer.success
    hits = models.bounces(1.0, 60)
    found = times_of(answer)
    assert len(found) == np.sum(hits < 3.9)
    close(found, hits[: len(found)], atol=EXACT)
    k = np.searchsorted(hits, times)  # bounces before
    up = np.sqrt(2 * models.GRAVITY) * models.BOUNCE**k
    since = times - np.where(k > 0, hits[k - 1], -np.sqrt(2 / models.GRAVITY))
    close(answer.outputs[0], up * since - models.GRAVITY / 2 * since**2, atol=EXACT)


def test_a_run_that_is_put_back_forgets_its_events():
    """As after a step that the error rejects: the log has the bounces that count, each once."""
    flat, none = pf.flatten(models.bouncing_ball()), np.zeros(0)
    integrator = Integrator(flat, flat.start_parameters(), Budget(1000), **TIGHT)
    first, _ = integrator.run(np.array([1.0, 0.0, 1.0]), none, (0.0, 1.0), (none, none), none)
    saved, met = integrator.state, list(integrator.watch.log)
    assert [name for _, name in met] == ["hit"]
    for _ in range(2):
        integrator.run(first, none, (1.0, 2.0), (none, none), none)
        assert len(integrator.watch.log) > len(met)
        integrator.state = saved
        assert integrator.watch.log == met


@pytest.mark.slow
@pytest.mark.parametrize(
    ("backend", "message"),
    [
        ("vm", "the events hit follow each other without time in between.*Give a switch hysteresis"),
        ("c", "last hit: a sliding mode, or ever shorter bounces"),
    ],
)
def test_ever_shorter_bounces_end_the_run(backend, message):
    """They add up to t_0 (1 + 2 e / (1 - e)); no ball falls through the ground."""
    answer = pf.simulate(
        models.bouncing_ball(), [0.0, 4.0, 4.2], initial_state=[1.0, 0.0, 1.0], backend=backend
    )
    assert not answer.success
    assert answer.failed_at == pytest.approx(np.sqrt(2 / models.GRAVITY) * 9, abs=1e-9)
    assert re.search(message, answer.message, re.DOTALL)
    assert answer.outputs[0, 1] >= 0.0


@pytest.mark.parametrize("restitution", [0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
@pytest.mark.parametrize(
    "way", [{"method": "adaptive", "backend": "vm"}, {"method": "stiff"}, {"backend": "c"}]
)
def test_no_ball_falls_through_the_ground(restitution, way):
    """Its bounces outrun the rounding of time at t_0 (1 + 2 e / (1 - e)), before a count of events does."""
    falling = ct.nlsys(
        lambda t, x, u, p: [x[1], -models.GRAVITY],
        None,
        inputs=0,
        outputs=2,
        states=2,
        params={"e": 0.5},
        name="ball",
    )
    hit = pf.event(
        lambda t, x, u, p: x[0], lambda t, x, u, p: [x[0], -p["e"] * x[1]], direction="falling", name="hit"
    )
    answer = pf.simulate(
        pf.hybrid(falling, [hit]), [0.0, 8.0], None, [1.0, 0.0], params={"e": restitution}, **way
    )
    assert not answer.success
    ends = np.sqrt(2 / models.GRAVITY) * (1 + 2 * restitution / (1 - restitution))
    assert answer.failed_at == pytest.approx(ends, abs=1e-9)
    assert "hit" in answer.message


@pytest.mark.parametrize("drift", [0.3, -0.3, 0.9])
def test_an_event_lands_just_past_0(drift):
    """The sign that a reset sees there is the new one: on 0 itself it would switch the relay off, and x would go on."""
    drive = ct.nlsys(
        lambda t, x, u, p: [drift - x[1], 0.0], None, inputs=0, outputs=2, states=2, name="drive"
    )
    relay = pf.hybrid(
        drive, [pf.event(lambda t, x, u, p: x[0], lambda t, x, u, p: [x[0], np.sign(x[0])], name="switch")]
    )
    for backend in ("vm", "c"):
        answer = pf.simulate(relay, [0.0, 2.0], None, [-0.5, -1.0], backend=backend)
        assert not answer.success
        assert answer.failed_at == pytest.approx(0.5 / (1.0 + drift), abs=1e-9)


@pytest.mark.slow
def test_ball_that_comes_to_rest():
    answer = pf.simulate(
        models.bouncing_ball(rest=0.01), [0.0, 4.0, 10.0], initial_state=[1.0, 0.0, 1.0], backend="vm"
    )
    assert answer.success
    assert len(answer.events) == 1 + np.ceil(np.log(0.01 / np.sqrt(2 * models.GRAVITY)) / np.log(0.8) - 1)
    np.testing.assert_array_equal(answer.outputs[:, 2], 0.0)


def test_thermostat():
    """A block with memory beside the plant it switches, in one diagram."""
    answer = pf.simulate(models.thermostat(), [0.0, 40.0], initial_state=[20.0, 1.0], backend="vm", **TIGHT)
    expected = models.thermostat_times(60)
    found = times_of(answer)
    assert len(found) == np.sum(expected < 40.0)
    close(found, expected[: len(found)], atol=INTEGRATED)
    assert [name for _, name in answer.events[:3]] == ["relay.warm", "relay.cold", "relay.warm"]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["adaptive", "stiff"])
def test_stick_slip(method):
    answer = pf.simulate(
        models.stick_slip(), [0.0, 20.0], initial_state=[0.0, 0.5, 1.0], method=method, **TIGHT
    )
    expected = models.stick_slip_times(60)
    found = times_of(answer)
    assert len(found) == np.sum(expected < 20.0)
    close(found, expected[: len(found)], atol=INTEGRATED)


@pytest.mark.slow
def test_hopper_touches_down_and_lifts_off():
    answer = pf.simulate(models.hopper(), [0.0, 2.0], initial_state=[1.0, 0.0, 0.0], backend="vm", **TIGHT)
    expected = models.hopper_times(1.0, 2.0)
    assert [name for _, name in answer.events[:4]] == ["touchdown", "liftoff"] * 2
    close(times_of(answer), expected, atol=INTEGRATED)


def test_a_relay_in_a_sliding_mode_is_named():
    plant = ct.nlsys(lambda t, x, u, p: [0.3 - x[1], 0.0], None, inputs=0, outputs=2, states=2, name="drive")
    relay = pf.hybrid(
        plant, [pf.event(lambda t, x, u, p: x[0], lambda t, x, u, p: [x[0], -x[1]], name="switch")]
    )
    answer = pf.simulate(relay, [0.0, 1.0], initial_state=[-0.1, -1.0])
    assert not answer.success
    assert answer.failed_at == pytest.approx(0.1 / 1.3, abs=1e-9)
    assert "the events switch follow each other" in answer.message


def counter(direction):
    """Counts how often its input passes 0."""
    memory = ct.nlsys(lambda t, x, u, p: [0.0], None, inputs=1, outputs=1, states=["n"], name="counter")
    return pf.hybrid(
        memory, [pf.event(lambda t, x, u, p: u[0], lambda t, x, u, p: [x[0] + 1.0], direction=direction)]
    )


@pytest.mark.parametrize(("direction", "count"), [("rising", 2), ("falling", 3), ("either", 5)])
@pytest.mark.parametrize("interpolation", ["linear", "hold"])
def test_directions_and_inputs_that_jump(direction, count, interpolation):
    u = [1.0, -1.0, 2.0, -3.0, 0.5, -1.0]
    answer = pf.simulate(
        counter(direction), np.arange(6.0), u, [0.0], interpolation=interpolation, backend="vm"
    )
    # A held input jumps at the times themselves; at the last nothing follows.
    late = interpolation == "hold" and direction != "rising"
    assert answer.states[0, -1] == count - late
    if interpolation == "linear":
        passed = [0.5, 1 + 1 / 3, 2.4, 3 + 6 / 7, 4 + 1 / 3]
        chosen = {"rising": passed[1::2], "falling": passed[::2], "either": passed}[direction]
        close(times_of(answer), chosen, atol=EXACT)


def clock(frequency):
    """Nothing moves but time, so steps are as long as the run lets them be."""
    memory = ct.nlsys(lambda t, x, u, p: [0.0], None, inputs=0, outputs=1, states=["n"], name="clock")
    tick = pf.event(
        lambda t, x, u, p: np.sin(2 * np.pi * frequency * t + 0.1),
        lambda t, x, u, p: [x[0] + 1.0],
        direction="rising",
    )
    return pf.hybrid(memory, [tick])


@pytest.mark.parametrize("frequency", [1.0, pytest.param(7.3, marks=pytest.mark.slow)])
def test_no_event_of_a_clock_is_lost_in_a_long_step(frequency):
    answer = pf.simulate(clock(frequency), [0.0, 20.0], backend="vm")
    close(times_of(answer), (np.arange(1.0, 20.0 * frequency + 0.01) - 0.05 / np.pi) / frequency, atol=1e-13)


@pytest.mark.slow
def test_max_step_keeps_the_ticks_in_compiled_code():
    """C looks at eight parts of a step, whatever the conditions do between them."""
    answer = pf.simulate(clock(1.0), [0.0, 100.0], max_step=0.1, backend="c")
    assert answer.states[0, -1] == 100.0


@pytest.mark.parametrize("beyond", [1e-2, 1e-4, 1e-6, 1e-7])
def test_a_height_just_reached_is_passed_twice(beyond):
    """A throw whose top is above a height for a small part of a step."""
    thrown = ct.nlsys(lambda t, x, u, p: [x[1], -2.0], None, inputs=0, outputs=2, states=2, name="throw")
    over = pf.hybrid(thrown, [pf.event(lambda t, x, u, p: x[0] - (1.0 - beyond))])
    answer = pf.simulate(over, [0.0, 2.0], initial_state=[0.0, 2.0], backend="vm")
    close(times_of(answer), 1.0 + np.sqrt(beyond) * np.array([-1.0, 1.0]), atol=1e-9)


def test_a_condition_without_a_value_for_a_while():
    """ln(t - 1) is no number before 1 s; it passes 0 at 2 s."""
    memory = ct.nlsys(lambda t, x, u, p: [0.0], None, inputs=0, outputs=1, states=["n"], name="late")
    late = pf.hybrid(memory, [pf.event(lambda t, x, u, p: np.log(t - 1.0), lambda t, x, u, p: [x[0] + 1.0])])
    close(times_of(pf.simulate(late, np.linspace(0.0, 4.0, 9), backend="vm")), [2.0], atol=EXACT)


@pytest.mark.slow
def test_many_different_events_at_one_time():
    """Fifty equal balls hit the ground together: no event follows itself."""
    count = 50
    balls = [
        pf.hybrid(
            ct.nlsys(
                lambda t, x, u, p: [x[1], u[0] - models.GRAVITY], None, inputs=1, outputs=2, states=2, name=f"b{i}"
            ),
            [pf.event(lambda t, x, u, p: x[0], lambda t, x, u, p: [0.0, -0.8 * x[1]], direction="falling")],
        )
        for i in range(count)
    ]  # fmt: skip
    together = ct.InterconnectedSystem(
        balls, inplist=[[(i, 0) for i in range(count)]], outlist=[(i, 0) for i in range(count)],
        inputs="w", outputs=[f"z{i}" for i in range(count)], name="balls",
    )  # fmt: skip
    answer = pf.simulate(together, [0.0, 0.6], 0.0, [1.0, 0.0] * count, backend="vm")
    assert answer.success
    assert len({name for _, name in answer.events}) == len(answer.events) == count


def test_an_event_sets_off_another():
    """The first reset makes the second condition jump through 0; both happen at 1 s, and no later."""
    chain = ct.nlsys(lambda t, x, u, p: [1.0, 0.0], None, inputs=0, outputs=2, states=2, name="chain")
    block = pf.hybrid(
        chain,
        [
            pf.event(
                lambda t, x, u, p: x[1] - 2.0,
                lambda t, x, u, p: [x[0], x[1] + 5.0],
                direction="rising",
                name="b",
            ),
            pf.event(
                lambda t, x, u, p: x[0] - 1.0, lambda t, x, u, p: [x[0], 3.0], direction="rising", name="a"
            ),
        ],
    )
    answer = pf.simulate(block, [0.0, 3.0])
    assert [name for _, name in answer.events] == ["a", "b"]
    close(times_of(answer), [1.0, 1.0], atol=EXACT)
    assert answer.states[1, -1] == 8.0


def test_parameters_reach_conditions_and_resets():
    flat = pf.flatten(models.bouncing_ball())
    assert [variable.name for variable in flat.parameters] == ["g", "e"]
    moon = pf.simulate(
        flat, [0.0, 3.0], initial_state=[1.0, 0.0, 1.0], params={"g": 1.62, "e": 0.5}, backend="vm"
    )
    first = np.sqrt(2 / 1.62)
    close(times_of(moon), first * np.array([1.0, 2.0, 2.5]), atol=EXACT)


def test_beside_a_sampled_block():
    """The controller acts every 0.1 s, the event when it happens: a tank filled at 1.25 u and emptied at 1."""
    tank = ct.nlsys(
        lambda t, x, u, p: [1.25 * u[0]], None, inputs=["u"], outputs=["h"], states=["h"], name="tank"
    )
    spill = pf.hybrid(
        tank, [pf.event(lambda t, x, u, p: x[0] - 1.0, lambda t, x, u, p: [0.0], direction="rising")]
    )
    valve = pf.sampled_block(
        ct.ss([[0.0]], [[0.0]], [[0.0]], [[0.0]], 0.1, inputs=["h"], outputs=["w"], name="valve")
    )
    one = ct.summing_junction(["r", "w"], "u", name="sum")
    system = ct.interconnect([spill, valve, one], inputs=["r"], outputs=["h"], name="plant")
    answer = pf.simulate(system, [0.0, 2.5], 1.0, backend="vm")
    close(times_of(answer), [0.8, 1.6, 2.4], atol=EXACT)


RUNS = {
    "ball": (models.bouncing_ball, [1.0, 0.0, 1.0], 3.9),
    "thermostat": (models.thermostat, [20.0, 1.0], 40.0),
    "stick-slip": (models.stick_slip, [0.0, 0.5, 1.0], 20.0),
    "hopper": (models.hopper, [1.0, 0.0, 0.0], 2.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_c_finds_the_same_events(name):
    """Another integrator, another polynomial and another search: the states agree between all events."""
    make, start, end = RUNS[name]
    flat, times = pf.flatten(make()), np.linspace(0.0, end, 200)
    one, other = (
        pf.simulate(flat, times, initial_state=start, backend=backend, **TIGHT) for backend in ("vm", "c")
    )
    assert other.backend == "c"
    close(other.states, one.states, INTEGRATED)


@pytest.mark.slow
@pytest.mark.parametrize("real", ["double", "float"])
def test_exported_steps_meet_the_events(real, tmp_path):
    """Runge-Kutta steps of 10 ms, cut short at the bounces: free fall is exact, the bounces are between the steps."""
    folder = pf.export_c(models.bouncing_ball(), tmp_path / "ball", step=0.01, real=real)
    sources = {path.name: path.read_text() for path in folder.iterdir() if path.suffix in {".c", ".h"}}
    sources["main.c"] = MAIN
    strict = ["-Wconversion", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    program = compile_sources(sources, tmp_path / "run", kind="program", flags=[*STRICT, *strict])
    out = subprocess.run([program], check=True, capture_output=True, text=True).stdout
    heights = np.array([float(line) for line in out.split()])
    times = 0.01 * np.arange(len(heights))
    expected = pf.simulate(
        models.bouncing_ball(), times, initial_state=[1.0, 0.0, 1.0], backend="vm"
    ).outputs[0]
    # Numbers of size 5 in 24 bits over 300 steps; in 53 bits the times of twelve bounces.
    close(heights, expected, 1e-11 if real == "double" else 1e-4)


def test_what_has_no_events_refuses_them():
    ball = models.bouncing_ball()
    with pytest.raises(TypeError, match="block 'ball' has events, which python-control cannot run"):
        ct.input_output_response(ball, [0.0, 1.0], X0=[1.0, 0.0, 1.0])
    with pytest.raises(ValueError, match="method='rk4' steps over the events"):
        pf.simulate(ball, [0.0, 1.0], method="rk4")
    with pytest.raises(ValueError, match=r"sensitivity passes over the events of ball \(hit\)"):
        pf.sensitivity(ball, [0.0, 1.0], by=["e"])


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: pf.event(3), TypeError, "expected functions"),
        (lambda: pf.event(abs, direction="up"), ValueError, "direction: expected one of"),
        (lambda: pf.event(abs, name=""), ValueError, "name: expected"),
        (
            lambda: pf.hybrid(ct.tf([1.0], [1.0, 1.0], 0.1), [pf.event(abs)]),
            ValueError,
            "expected a continuous block",
        ),
        (lambda: pf.hybrid(ct.ss([], [], [], [[1.0]]), [pf.event(abs)]), ValueError, "a block with states"),
        (lambda: pf.hybrid(ct.tf([1.0], [1.0, 1.0]), []), ValueError, "one event or more"),
        (lambda: pf.hybrid(ct.tf([1.0], [1.0, 1.0]), [abs]), TypeError, "a list of"),
        (lambda: pf.hybrid(models.thermostat(), [pf.event(abs)]), TypeError, "one continuous block"),
    ],
)
def test_bad_declarations(make, error, message):
    with pytest.raises(error, match=message):
        make()
