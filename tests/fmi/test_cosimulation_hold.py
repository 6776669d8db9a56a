"""Inputs that follow lines over a communication step: second order, by slopes where an FMU takes them."""

import control as ct
import numpy as np
import pytest
from test_cosimulation import COUPLED, SHOWN, START, T, exact

from phyfilter_ctl.fmi import Master, System, cosimulate, export_fmu
from phyfilter_ctl.fmi.cosimulation_run import Run

# Halving the step of a method of order two divides the error by four, to this.
ORDER_TWO = 0.1


def errors(parts, wires, start, shown, steps, **options):
    found = (
        cosimulate(System(parts, wires), T, parameters=start, outputs=shown, master=Master(h, **options))
        for h in steps
    )
    return [float(np.max(np.abs(run.outputs - exact()))) for run in found]


@pytest.mark.parametrize(
    ("scheme", "second"),
    [
        ("jacobi", "plain"),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (("jacobi", "three"), ("gauss-seidel", "plain"), ("gauss-seidel", "three"))
        ),
    ],
)
def test_second_order_convergence(build, scheme, second):
    """Against the closed form: a part that takes slopes beside one that does not, of FMI 2.0 and 3.0."""
    wires, start, shown = COUPLED, START, SHOWN
    if second == "three":
        wires = [("a.place", "b.x[0]"), ("b.place[0]", "a.x")]
        start = {"b.x[0]": -0.5, "b.v[0]": 0.2}
        shown = ["a.x", "a.v", "b.x[0]", "b.v[0]"]
    pair = {"a": build(interpolates=True), "b": build("3.0" if second == "three" else "2.0")}
    found = errors(pair, wires, start, shown, (0.02, 0.01, 0.005), scheme=scheme, hold="first")
    assert np.all(np.abs(np.divide(found[:-1], found[1:]) - 4.0) < ORDER_TWO)
    (held,) = errors(pair, wires, start, shown, (0.01,), scheme=scheme)
    assert found[1] < held / 50.0


@pytest.mark.slow
def test_lines_from_outside_are_followed_exactly(build):
    """Between two results an array is a line: the FMU that follows it needs no short steps, the one that holds does."""
    ramp = {"timepts": T, "inputs": {"a.place": 0.3 * T}, "outputs": ["a.x"]}
    fine = cosimulate({"a": build(interpolates=True)}, master=Master(0.0005, hold="first"), **ramp).outputs
    # x'' = (-(k + c) x - d x' + c 0.3 t) / m, and the ramp as a state beside it.
    A = [[0.0, 1.0, 0.0], [-5.5, -0.2, 1.5], [0.0, 0.0, 0.0]]
    system = ct.ss(A, [[0.0], [0.0], [1.0]], [[1.0, 0.0, 0.0]], [[0.0]])
    expected = ct.forced_response(system, T, 0.3 * np.ones(len(T)), [1.0, 0.0, 0.0]).outputs
    integrated = 1e-9  # Runge-Kutta steps of 1 ms
    assert np.max(np.abs(fine - expected)) < integrated
    followed = cosimulate({"a": build(interpolates=True)}, master=Master(hold="first"), **ramp).outputs
    assert np.max(np.abs(followed - expected)) < integrated
    middle = cosimulate({"a": build()}, master=Master(hold="first"), **ramp).outputs
    held = cosimulate({"a": build()}, **ramp).outputs
    assert np.max(np.abs(middle - expected)) < 0.02 * np.max(np.abs(held - expected))


@pytest.mark.slow
def test_exported_fmus_follow_lines(tmp_path):
    """Ours of FMI 2.0 take slopes, on the way of step control too; a first-order lag on a ramp, in closed form."""
    lag = ct.ss([[-2.0]], [[2.0]], [[1.0]], [[0.0]], inputs="u", outputs="y", name="lag")
    path = export_fmu(lag, tmp_path / "lag.fmu", fmi="2.0", name="lag")
    expected = T - 0.5 * (1.0 - np.exp(-2.0 * T))
    integrated = 1e-6
    for options in ({}, {"tolerance": 1e-3}):
        found = cosimulate({"lag": path}, T, inputs={"lag.u": T}, master=Master(hold="first", **options))
        assert np.max(np.abs(found.outputs[0] - expected)) < integrated
    held = cosimulate({"lag": path}, timepts=T, inputs={"lag.u": T})
    assert np.max(np.abs(held.outputs[0] - expected)) > 0.04


@pytest.mark.slow
@pytest.mark.parametrize("in_c", [True, False])
def test_step_control_makes_fewer_steps(build, in_c, monkeypatch):
    """Slopes are taken back as well. The same tolerance: a quarter of the steps, a tenth of the error."""
    monkeypatch.setattr(Run, "in_c", in_c)
    pair = {"a": build(interpolates=True), "b": build()}
    wired, options = System(pair, COUPLED, parameters=START), {"timepts": T, "outputs": SHOWN}
    first, zero = (
        cosimulate(wired, master=Master(hold=hold, tolerance=1e-5), **options) for hold in ("first", "zero")
    )
    assert first.rejected > 0
    assert first.steps < zero.steps / 3.0
    assert np.max(np.abs(first.outputs - exact())) < 0.1 * np.max(np.abs(zero.outputs - exact()))


@pytest.mark.slow
def test_feedthrough_sees_the_end_of_the_line(build):
    """In Gauss-Seidel the force of a part before depends at once on a place that moved over the step."""
    lag = {"lag": ct.ss([[-2.0]], [[2.0]], [[1.0]], [[0.0]], inputs="u", outputs="y", name="lag")}
    found = {
        h: cosimulate(
            System({"a": build(interpolates=True)} | lag, [("lag.u", "a.force")], units="ignore"),
            T,
            inputs={"a.place": np.sin(3.0 * T)},
            outputs=["lag.y"],
            master=Master(h, scheme="gauss-seidel", hold="first"),
        ).outputs
        for h in (0.02, 0.01, 0.005, 0.00125)
    }
    off = [float(np.max(np.abs(found[h] - found[0.00125]))) for h in (0.02, 0.01, 0.005)]
    # Against a run with h / 4 of the last: (8^2 - 1) / (4^2 - 1) is 4.2 in the end, and 2.3 of first order.
    assert np.all(np.divide(off[:-1], off[1:]) > 3.5)


def test_discrete_systems_hold(build):
    """A sampled part takes its input at the sample, whatever moves in between."""
    sums = ct.ss([[1.0]], [[0.1]], [[1.0]], [[0.0]], dt=0.1, inputs="u", outputs="y", name="sums")
    runs = [
        cosimulate(
            {"a": build(), "sums": sums},
            T,
            inputs={"sums.u": T},
            outputs=["sums.y"],
            master=Master(hold=hold),
        )
        for hold in ("zero", "first")
    ]
    assert np.array_equal(runs[0].outputs, runs[1].outputs)
    assert np.allclose(
        runs[0].outputs[0], np.concatenate([[0.0], np.cumsum(0.1 * T[:-1])]), rtol=0.0, atol=1e-12
    )


def test_hold_is_checked(build):
    with pytest.raises(ValueError, match='hold: expected "zero" or "first", got \'second\''):
        cosimulate({"a": build()}, T, master=Master(hold="second"))
