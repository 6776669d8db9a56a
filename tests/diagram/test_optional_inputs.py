"""Inputs with a default may be left open; what looks like a slip of the pen is refused all the same."""

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, sampled_block
from phyfilter_ctl.blocks import wired
from phyfilter_ctl.codegen import compile_model
from phyfilter_ctl.controllers.known import known_force
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.plants import mass, plant, quadrotor
from phyfilter_ctl.simulation import simulate

TIMES = np.linspace(0.0, 1.0, 11)
BIAS = [0.5, -0.25]


def controller(name="control", **options):
    """u = r - f_hat; f_hat stays at a default that is not 0, so that 0 in its place shows."""

    def law(t, x, u, p):
        return {}, {"u": u.r_ref - u.f_hat}

    return plant(
        law,
        name=name,
        states={},
        inputs={"r_ref": np.zeros(2), "f_hat": BIAS},
        outputs=["u"],
        **{"optional": ["f_hat"]} | options,
    )


def estimator(output="f_hat", name="estimator"):
    def law(t, x, u, p):
        return {}, {output: 2.0 * u.v}

    return plant(law, name=name, states={}, inputs={"v": np.zeros(2)}, outputs=[output])


def loop(*more, wires=(), **options):
    return wired(
        [controller(), mass(2), *more],
        {"mass.force": "control.u", **dict(wires)},
        inputs={"r": "control.r_ref"},
        outputs={"v": "mass.v"} | options,
        name="loop",
    )


def test_left_open_it_has_its_default():
    response = simulate(loop(), TIMES, [1.0, 1.0])
    expected = np.outer(1.0 - np.array(BIAS), TIMES)
    np.testing.assert_allclose(response.outputs["v"], expected, atol=1e-12)
    assert flatten(loop()).undriven == ()
    zero = simulate(flatten(loop(), unconnected="zero"), TIMES, [1.0, 1.0])
    np.testing.assert_array_equal(zero.outputs, response.outputs)


def test_c_and_a_diagram_around_it_take_the_same():
    around = wired([loop()], {}, inputs={"r": "loop.r"}, outputs={"v": "loop.v"}, name="around")
    run = compile_model(flatten(around)).simulate(TIMES, [[1.0, 1.0]] * len(TIMES), max_step=0.01)
    expected = np.outer(1.0 - np.array(BIAS), TIMES)
    np.testing.assert_allclose(np.asarray(run.outputs).T, expected, atol=1e-12)


def test_an_input_of_a_diagram_inside_may_be_left_open():
    inner = wired(
        [controller()],
        {},
        inputs={"r": "control.r_ref", "f_hat": "control.f_hat"},
        outputs={"u": "control.u"},
        name="inner",
    )
    outer = wired([inner], {}, inputs={"r": "inner.r"}, outputs={"u": "inner.u"}, name="outer")
    response = simulate(outer, TIMES, [1.0, 1.0])
    np.testing.assert_allclose(response.outputs["u"][:, 0], 1.0 - np.array(BIAS))


def test_an_input_without_a_default_is_refused_with_names_alike():
    with pytest.raises(ValueError, match=r"nothing drives mass\.force\[0\], mass\.force\[1\]"):
        flatten(wired([controller(), mass(2)], {}, inputs={"r": "control.r_ref"}, outputs={"v": "mass.v"}))
    more = estimator("forces")
    with pytest.raises(ValueError, match=r"called alike: estimator\.forces\[0\]"):
        flatten(wired([mass(2), more], {"estimator.v": "mass.v"}, outputs={"v": "mass.v"}))
    with pytest.raises(ValueError, match=r"nothing drives control\.f_hat"):
        flatten(
            wired([controller(optional=[])], {}, inputs={"r": "control.r_ref"}, outputs={"u": "control.u"})
        )


@pytest.mark.parametrize(
    ("way", "output"),
    [
        *(("by name", output) for output in ("f_hatt", "fhat", "F_hat", "f_het")),
        *(("by wires", output) for output in ("f_hat", "f_hatt")),
    ],
)
@pytest.mark.filterwarnings("ignore:Unused")
def test_an_estimate_that_goes_nowhere_is_refused(way, output):
    """A slip in a name, wherever python-control wires by names, or a wire that was forgotten."""
    more = estimator(output)
    if way == "by name":
        body = mass(2, name="body")
        glue = plant(
            lambda t, x, u, p: ({}, {"force": u.u}),
            name="glue",
            states={},
            inputs={"u": np.zeros(2)},
            outputs=["force"],
        )
        labels = {"inputs": ["r_ref[0]", "r_ref[1]"], "outputs": ["v[0]", "v[1]"], "name": "loop"}
        diagram = ct.interconnect([controller(), body, glue, more], **labels)
    else:
        diagram = loop(more, wires={"estimator.v": "mass.v"})
    with pytest.raises(
        ValueError, match=rf"nothing drives control\.f_hat, .* estimator\.{output} drives nothing"
    ):
        flatten(diagram)
    assert flatten(diagram, unconnected="zero").undriven == ()


def test_an_estimate_that_is_shown_only_is_meant():
    diagram = loop(estimator(), wires={"estimator.v": "mass.v"}, f_hat="estimator.f_hat")
    response = simulate(diagram, TIMES, [1.0, 1.0])
    np.testing.assert_allclose(response.outputs["v"], np.outer(1.0 - np.array(BIAS), TIMES), atol=1e-12)
    closed = loop(estimator(), wires={"estimator.v": "mass.v", "control.f_hat": "estimator.f_hat"})
    assert simulate(closed, TIMES, [1.0, 1.0]).outputs["v"][0, -1] < 0.6


def test_half_a_vector_is_a_slip():
    diagram = ct.interconnect(
        [controller()],
        connections=False,
        inplist=["control.r_ref[0]", "control.r_ref[1]", "control.f_hat[0]"],
        inputs=3,
        outlist=["control.u[0]"],
        outputs=1,
        check_unused=False,
    )
    with pytest.raises(ValueError, match=r"nothing drives control\.f_hat\[1\]"):
        flatten(diagram)


@pytest.mark.parametrize("wire", ["control.f_hatt", "control.fhat", "contrl.f_hat"])
def test_a_slip_in_a_wire_is_refused_with_the_name_close_to_it(wire):
    with pytest.raises(ValueError, match=r"did you mean '(f_hat|control)'\?"):
        loop(estimator(), wires={"estimator.v": "mass.v", wire: "estimator.f_hat"})
    with pytest.raises(ValueError, match=r"did you mean 'f_hat'\?"):
        loop(estimator(), wires={"estimator.v": "mass.v", "control.f_hat": "estimator.f_hatt"})


def test_names_of_optional_inputs_are_checked():
    with pytest.raises(ValueError, match=r"control: optional: .*'f_het'.*did you mean 'f_hat'\?"):
        controller(optional=["f_het"])
    with pytest.raises(ValueError, match="control: optional: expected names"):
        controller(optional="f_hat")
    assert "f_hat[0]   0.5" in controller().describe()
    assert "(optional)" in controller().describe()


def test_blocks_of_the_library_say_which_they_are():
    def optional(block):
        return [v.name for v in getattr(block, "functions", getattr(block, "law", None)).inputs if v.optional]

    prior = {"mass": 3.0, "motor_lag": 0.04, "rotor_max": 16.2, "dt": 0.002}
    assert optional(known_force(**prior)) == ["F[0]", "F[1]", "F[2]"]
    assert optional(known_force(**prior, kind="commanded")) == [f"thrust[{i}]" for i in range(4)]
    assert optional(quadrotor(mass=3.0, J=[0.035, 0.035, 0.06], arm=0.25, torque_ratio=0.016)) == [
        "wind[0]",
        "wind[1]",
        "wind[2]",
    ]
    block = sampled_block(PhyFilter([20.0]).sampled(0.01), 2)
    assert optional(block) == ["f_theta[0]", "f_theta[1]"]
