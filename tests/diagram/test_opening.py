"""Loops opened at a signal: hand-computed loop gains, python-control's margins, the filter's own margins."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import Loop, PhyFilter, margins, phyfilter_block
from phyfilter_ctl.blocks import sampled_block
from phyfilter_ctl.diagram.opening import between, open_loop

# State space against transfer functions of order six.
CLOSE = 1e-7
OMEGA = np.geomspace(1e-2, 1e3, 60)

PLANT = ct.tf([2.0], [1.0, 3.0, 0.5, 0.0])
PI = ct.tf([0.2, 0.01], [1.0, 0.0])


def same_response(ours: ct.StateSpace, theirs: ct.TransferFunction) -> None:
    np.testing.assert_allclose(ours(1j * OMEGA), theirs(1j * OMEGA), rtol=CLOSE)


def unity(plant: ct.InputOutputSystem | None = None) -> ct.InterconnectedSystem:
    parts = [
        plant or ct.tf(PLANT, inputs="u", outputs="y", name="plant"),
        ct.tf(PI, inputs="e", outputs="u", name="pi"),
        ct.summing_junction(["r", "-y"], "e", name="error"),
    ]
    return ct.interconnect(parts, inputs="r", outputs="y", name="loop")


@pytest.mark.parametrize("signal", ["plant.u", "pi.u", "pi.e", "error.e", "error.y", "plant.y"])
def test_single_loop_is_the_same_everywhere(signal: str):
    same_response(open_loop(unity(), signal), PLANT * PI)
    margin = margins(unity(), at=signal)
    gm, pm, sm, _, wpc, _ = ct.stability_margins(PLANT * PI)
    assert margin.is_stable
    assert margin.gain_margin[1] == pytest.approx(gm, rel=1e-6)
    assert np.rad2deg(margin.phase_margin) == pytest.approx(pm, rel=1e-6)
    assert margin.modulus_margin == pytest.approx(sm, rel=1e-6)
    assert margin.sensitivity_peak == pytest.approx(1.0 / sm, rel=1e-6)
    assert margin.delay_margin == pytest.approx(np.deg2rad(pm) / wpc, rel=1e-6)
    assert margin.gain_crossings == pytest.approx([wpc], rel=1e-6)


def cascade() -> ct.InterconnectedSystem:
    """Inner velocity loop inside an outer position loop."""
    parts = [
        ct.tf([1.0], [0.1, 1.0], inputs="u", outputs="f", name="motor"),
        ct.tf([1.0], [1.0, 0.2], inputs="f", outputs="v", name="mass"),
        ct.tf([1.0], [1.0, 0.0], inputs="v", outputs="p", name="integrator"),
        ct.tf([3.0], [1.0], inputs="ep", outputs="vr", name="outer"),
        ct.tf([5.0], [1.0], inputs="ev", outputs="u", name="inner"),
        ct.summing_junction(["r", "-p"], "ep", name="position_error"),
        ct.summing_junction(["vr", "-v"], "ev", name="velocity_error"),
    ]
    return ct.interconnect(parts, inputs="r", outputs="p", name="cascade")


def test_other_loops_stay_closed():
    s = ct.tf("s")
    G = 1 / (0.1 * s + 1) / (s + 0.2)
    inner = ct.feedback(5 * G, 1)
    same_response(open_loop(cascade(), "outer.vr"), ct.minreal(3 * inner / s, verbose=False))
    same_response(open_loop(cascade(), "inner.u"), ct.minreal(5 * G * (1 + 3 / s), verbose=False))
    # The velocity feeds the integrator and the inner loop: an output opens both, an input one.
    same_response(open_loop(cascade(), "mass.v"), ct.minreal(5 * G * (1 + 3 / s), verbose=False))
    same_response(open_loop(cascade(), "integrator.v"), ct.minreal(3 * inner / s, verbose=False))


def test_nested_diagrams():
    motor = ct.tf([1.0], [0.1, 1.0], inputs="u", outputs="f", name="motor")
    mass = ct.tf([1.0], [1.0, 0.2], inputs="f", outputs="y", name="mass")
    drive = ct.interconnect([motor, mass], inputs="u", outputs="y", name="drive")
    outermost = ct.interconnect([unity(drive)], inplist="loop.r", outlist="loop.y", inputs="r", outputs="y")
    expected = ct.tf([1.0], [0.1, 1.02, 0.2]) * PI
    for signal in ("loop.drive.motor.f", "loop.drive.mass.f", "loop.drive.u", "loop.pi.e"):
        same_response(open_loop(outermost, signal), expected)


def test_nonlinear_at_its_point():
    plant = ct.nlsys(
        lambda t, x, u, params: [u[0] - params["k"] * x[0] ** 2],
        None,
        inputs="u",
        outputs="y",
        states="y",
        params={"k": 1.0},
        name="plant",
    )
    parts = [
        plant,
        ct.tf([4.0], [1.0], inputs="e", outputs="u", name="p"),
        ct.summing_junction(["r", "-y"], "e", name="error"),
    ]
    loop = ct.interconnect(parts, inputs="r", outputs="y", name="loop")
    for x, k in ((0.0, 1.0), (3.0, 1.0), (3.0, 2.0)):
        L = open_loop(loop, "plant.u", x0=[x], u0=[x + 0.25 * k * x**2], params={"plant.k": k})
        same_response(L, ct.tf([4.0], [1.0, 2.0 * k * x]))


def compensated(filter: PhyFilter, actuator: ct.TransferFunction, mu: float, kp: float, kd: float):
    """x' = act(tau), tau = -mu (kp p + kd x) - f_hat, with the filter as a block that knows M_hat = mu."""
    parts = [
        ct.tf(actuator, inputs="tau", outputs="f", name="act"),
        ct.tf([1.0], [1.0, 0.0], inputs="f", outputs="x", name="mass"),
        ct.tf([1.0], [1.0, 0.0], inputs="x", outputs="p", name="position"),
        phyfilter_block(filter, 1, inertia=mu, name="filter"),
        ct.ss(
            [], [], [], [[-mu * kp, -mu * kd, -1.0]], inputs=["p", "x", "f_hat"], outputs="tau", name="law"
        ),
    ]
    return ct.interconnect(
        parts,
        connections=[
            ["act.tau", "law.tau"],
            ["mass.f", "act.f"],
            ["position.x", "mass.x"],
            ["filter.x[0]", "mass.x"],
            ["filter.g[0]", "law.tau"],
            ["law.p", "position.p"],
            ["law.x", "mass.x"],
            ["law.f_hat", "filter.f_hat[0]"],
        ],
        inplist=["filter.f_theta[0]"],
        inputs=["f_theta"],
        outlist=["mass.x"],
        outputs=["x"],
        name="compensated",
    )


def test_actuator_input_is_where_the_filters_own_margins_are_taken():
    filter = PhyFilter.from_poles([-15.0, -8.0 + 6.0j, -8.0 - 6.0j])
    actuator = ct.tf([900.0], [1.0, 36.0, 900.0])
    diagram = margins(compensated(filter, actuator, 1.6, 10.0, 6.0), at="act.tau")
    own = margins(filter, Loop(10.0, 6.0, actuator=actuator, inertia_ratio=1.6))
    assert diagram.is_stable
    assert diagram.gain_margin == pytest.approx(own.gain_margin, rel=CLOSE)
    assert diagram.phase_margin == pytest.approx(own.phase_margin, rel=CLOSE)
    assert diagram.delay_margin == pytest.approx(own.delay_margin, rel=CLOSE)
    assert diagram.modulus_margin == pytest.approx(own.modulus_margin, rel=CLOSE)
    # Opened at the command, in front of what the filter reads, it is another loop.
    assert open_loop(compensated(filter, actuator, 1.6, 10.0, 6.0), "law.tau")(20j) != pytest.approx(
        complex(open_loop(compensated(filter, actuator, 1.6, 10.0, 6.0), "act.tau")(20j)), rel=1e-2
    )


def test_discrete_diagram():
    """A sampled filter around a unit mass behind a hold."""
    sampled = PhyFilter([20.0]).sampled(0.01)
    mass = ct.ss([[1.0]], [[0.01]], [[1.0]], [[0.0]], 0.01, inputs="tau", outputs="x", name="mass")
    gain = ct.ss([], [], [], [[-1.0, -6.0]], 0.01, inputs=["f_hat", "x"], outputs="tau", name="law")
    block = phyfilter_block(sampled, 1, name="filter")
    diagram = ct.interconnect(
        [mass, gain, block],
        connections=[
            ["mass.tau", "law.tau"],
            ["filter.x[0]", "mass.x"],
            ["filter.g[0]", "law.tau"],
            ["law.f_hat", "filter.f_hat[0]"],
            ["law.x", "mass.x"],
        ],
        inplist=["filter.f_theta[0]"],
        inputs=["f_theta"],
        outlist=["mass.x"],
        outputs=["x"],
    )
    margin = margins(diagram, at="mass.tau")
    own = margins(sampled, Loop(0.0, 6.0))
    assert margin.gain_margin == pytest.approx(own.gain_margin, rel=CLOSE)
    assert margin.phase_margin == pytest.approx(own.phase_margin, rel=CLOSE)
    assert margin.modulus_margin == pytest.approx(own.modulus_margin, rel=CLOSE)
    assert np.isfinite(margin.delay_margin)


def test_sampled_block_counts_as_its_continuous_equivalent():
    continuous = compensated(PhyFilter([20.0]), ct.tf([1.0], [0.05, 1.0]), 1.0, 0.0, 0.0)
    parts = list(continuous.syslist)
    parts[3] = sampled_block(PhyFilter([20.0]).sampled(0.001), 1, inertia=1.0, name="filter")
    mixed = ct.interconnect(
        parts,
        connections=[
            ["act.tau", "law.tau"],
            ["mass.f", "act.f"],
            ["position.x", "mass.x"],
            ["filter.x[0]", "mass.x"],
            ["filter.g[0]", "law.tau"],
            ["law.p", "position.p"],
            ["law.x", "mass.x"],
            ["law.f_hat", "filter.f_hat[0]"],
        ],
        inplist=["filter.f_theta[0]"],
        inputs=["f_theta"],
        outlist=["mass.x"],
        outputs=["x"],
    )
    expected = margins(PhyFilter([20.0]), Loop(actuator=0.05))
    L = open_loop(mixed, "act.tau")
    w = np.array([1.0, 10.0, 60.0])
    Q, P = expected.loop(w)
    np.testing.assert_allclose(L(1j * w), P / Q, rtol=CLOSE)


def test_feedthrough_is_lost_at_infinity():
    """L = -0.4 (s + 1)/(s + 2): one pole, through infinity at 2.5 and back through 0 at 5."""
    plant = ct.tf([0.4, 0.4], [1.0, 2.0], inputs="u", outputs="y", name="plant")
    law = ct.nlsys(None, lambda t, x, u, params: u, inputs="y", outputs="u", name="law")
    margin = margins(ct.interconnect([plant, law], inputs=None, outputs="y"), at="plant.u")
    assert margin.stable_gains == ((0.0, pytest.approx(2.5)), (pytest.approx(5.0), np.inf))
    assert margin.gain_margin == (0.0, pytest.approx(2.5))


def test_hidden_unstable_mode_counts():
    away = ct.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], inputs="w", outputs="z", name="away")
    loop = unity()
    both = ct.interconnect(
        [*loop.syslist, away],
        connections=[["plant.u", "pi.u"], ["pi.e", "error.e"], ["error.y", "plant.y"]],
        inplist=["error.r", "away.w"],
        inputs=["r", "w"],
        outlist=["plant.y", "away.z"],
        outputs=["y", "z"],
    )
    margin = margins(both, at="plant.u")
    assert not margin.is_stable
    assert (margin.modulus_margin, margin.phase_margin, margin.delay_margin) == (0.0, 0.0, 0.0)
    assert margin.stable_gains == ()


def test_bad_input():
    with pytest.raises(
        ValueError, match=r"plant\.nothing: no such signal; expected one of plant\.u, plant\.y, pi\.e"
    ):
        open_loop(unity(), "plant.nothing")
    with pytest.raises(TypeError, match=r"diagram made by control\.interconnect, got TransferFunction"):
        open_loop(PLANT, "plant.u")
    with pytest.raises(ValueError, match=r"u0: expected shape \(1,\)"):
        open_loop(unity(), "plant.u", u0=[1.0, 2.0])
    same = ct.tf([1.0], [1.0, 1.0], inputs="s", outputs="s", name="same")
    with pytest.raises(ValueError, match="an input and an output of that name"):
        open_loop(
            ct.interconnect([same], inplist="same.s", outlist="same.s", inputs="a", outputs="b"), "same.s"
        )


@pytest.mark.parametrize(
    ("source", "target", "expected"),
    [
        ("r", "y", PLANT * PI / (1 + PLANT * PI)),
        ("r", "pi.e", 1 / (1 + PLANT * PI)),
        ("plant.u", "y", PLANT / (1 + PLANT * PI)),
        ("plant.u", "plant.y", PLANT / (1 + PLANT * PI)),
        ("plant.y", "pi.u", -PI / (1 + PLANT * PI)),
        # An input as the block receives it, an output as the block puts it out: S, and S - 1.
        ("plant.u", "plant.u", 1 / (1 + PLANT * PI)),
        ("pi.u", "plant.u", 1 / (1 + PLANT * PI)),
        ("plant.u", "pi.u", -PLANT * PI / (1 + PLANT * PI)),
        ("plant.y", "plant.y", -PLANT * PI / (1 + PLANT * PI)),
    ],
)
def test_between_two_signals_of_a_loop(source: str, target: str, expected: ct.TransferFunction):
    same_response(between(unity(), source, target), expected)


def test_between_inputs_of_blocks_that_read_one_output():
    """Added at an output, d reaches all that read it; added at an input, that block alone."""
    s = ct.tf("s")
    force, inner = 1 / (0.1 * s + 1), ct.feedback(5 / (0.1 * s + 1) / (s + 0.2), 1)
    position = 1 / (1 + 3 * inner / s)
    same_response(between(cascade(), "integrator.v", "p"), ct.minreal(position / s, verbose=False))
    # d passes to the position at once, and back through the inner loop.
    at_both = (1 - inner) * position / s
    same_response(between(cascade(), "mass.v", "p"), ct.minreal(at_both, verbose=False))
    same_response(
        between(cascade(), "inner.u", "motor.f"),
        ct.minreal(force / (1 + 5 * force / (s + 0.2) * (1 + 3 / s)), verbose=False),
    )


def test_between_signals_of_diagrams_inside():
    motor = ct.tf([1.0], [0.1, 1.0], inputs="u", outputs="f", name="motor")
    mass = ct.tf([1.0], [1.0, 0.2], inputs="f", outputs="y", name="mass")
    drive = ct.interconnect([motor, mass], inputs="u", outputs="y", name="drive")
    outermost = ct.interconnect([unity(drive)], inplist="loop.r", outlist="loop.y", inputs="r", outputs="y")
    G1, G2 = ct.tf([1.0], [0.1, 1.0]), ct.tf([1.0], [1.0, 0.2])
    S = 1 / (1 + G1 * G2 * PI)
    same_response(between(outermost, "loop.drive.mass.f", "loop.drive.y"), G2 * S)
    same_response(between(outermost, "loop.drive.u", "loop.drive.motor.u"), S)
    same_response(between(outermost, "r", "loop.drive.motor.f"), PI * G1 * S)


def test_between_several_at_once_at_a_point():
    """x' = u - x^3 under u = 4 (r - y): near x = 2 the slope is -12, and everything follows by hand."""
    plant = ct.nlsys(
        lambda t, x, u, params: [u[0] - x[0] ** 3], None, inputs="u", outputs="y", states="y", name="plant"
    )
    parts = [
        plant,
        ct.tf([4.0], [1.0], inputs="e", outputs="u", name="p"),
        ct.summing_junction(["r", "-y"], "e", name="error"),
    ]
    loop = ct.interconnect(parts, inputs="r", outputs="y", name="loop")
    model = between(loop, ["plant.u", "r"], ["y", "p.e"], x0=[2.0], u0=[4.0])
    assert model.input_labels == ["plant_u", "r"]
    assert model.output_labels == ["y", "p_e"]
    np.testing.assert_allclose(model.dcgain(), np.array([[1.0, 4.0], [-1.0, 12.0]]) / 16.0, rtol=CLOSE)
    np.testing.assert_allclose(model.poles(), [-16.0])


def test_between_refuses_what_is_no_signal():
    with pytest.raises(ValueError, match=r"plant\.v: no such signal; expected one of plant\.u"):
        between(unity(), "r", "plant.v")
    with pytest.raises(ValueError, match="expected one or several different signals"):
        between(unity(), "r", ["y", "y"])
    with pytest.raises(TypeError, match="a single block has no signals inside"):
        between(ct.tf(PLANT), "u[0]", "y[0]")
    with pytest.raises(ValueError, match=r"u0: expected shape \(1,\), got \(2,\)"):
        between(unity(), "plant.u", "y", u0=[1.0, 2.0])


def vectors(*, nested: bool) -> ct.InterconnectedSystem:
    """Two coupled axes: forces u[0], u[1] from velocities v[0], v[1] that a matrix brings back."""
    plant = ct.ss(
        -np.eye(2), np.eye(2), np.eye(2), 0.0, inputs=["u[0]", "u[1]"], outputs=["v[0]", "v[1]"], name="axes"
    )
    gain = ct.ss(
        [], [], [], [[-2.0, 0.5], [0.3, -1.0]], inputs=["v[0]", "v[1]"], outputs=["u[0]", "u[1]"], name="law"
    )
    loop = ct.interconnect([plant, gain], inputs=["u[0]", "u[1]"], outputs=["v[0]", "v[1]"], name="inside")
    if not nested:
        return loop
    return ct.interconnect([loop], inputs=["u[0]", "u[1]"], outputs=["v[0]", "v[1]"], name="outside")


@pytest.mark.parametrize("nested", [False, True])
def test_a_vector_is_opened_whole(nested: bool):
    diagram, block = vectors(nested=nested), "inside.axes" if nested else "axes"
    named = [f"{block}.u[0]", f"{block}.u[1]"]
    # L = -K G with the law K and the axes 1/(s + 1).
    whole = open_loop(diagram, f"{block}.u")
    np.testing.assert_allclose(whole(2.0j), np.array([[2.0, -0.5], [-0.3, 1.0]]) / (2.0j + 1.0), rtol=CLOSE)
    assert margins(diagram, at=f"{block}.u").modulus_margin == margins(diagram, at=named).modulus_margin
    # The two ends of a signal of the diagram itself, and of one of its blocks; one element alone.
    through = between(diagram, "u", [f"{block}.v", "v[1]"])
    assert through.output_labels == [*(f"{block}.v[{i}]".replace(".", "_") for i in range(2)), "v[1]"]
    closed = np.linalg.inv((2.0j + 1.0) * np.eye(2) - np.array([[-2.0, 0.5], [0.3, -1.0]]))
    np.testing.assert_allclose(through(2.0j), closed[[0, 1, 1]], rtol=CLOSE)
    with pytest.raises(ValueError, match="different signals"):
        margins(diagram, at=[f"{block}.u", f"{block}.u[0]"])
    with pytest.raises(ValueError, match="no such signal"):
        margins(diagram, at=f"{block}.w")
