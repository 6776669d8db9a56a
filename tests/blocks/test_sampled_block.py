"""Sampled blocks: python-control wires them, refuses to run them, and sees their continuous equivalent."""

import casadi as ca
import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, stack
from phyfilter_ctl.blocks import (
    BlockFunctions,
    SampledBlock,
    Variable,
    function_block,
    phyfilter_block,
    sampled_block,
)

H = 0.002
FILTER = PhyFilter.from_poles([-20.0, -5 + 8j, -5 - 8j], [500.0, 40.0, 3.0])
OMEGA = np.array([0.3, 2.0, 15.0])
# Two state-space evaluations of the same transfer function.
SAME = 1e-10
REFUSED = "cannot run: use phyfilter_ctl.simulate"


def loop(block):
    plant = ct.ss(
        [[0.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]], inputs=["f", "g"], outputs=["x[0]"], name="mass"
    )
    command = ct.ss([], [], [], [[-1.0], [-1.0]], inputs=["f_hat[0]"], outputs=["g", "g[0]"], name="command")
    return ct.interconnect([plant, command, block], inputs=["f", "f_theta[0]"], outputs=["x[0]", "f_hat[0]"])


def test_python_control_refuses_to_run_it():
    block = sampled_block(FILTER.sampled(H), 1)
    diagram = loop(block)
    assert diagram.dt == 0
    t = np.linspace(0.0, 1.0, 11)
    for attempt in (
        lambda: ct.input_output_response(diagram, t, np.zeros((2, 11))),
        lambda: ct.forced_response(diagram, t, np.zeros((2, 11))),
        lambda: ct.step_response(diagram, t),
        lambda: ct.initial_response(diagram, t),
        lambda: diagram.dynamics(0.0, [0.0], [0.0, 0.0]),
        lambda: diagram.output(0.0, [0.0], [0.0, 0.0]),
        lambda: ct.linearize(diagram, [0.0], [0.0, 0.0]),
        lambda: ct.find_operating_point(diagram, [0.0], [0.0, 0.0]),
        lambda: ct.input_output_response(block, t, np.zeros((3, 11))),
        lambda: block.dynamics(0.0, [], np.zeros(3)),
        lambda: block.output(0.0, [], np.zeros(3)),
        lambda: block(np.zeros(3)),
    ):
        with pytest.raises(TypeError, match=REFUSED) as refusal:
            attempt()
        assert "'phyfilter'" in str(refusal.value)


def test_a_memoryless_controller_is_refused_too():
    gain = sampled_block(ct.ss([], [], [], [[2.0]], 0.01, inputs="e", outputs="u", name="gain"))
    plant = ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs="u", outputs="y", name="lag")
    diagram = ct.interconnect([gain, plant], inputs=["e"], outputs=["y"])
    with pytest.raises(TypeError, match=REFUSED):
        ct.input_output_response(diagram, [0.0, 1.0], np.zeros((1, 2)))


def test_a_discrete_diagram_does_not_take_it():
    discrete = ct.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], H, inputs="f_hat[0]", outputs="y")
    with pytest.raises(ValueError, match="timebase"):
        ct.interconnect([discrete, sampled_block(FILTER.sampled(H), 1)], inputs=["x[0]"], outputs=["y"])


def test_two_of_one_kind_in_a_diagram():
    block = sampled_block(FILTER.sampled(H), 1)
    twin = block.copy("twin")
    assert isinstance(twin, SampledBlock)
    assert (twin.name, twin.period, twin.law is block.law, twin.filter is block.filter) == (
        "twin",
        H,
        True,
        True,
    )
    with pytest.raises(TypeError, match="'twin'"):
        twin.output(0.0, [], np.zeros(3))
    with pytest.warns(UserWarning, match="duplicate"):
        diagram = ct.interconnect(
            [block, block], inplist=["phyfilter.x[0]"], outlist=["phyfilter.f_hat[0]"], check_unused=False
        )
    assert all(isinstance(part, SampledBlock) for part in diagram.syslist)


@pytest.mark.parametrize("inertia", [None, 2.0, [2.0, 3.0], [[2.0, 0.3], [0.1, 1.0]]])
def test_linearize_gives_the_filter_itself(inertia):
    block = sampled_block(FILTER.sampled(H), 2, inertia=inertia)
    expected = phyfilter_block(FILTER, 2, inertia=inertia)
    for linear in (block.linearize(), block.continuous, ct.linearize(block, 0.0)):
        assert linear.dt == 0
        assert linear.input_labels == block.input_labels
        for omega in OMEGA:
            np.testing.assert_allclose(linear(1j * omega), expected(1j * omega), atol=SAME)


def test_linearize_with_delay_and_direction():
    """By the definition f_hat = f_theta + F [E+ s x - e^(-s T) (E+ g + f_theta)], E+ the pseudo-inverse."""
    E = np.array([[1.0, 0.2], [0.0, 1.0], [0.5, -1.0]])
    delay = 0.05
    linear = sampled_block(FILTER.sampled(H, E=E, delay=delay)).linearize()
    for omega in OMEGA:
        s = 1j * omega
        late, left = np.exp(-s * delay), np.linalg.pinv(E)
        expected = np.hstack(
            [FILTER(s) * s * left, -FILTER(s) * late * left, (1 - FILTER(s) * late) * np.eye(2)]
        )
        # Pade of order 3 at omega T = 0.75: phase error 2e-8, by its series (omega T)^7 / 100800.
        np.testing.assert_allclose(linear(s), expected, atol=1e-5)


@pytest.mark.parametrize("kind", ["scalar", "diagonal", "full"])
def test_moving_inertia_at_a_point(kind):
    block = sampled_block(FILTER.sampled(H), 2, inertia=kind)
    M = {"scalar": [2.0], "diagonal": [2.0, 3.0], "full": [2.0, 0.3, 0.1, 1.0]}[kind]
    constant = {"scalar": 2.0, "diagonal": [2.0, 3.0], "full": [[2.0, 0.3], [0.1, 1.0]]}[kind]
    u0 = np.concatenate([[0.4, -0.2], np.zeros(4), M])
    linear = block.linearize(u0=u0)
    expected = phyfilter_block(FILTER, 2, inertia=constant)
    assert linear.ninputs == len(u0) == block.ninputs
    for omega in OMEGA:
        np.testing.assert_allclose(linear(1j * omega)[:, :6], expected(1j * omega), atol=SAME)
        np.testing.assert_array_equal(linear(1j * omega)[:, 6:], 0.0)
    # What diagrams are linearised with is the same at x = 0.
    u0[:2] = 0.0
    equations = function_block(block.continuous, name="equivalent").linearize(u0=u0)
    for omega in OMEGA:
        np.testing.assert_allclose(equations(1j * omega)[:, :6], expected(1j * omega), atol=SAME)
        np.testing.assert_allclose(equations(1j * omega)[:, 6:], 0.0, atol=SAME)


def test_stack_and_labels():
    block = sampled_block(
        stack([FILTER.sampled(H), PhyFilter([3.0]).sampled(H)]), name="bank", inertia="full"
    )
    assert block.name == "bank"
    assert block.input_labels[-4:] == ["M[0,0]", "M[0,1]", "M[1,0]", "M[1,1]"]
    assert [entry.name for entry in block.law.inputs] == block.input_labels
    assert block.filter is not None
    assert block.filter.channels == 2
    assert "Sampled every 0.002 s" in str(block)


def controller(dt=0.01):
    return ct.ss(
        [[1.0, 0.0], [0.1, 0.7]],
        [[0.01], [0.2]],
        [[3.0, 1.0]],
        [[0.5]],
        dt,
        inputs="e",
        outputs="u",
        name="pi",
    )


def test_a_linear_law_is_tustins_inverse():
    block = sampled_block(controller())
    assert (block.name, block.period, block.input_labels, block.output_labels) == ("pi", 0.01, ["e"], ["u"])
    linear = block.linearize()
    back = ct.sample_system(linear, 0.01, "tustin")
    s = 2.0 / 0.01 * (np.exp(0.3j) - 1.0) / (np.exp(0.3j) + 1.0)
    assert linear(s) == pytest.approx(controller()(np.exp(0.3j)), rel=1e-10)
    assert back(np.exp(0.3j)) == pytest.approx(controller()(np.exp(0.3j)), rel=1e-10)
    transfer = sampled_block(ct.tf([1.0, 0.5], [1.0, -0.2], 0.01, name="lead", inputs="e", outputs="u"))
    assert transfer.name == "lead"
    assert transfer.continuous(2j) == pytest.approx(transfer.linearize()(2j))
    # In rest both have the same state.
    stable = ct.ss([[0.5, 0.1], [0.0, 0.2]], [[1.0], [2.0]], [[1.0, 0.0]], [[0.0]], 0.01)
    equivalent = sampled_block(stable).linearize()
    np.testing.assert_allclose(
        -np.linalg.solve(equivalent.A, equivalent.B),
        np.linalg.solve(np.eye(2) - stable.A, stable.B),
        rtol=1e-12,
    )


def test_an_eigenvalue_at_minus_one_has_no_equivalent():
    with pytest.raises(ValueError, match="eigenvalue at -1"):
        sampled_block(ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.01)).linearize()


def counter():
    """x+ = x + k u |u|, y = tanh x + u: a law with a state, a parameter and a feedthrough."""
    t, x, u, p = (ca.SX.sym(name) for name in "txup")
    return BlockFunctions(
        (Variable("n", 0.25),),
        (Variable("u"),),
        (Variable("y"),),
        (Variable("k", 2.0),),
        ca.Function("dynamics", [t, x, u, p], [x + p * u * ca.fabs(u)]),
        ca.Function("output", [t, x, u, p], [ca.tanh(x) + u]),
    )


def test_functions_with_a_period():
    block = sampled_block(counter(), dt=0.1, name="counter")
    assert (block.period, block.system, block.filter) == (0.1, None, None)
    linear = block.linearize(u0=[0.5], params={"k": 3.0})
    # Discrete by hand: A = 1, B = 2 k |u| = 3, C = 1 - tanh(0.25)^2, D = 1; Tustin: z = (1 + s/20)/(1 - s/20).
    s = 1.7j
    z = (1.0 + s / 20.0) / (1.0 - s / 20.0)
    assert linear(s) == pytest.approx((1.0 - np.tanh(0.25) ** 2) * 3.0 / (z - 1.0) + 1.0, rel=1e-10)
    # The equations for a diagram's linearisation: forward differences, x' = 2 k |u| u / period.
    equations = function_block(block.continuous, name="equivalent").linearize(u0=[0.5])
    assert equations(s) == pytest.approx((1.0 - np.tanh(0.25) ** 2) * 2.0 / 0.1 / s + 1.0, rel=1e-10)
    static = function_block(counter(), name="memoryless")
    assert sampled_block(function_block(static.functions, name="own", dt=0.2)).law is static.functions


def test_a_nonlinear_system_of_python_controls():
    system = ct.nlsys(
        lambda t, x, u, params: 0.5 * x + np.sin(u),
        lambda t, x, u, params: x,
        inputs="e",
        outputs="u",
        states="x",
        dt=0.1,
        name="law",
    )
    block = sampled_block(system)
    assert (block.law, block.system is system, block.continuous) == (None, True, None)
    z = np.exp(0.4j)
    s = 20.0 * (z - 1.0) / (z + 1.0)
    assert block.linearize(0.0, 0.0)(s) == pytest.approx(1.0 / (z - 0.5), rel=1e-5)  # eps = 1e-6


@pytest.mark.parametrize(
    ("arguments", "keywords", "message"),
    [
        ((FILTER,), {}, "a PhyFilter is continuous; sample it first"),
        ((3.0,), {}, "got float"),
        ((ct.frd([1.0], [1.0]),), {}, "got FrequencyResponseData"),
        (
            (ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], name="lag"),),
            {},
            "'lag' has dt = 0: expected a sampling",
        ),
        ((ct.ss([[0.1]], [[1.0]], [[1.0]], [[0.0]], True, name="lag"),), {}, "'lag' has dt = True"),
        ((controller(),), {"dt": 0.02}, "own sampling interval 0.01"),
        ((controller(), 2), {}, "only a SampledPhyFilter has them"),
        ((counter(),), {}, "dt: expected the seconds"),
        ((counter(),), {"dt": 0.0}, "dt: expected a finite number > 0 s"),
        ((FILTER.sampled(H),), {}, "number of channels"),
        ((FILTER.sampled(H), 2), {"dt": H}, "leave dt out"),
        ((FILTER.sampled(H), 2), {"inertia": "upper"}, "'scalar', 'diagonal' or 'full'"),
        ((FILTER.sampled(H), 2), {"inertia": np.ones((3, 3))}, "inertia: expected a finite number or shape"),
    ],
)
def test_bad_blocks_are_refused(arguments, keywords, message):
    with pytest.raises((ValueError, TypeError), match=message):
        sampled_block(*arguments, **keywords)
