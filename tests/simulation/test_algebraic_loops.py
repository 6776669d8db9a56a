"""Nonlinear algebraic loops in runs: from the last instant's solution on, alike in the virtual machine, C and FMUs."""

import casadi as ca
import control as ct
import fmpy
import numpy as np
import pytest

from phyfilter_ctl import export_fmu
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.diagram.rootfinding import solver
from phyfilter_ctl.simulation import simulate
from tests.cpu_budget import release_but

BACKENDS = ("vm", "c")
BOTH = ["vm", pytest.param("c", marks=pytest.mark.slow)]  # each model takes the compiler half a second
EQUAL = 1e-9  # Newton's stopping rule, in the virtual machine and in C
# Newton's rule leaves 1e-13 of r: at the triple root r = 0, its cube root.
CUBE_ROOT = 1e-4
NEWTON = 1e-10
BRANCH = 0.05  # fmpy holds the inputs over its steps of 10 ms; branches are 0.4 apart and more


def static_loop(output, name="block"):
    """y = output(r, y) as a diagram."""
    block = ct.nlsys(
        None, lambda t, x, u, params: output(u[0], u[1]), inputs=["r", "v"], outputs="y", name=name
    )
    return ct.InterconnectedSystem([block], connections=[[(0, 1), (0, 0)]], inplist=[(0, 0)], outlist=[(0, 0)],
                                   inputs="r", outputs="y", name="loop")  # fmt: skip


def behind_integrator(output):
    """x' = r - y with y = output(x, y)."""
    lag = ct.nlsys(lambda t, x, u, params: [u[1] - u[0]], lambda t, x, u, params: x[0], inputs=["y", "r"], outputs="x",
                   states=1, name="tank")  # fmt: skip
    block = ct.nlsys(
        None, lambda t, x, u, params: output(u[0], u[1]), inputs=["x", "v"], outputs="y", name="valve"
    )
    return ct.InterconnectedSystem(
        [lag, block], connections=[[(0, 0), (1, 0)], [(1, 0), (0, 0)], [(1, 1), (1, 0)]], inplist=[(0, 1)],
        outlist=[(1, 0)], inputs="r", outputs="y", name="outflow",
    )  # fmt: skip


CUBE = flatten(static_loop(lambda r, v: v + r - v**3))


@pytest.mark.parametrize("backend", BOTH)
def test_cube_root_from_the_start_value_and_through_the_triple_root(backend):
    """w^3 = r: the derivative is 0 at the start, where Newton's method alone fails for every r."""
    r = np.array([0.0, 1e-6, -1e-6, 0.3, 8.0, -27.0, 1e9, -1e9, 0.0])
    for value in r:
        response = simulate(CUBE, [0.0], value, backend=backend)
        np.testing.assert_allclose(response.outputs, np.cbrt(value), rtol=NEWTON, atol=CUBE_ROOT)
    response = simulate(CUBE, np.arange(len(r)), r, backend=backend, interpolation="hold")
    np.testing.assert_allclose(response.outputs, np.cbrt(r), rtol=NEWTON, atol=CUBE_ROOT)
    assert response.notes == ()


@pytest.mark.parametrize("backend", BOTH)
def test_loop_at_the_edge_of_its_domain(backend):
    """w = sqrt(1 - r - w): Newton's method leaves the domain; w = (sqrt(5 - 4 r) - 1) / 2."""
    flat = flatten(static_loop(lambda r, v: np.sqrt(1.0 - r - v), name="root"))
    r = np.array([0.3, 0.4, -3.0, 0.9, 0.3, 0.999])
    response = simulate(flat, np.arange(len(r)), r, backend=backend, interpolation="hold")
    np.testing.assert_allclose(response.outputs, (np.sqrt(5.0 - 4.0 * r) - 1.0) / 2.0, atol=NEWTON)
    failed = simulate(flat, np.arange(3), [0.0, 0.5, 2.0], backend=backend, interpolation="hold")
    assert not failed.success
    assert "no solution of algebraic loop root.v -> root.y -> root.v was found there" in failed.message
    assert np.isfinite(failed.outputs[:2]).all()


@pytest.mark.slow
def test_virtual_machine_equals_c_behind_a_state():
    """x' = r - y, y^3 + y = x; and y (3 y^2 + 1) y' = ... differentiated by hand: y' = (r - y) / (3 y^2 + 1)."""
    flat = flatten(behind_integrator(lambda x, v: x - v**3))
    t = np.linspace(0.0, 4.0, 81)
    r = 20.0 * np.sin(3.0 * t)
    responses = [simulate(flat, t, r, method="rk4", max_step=0.01, backend=backend) for backend in BACKENDS]
    np.testing.assert_allclose(responses[0].outputs, responses[1].outputs, rtol=EQUAL, atol=EQUAL)
    by_hand = ct.nlsys(lambda t, x, u, params: (u - x) / (3.0 * x**2 + 1.0), None, inputs=1, outputs=1, states=1,
                       name="by_hand")  # fmt: skip
    expected = simulate(by_hand, t, r, backend="vm", method="adaptive").outputs
    adaptive = simulate(flat, t, r, backend="vm", method="adaptive").outputs
    np.testing.assert_allclose(adaptive, expected, atol=1e-7)
    np.testing.assert_allclose(responses[0].outputs, expected, atol=1e-4)  # RK4 in steps of 10 ms


@pytest.mark.parametrize("backend", BOTH)
def test_fold_is_told(backend):
    """w^3 - w = r: the branch from w = 0 ends at r = -+2/(3 sqrt(3)); a run goes on from the outer one, and back."""
    with pytest.warns(RuntimeWarning, match="several solutions at the start values"):
        flat = flatten(static_loop(lambda r, v: v**3 - r, name="fold"))
    t = np.linspace(0.0, 1.0, 101)
    inside = simulate(flat, t, 0.3 * np.sin(6.0 * t), backend=backend)
    assert inside.notes == ()
    assert np.max(np.abs(inside.outputs)) < 3.0**-0.5
    with pytest.warns(RuntimeWarning, match="branch of solutions that the run followed ends at") as caught:
        outside = simulate(flat, t, t, backend=backend)
    (note,) = outside.notes
    assert note == str(caught[0].message)
    assert "fold.v -> fold.y -> fold.v" in note
    at = float(note.split("t = ")[1].split(" s;")[0])
    np.testing.assert_allclose(at, 2.0 / (3.0 * np.sqrt(3.0)), atol=1e-6)
    np.testing.assert_allclose(outside.outputs**3 - outside.outputs, t, atol=NEWTON)


@pytest.mark.parametrize("backend", BOTH)
def test_hysteresis(backend):
    """Up over the fold and back to r = 0: the run stands on 1; solved anew from the start, it would on 0."""
    with pytest.warns(RuntimeWarning, match="several solutions"):
        flat = flatten(static_loop(lambda r, v: v**3 - r, name="fold"))
    with pytest.warns(RuntimeWarning, match="branch of solutions"):
        response = simulate(flat, np.arange(7.0), [0.0, 0.2, 0.38, 0.6, 0.4, 0.2, 0.0], backend=backend)
    np.testing.assert_allclose(response.outputs[[0, 6]], [0.0, 1.0], atol=NEWTON)


@pytest.mark.slow
def test_discrete_diagram_keeps_its_loop_too():
    """x[k+1] = 0.5 x + y, y^3 = x + r from instant to instant."""
    block = ct.nlsys(
        lambda t, x, u, params: [0.5 * x[0] + u[1]], lambda t, x, u, params: u[1] + x[0] + u[0] - u[1] ** 3,
        inputs=["r", "v"], outputs="y", states=1, dt=0.1, name="d",
    )  # fmt: skip
    sys = ct.InterconnectedSystem([block], connections=[[(0, 1), (0, 0)]], inplist=[(0, 0)], outlist=[(0, 0)],
                                  inputs="r", outputs="y", dt=0.1, name="discrete")  # fmt: skip
    t = 0.1 * np.arange(30)
    r = 5.0 * np.sin(7.0 * t)
    x, expected = 0.3, []
    for value in r:
        expected.append(np.cbrt(x + value))
        x = 0.5 * x + expected[-1]
    for backend in BACKENDS:
        response = simulate(sys, t, r, 0.3, backend=backend)
        np.testing.assert_allclose(response.outputs, expected, atol=NEWTON)
        assert response.states.shape == (1, 30)


def vector(residual, n, arguments):
    tau, r = ca.SX.sym("tau", n), ca.SX.sym("r", arguments)
    return solver(ca.Function("residual", [tau, r], [ca.vertcat(*residual(tau, r))]), "loop", 1.0)


@pytest.mark.parametrize("start", [(15.0, -2.0), (0.5, -2.0), (-10.0, -10.0), (30.0, 8.0)])
def test_vector_loop_where_damped_steps_stick(start):
    """Freudenstein and Roth (1963): a local minimum of the residual at (11.41, -0.90); the solution is (5, 4)."""
    solve = vector(
        lambda x, r: (
            x[0] + ((5 - x[1]) * x[1] - 2) * x[1] - 13,
            x[0] + ((x[1] + 1) * x[1] - 14) * x[1] - 29,
        ),
        2,
        1,
    )
    np.testing.assert_allclose(np.asarray(solve(start, 0.0)).ravel(), [5.0, 4.0], rtol=NEWTON)


def test_vector_loops_of_other_kinds():
    """Coupled cubes against their residual; Powell's badly scaled problem; one without a solution."""
    cubes = vector(lambda x, r: (r[0] - x[0] ** 3 - x[1], r[1] - x[1] ** 3 + x[0]), 2, 2)
    for r in ((0.0, 0.0), (10.0, -5.0), (-300.0, 400.0)):
        a, b = np.asarray(cubes((0.0, 0.0), r)).ravel()
        np.testing.assert_allclose((a**3 + b, b**3 - a), r, rtol=NEWTON, atol=NEWTON)
    powell = vector(lambda x, r: (1e4 * x[0] * x[1] - 1, ca.exp(-x[0]) + ca.exp(-x[1]) - 1.0001), 2, 1)
    np.testing.assert_allclose(
        np.asarray(powell((0.0, 1.0), 0.0)).ravel(), [1.098159e-5, 9.106146], rtol=1e-6
    )
    none = vector(lambda x, r: (x[0] ** 2 + x[1] ** 2 + 1, x[0] - x[1]), 2, 1)
    assert np.isnan(np.asarray(none((1.0, 2.0), 0.0))).all()


@pytest.mark.parametrize(
    ("fmi", "kind"),
    release_but(
        {("2.0", "ModelExchange"), ("3.0", "CoSimulation")},
        [("2.0", "ModelExchange"), ("3.0", "ModelExchange"), ("3.0", "CoSimulation")],
    ),
)
def test_fmu_keeps_the_branch(tmp_path, kind, fmi):
    """w^3 - w = x behind a lag x, up over the fold and back: on the outer branch, as the virtual machine."""
    lag = ct.tf([20.0], [1.0, 20.0], inputs="r", outputs="x", name="lag")
    loop = static_loop(lambda r, v: v**3 - r, name="fold")
    sys = ct.InterconnectedSystem([lag, loop], connections=[[(1, 0), (0, 0)]], inplist=[(0, 0)], outlist=[(1, 0)],
                                  inputs="r", outputs="y", name="snap")  # fmt: skip
    with pytest.warns(RuntimeWarning, match="several solutions"):
        flat = flatten(sys)
    t = np.linspace(0.0, 2.0, 201)
    r = np.interp(t, [0.0, 1.0, 2.0], [0.0, 0.6, -0.2])
    with pytest.warns(RuntimeWarning, match="branch of solutions"):
        expected = simulate(flat, t, r, backend="vm", method="adaptive").outputs
    path = export_fmu(flat, tmp_path / "snap.fmu", fmi=fmi)
    result = fmpy.simulate_fmu(
        str(path), stop_time=2.0, output_interval=0.01, fmi_type=kind, output=["y"], relative_tolerance=1e-8,
        input=np.array(list(zip(t, r, strict=True)), dtype=[("time", float), ("r", float)]),
    )  # fmt: skip
    assert expected[-1] > 0.7
    apart = np.abs(t - t[np.argmax(np.abs(np.diff(expected)))]) > 0.05
    np.testing.assert_allclose(result["y"][apart], expected[apart], atol=BRANCH)
