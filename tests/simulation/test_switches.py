"""Jumps in the equations, against closed forms: located, slid along, and left again, by every way of running."""

from typing import Any

import control as ct
import fmpy
import numpy as np
import pytest

import phyfilter_ctl as pf

# What error control keeps of rtol = 1e-8 over these few seconds, with steps that end at the jumps.
KEPT = 1e-7
# Numbers that no step has an error in: straight lines between jumps that are located to the rounding of time.
EXACT = 1e-12

WAYS: dict[str, Any] = {
    "as called": {},
    "adaptive": {"method": "adaptive", "backend": "vm"},
    "stiff": {"method": "stiff", "backend": "vm"},
    "c": {"method": "adaptive", "backend": "c"},
    "rk4 in c": {"method": "rk4", "backend": "c", "max_step": 0.05},
}


def system(law, states=1, inputs=0, outputs=None):
    return ct.nlsys(
        law, outputs, inputs=inputs, outputs=states if outputs is None else 1, states=states, name="s"
    )


# Law, start, end, x at the end.
LINES = {
    "if": (lambda t, x, u, p: [1.0 if x[0] < 1 else 2.0], 0.0, 2.0, 3.0),
    "where": (lambda t, x, u, p: np.where(x < 1, 1, 2), 0.0, 2.0, 3.0),
    "sign": (lambda t, x, u, p: [1.5 - 0.5 * np.sign(1 - x[0])], 0.0, 2.0, 3.0),
    "floor": (lambda t, x, u, p: [1.0 + np.floor(x[0])], 0.0, 1.75, 2.75),
    "round": (lambda t, x, u, p: [1.0 + round(x[0])], 0.0, 1.0, 1.5),
    "at least": (lambda t, x, u, p: [1.0 + (x[0] >= 1)], 0.0, 2.0, 3.0),
    "step in time": (lambda t, x, u, p: [1.0 if t < 1 else 2.0], 0.0, 2.0, 3.0),
    "table": (lambda t, x, u, p: [[1.0, 2.0, 5.0, 1.0][int(x[0])]], 0.0, 1.6, 2.5),
    "slides at 0": (lambda t, x, u, p: [0.3 - np.sign(x[0])], 0.5, 2.0, 0.0),
    "slides on a quantiser": (lambda t, x, u, p: [0.3 - np.floor(x[0])], 0.5, 5.0, 1.0),
    "starts on its border": (lambda t, x, u, p: [0.3 - np.sign(x[0])], 0.0, 2.0, 0.0),
    "leaves its border": (lambda t, x, u, p: [1.5 - np.sign(x[0])], 0.0, 2.0, 1.0),
    "leaves it either way": (lambda t, x, u, p: [np.sign(x[0] - 1e-3)], 0.0, 2.0, -2.0),
    "breaks away": (lambda t, x, u, p: [t - np.sign(x[0])], 0.0, 3.0, 2.0),  # (t - 1)^2 / 2 from t = 1 on
}


@pytest.mark.parametrize("way", ["as called", "adaptive", "stiff"])
@pytest.mark.parametrize("name", LINES)
def test_lines_between_jumps(name, way):
    law, start, end, last = LINES[name]
    found = pf.simulate(system(law), [0.0, 0.3 * end, end], None, [start], **WAYS[way])
    assert found.success, found.message
    assert found.states[0, -1] == pytest.approx(last, abs=EXACT if name != "breaks away" else KEPT)
    assert found.events == ()


@pytest.mark.parametrize("way", ["c", "rk4 in c"])
@pytest.mark.parametrize("name", ["if", "floor", "slides at 0", "breaks away"])
def test_lines_between_jumps_in_c(name, way):
    law, start, end, last = LINES[name]
    found = pf.simulate(system(law), [0.0, 0.3 * end, end], None, [start], **WAYS[way])
    assert found.success, found.message
    assert found.states[0, -1] == pytest.approx(last, abs=EXACT if name != "breaks away" else KEPT)


def test_square_wave():
    """x' = sign(sin(2 pi t)) - x, exact from half period to half period; the wave is 0 at the start."""
    x = 0.0
    for k in range(8):
        x = (-1.0) ** k + (x - (-1.0) ** k) * np.exp(-0.5)
    x = 1.0 + (x - 1.0) * np.exp(-0.25)
    wave = system(lambda t, x, u, p: [np.sign(np.sin(2 * np.pi * t)) - x[0]])
    for way in ("as called", "stiff"):
        assert pf.simulate(wave, [0.0, 4.25], None, [0.0], **WAYS[way]).states[0, -1] == pytest.approx(
            x, abs=KEPT
        )


def drawn(c, amount, start):
    """Where a mass on a spring stops that dry friction holds within c: half swings about +-c, one after another."""
    x, t = start, 0.0
    while abs(x) > c:
        x, t = -(x - 2.0 * c * np.sign(x)), t + np.pi
    return x, t


@pytest.mark.parametrize("way", WAYS)
def test_mass_on_a_spring_with_dry_friction(way):
    """x'' = -x - 0.13 sign(x'): half swings that lose 0.26 each, until the spring cannot move it any more."""
    last, stops = drawn(0.13, 0.0, 1.0)
    law = system(lambda t, x, u, p: [x[1], -x[0] - 0.13 * np.sign(x[1])], 2)
    given: dict[str, Any] = dict(WAYS[way], max_step=0.01) if way == "rk4 in c" else WAYS[way]
    found = pf.simulate(law, [0.0, stops + 0.1, stops + 20.0], None, [1.0, 0.0], **given)
    assert found.success, found.message
    np.testing.assert_allclose(found.states[0, 1:], last, atol=KEPT)
    np.testing.assert_allclose(found.states[1, 1:], 0.0, atol=KEPT)


def test_friction_at_rest_passes_on_the_force():
    """A held mass: the friction that the output shows is the force, not the limit, and the mass stays where it is."""
    held = ct.nlsys(
        lambda t, x, u, p: [x[1], u[0] - np.sign(x[1])], lambda t, x, u, p: [np.sign(x[1])],
        inputs=["f"], outputs=["friction"], states=["x", "v"], name="held",
    )  # fmt: skip
    t = np.linspace(0.0, 6.0, 61)
    found = pf.simulate(held, t, 0.9 * np.sin(t))
    np.testing.assert_allclose(found.outputs, 0.9 * np.sin(t), atol=EXACT)
    np.testing.assert_array_equal(found.states, 0.0)


def test_breaks_away_at_its_limit():
    """f = 2 t breaks a friction of 1 at 0.5 s; v = (t - 0.5)^2 from there on."""
    mass = ct.nlsys(
        lambda t, x, u, p: [u[0] - np.sign(x[0])], None, inputs=1, outputs=1, states=1, name="mass"
    )
    t = np.linspace(0.0, 2.0, 9)
    found = pf.simulate(mass, t, 2.0 * t)
    np.testing.assert_allclose(found.outputs, np.clip(t - 0.5, 0.0, None) ** 2, atol=KEPT)


def test_two_masses_that_hold_each_other():
    """A pull at the first of two masses in a row, both at rest: the first breaks away at 1 N and stretches the spring,
    which the second withstands up to 1.5 N. So x1 = (s - sin(w s) / w) / 10, s seconds later, w^2 = 10."""
    w = np.sqrt(10.0)
    law = system(
        lambda t, x, u, p: [
            x[2], x[3], t - 10 * (x[0] - x[1]) - np.sign(x[2]), 10 * (x[0] - x[1]) - 1.5 * np.sign(x[3])
        ],
        4,
    )  # fmt: skip
    t = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    s = np.clip(t - 1.0, 0.0, None)
    for way in ("as called", "stiff"):
        found = pf.simulate(law, t, None, [0.0, 0.0, 0.0, 0.0], **WAYS[way])
        np.testing.assert_allclose(found.states[0], (s - np.sin(w * s) / w) / 10.0, atol=KEPT)
        np.testing.assert_allclose(found.states[[1, 3]], 0.0, atol=EXACT)


def test_a_reference_that_jumps_frees_what_slides():
    """A counter steps every 0.5 s, 0, 1, 2, 0, ...; x follows it at 1 m/s, overtakes nothing, and slides on it."""
    counter = ct.nlsys(
        lambda t, x, u, p: [x[0] + 1.0], lambda t, x, u, p: [np.mod(x[0], 3.0) / 4.0],
        inputs=0, outputs=["r"], states=1, dt=0.5, name="counter",
    )  # fmt: skip
    follower = ct.nlsys(
        lambda t, x, u, p: [np.sign(u[0] - x[0])],
        None,
        inputs=["r"],
        outputs=["x"],
        states=1,
        name="follower",
    )
    diagram = ct.interconnect(
        [pf.sampled_block(counter), follower], connections=[["follower.r", "counter.r"]], inputs=[],
        outlist=["follower.x"], name="diagram",
    )  # fmt: skip
    t = np.linspace(0.0, 3.0, 25)
    expected, x = [], 0.0
    for k in range(25):
        expected.append(x)
        x = x + np.clip((k // 4) % 3 / 4.0 - x, -0.125, 0.125)
    for way in ("as called", "stiff", "c"):
        found = pf.simulate(diagram, t, **WAYS[way])
        assert found.success, found.message
        np.testing.assert_allclose(np.ravel(found.outputs), expected, atol=EXACT)


def test_batch_runs_them_alike():
    law = ct.nlsys(
        lambda t, x, u, p: [x[1], -x[0] - p["c"] * np.sign(x[1])], None, inputs=0, outputs=2, states=2,
        params={"c": 0.1}, name="s",
    )  # fmt: skip
    runs = pf.simulate_batch(law, [0.0, 30.0], None, [1.0, 0.0], params={"c": [0.13, 0.3]})
    for run, c in zip(runs, (0.13, 0.3), strict=True):
        assert run.states[0, -1] == pytest.approx(drawn(c, 0.0, 1.0)[0], abs=KEPT)


def motor_loop():
    """A DC motor with dry friction and a PI controller."""
    motor = ct.nlsys(
        lambda t, x, u, p: [
            (0.05 * x[1] - 0.02 * np.sign(x[0]) - 1e-4 * x[0]) / 1e-3, (u[0] - 0.05 * x[0] - x[1]) / 5e-3
        ],
        lambda t, x, u, p: [x[0]], inputs=["v"], outputs=["w"], states=["w", "i"], name="motor",
    )  # fmt: skip
    pi = ct.tf([0.1, 2.0], [1.0, 0.0], inputs="e", outputs="v", name="pi")
    error = ct.summing_junction(["r", "-w"], "e", name="error")
    return ct.interconnect([motor, pi, error], inputs="r", outputs="w", name="loop")


def test_motor_with_friction_from_rest_to_rest():
    """Stands until 2 V/s have brought 0.4 A, turns, and ends at its reference."""
    t = np.linspace(0.0, 4.0, 401)
    found = pf.simulate(motor_loop(), t, 1.0)
    assert found.success, found.message
    # i' = (v - i) / 5 ms while it stands: i = 0.1 + 2 (t - tau) + (2 tau - 0.1) e^(-t / tau); it moves at i = 0.4.
    tau = 5e-3
    stands = t[0.1 + 2 * (t - tau) + (2 * tau - 0.1) * np.exp(-t / tau) < 0.4 - 1e-9]
    np.testing.assert_allclose(found.states[0, : len(stands)], 0.0, atol=EXACT)
    assert (found.outputs[len(stands) + 1 : len(stands) + 20] > 0.0).all()
    assert found.outputs[-1] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_fmus_locate_them_too(fmi, tmp_path):
    """Output intervals of 0.31 s, at whose ends nothing happens."""
    law = system(lambda t, x, u, p: [1.0 if x[0] < 1 else 2.0])
    path = tmp_path / "s.fmu"
    pf.export_fmu(law, path, fmi=fmi)
    for kind in ("CoSimulation", "ModelExchange"):
        found = fmpy.simulate_fmu(path, stop_time=1.86, output_interval=0.31, fmi_type=kind)
        t, x = (np.asarray(found[name], dtype=float) for name in (found.dtype.names or ())[:2])
        np.testing.assert_allclose(x, t + np.clip(t - 1.0, 0.0, None), atol=1e-9)


def test_sensitivities_do_not_pass_over_jumps():
    law = ct.nlsys(
        lambda t, x, u, p: [-p["c"] * np.sign(x[0])],
        None,
        inputs=0,
        outputs=1,
        states=["v"],
        params={"c": 0.1},
        name="s",
    )
    with pytest.raises(ValueError, match=r"passes over the events of s \(v.switch\)"):
        pf.sensitivity(law, [0.0, 1.0], None, [1.0], by=["c"])


@pytest.mark.parametrize("way", ["as called", "stiff", "c"])
def test_inputs_that_stand_on_a_border(way):
    """A gear that is a whole number, and a threshold of 0 at 0: nothing moves them, so nothing happens."""
    law = ct.nlsys(
        lambda t, x, u, p: [[1.0, 2.0, 5.0, 1.0][int(u[0])] - x[0] + (3.0 if u[1] > 0 else 0.0)], None,
        inputs=["gear", "boost"], outputs=["v"], states=1, name="car",
    )  # fmt: skip
    t = np.linspace(0.0, 2.0, 5)
    found = pf.simulate(law, t, [np.full(5, 2.0), np.zeros(5)], [0.0], **WAYS[way])
    assert found.success, found.message
    np.testing.assert_allclose(np.ravel(found.outputs), 5.0 * (1.0 - np.exp(-t)), atol=KEPT)
