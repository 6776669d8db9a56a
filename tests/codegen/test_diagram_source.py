"""C of a flat diagram against CasADi's evaluation of it: values, derivatives, sources, what is refused."""

import re
import subprocess
from dataclasses import replace
from importlib.util import find_spec

import casadi as ca
import control as ct
import numpy as np
import pytest
from flat_models import STRICT, model, oscillator, pendulum, symbols, two_rates, variables

from phyfilter_ctl.blocks.functions import Variable
from phyfilter_ctl.codegen import compile_model, find_compiler
from phyfilter_ctl.codegen.casadi_source import casadi_header
from phyfilter_ctl.codegen.diagram_source import diagram_model
from phyfilter_ctl.codegen.identifiers import identifiers
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.diagram.model import FlatModel

# C and CasADi's interpreter do the same operations in the same order; libm's own functions may be inlined otherwise.
SAME = 4e-16
# One rounding to float of inputs, constants and each operation; the numbers are of size 10.
FLOAT = 2e-5
# Central differences with steps of 1e-6 in functions with curvatures around 10.
DIFFERENCES = 1e-7


@pytest.fixture(scope="module", params=["double", "float"])
def compiled(request):
    return compile_model(pendulum(), real=request.param, derivatives=True, flags=STRICT)


@pytest.fixture(scope="module")
def implicit():
    """x' = w with w + w^3 = x + u, by Newton; y = w + x."""
    w, x = ca.SX.sym("w"), ca.SX.sym("x")
    solver = ca.rootfinder("w", "fast_newton", ca.Function("r", [w, x], [w + w**3 - x]), {"abstol": 1e-13})
    t, x, u, p, z = (ca.MX.sym(n, k) for n, k in (("t", 1), ("x", 1), ("u", 1), ("p", 0), ("z", 0)))
    root = solver(0.0, x + u)
    return FlatModel(
        "implicit",
        variables("x", 1),
        variables("u", 1),
        variables("y", 1),
        (),
        (),
        ca.Function("f", [t, x, u, p, z], [root]),
        ca.Function("h", [t, x, u, p, z], [root + x]),
    )


def tolerance(compiled):
    return SAME * 10 if compiled.library.dtype == np.float64 else FLOAT


def point(compiled, rng):
    instance = compiled.instance()
    flat = pendulum()
    x, u = rng.normal(size=3), rng.normal(size=2)
    p = np.array([9.81, 0.3]) * rng.uniform(0.5, 1.5, 2)
    instance.x[:], instance.u[:] = x, u
    instance.set_parameters(p)
    # The same rounded numbers on both sides.
    return flat, instance, instance.x.astype(float), instance.u.astype(float), instance.p.astype(float)


@pytest.mark.parametrize("seed", range(5))
def test_derivatives_and_outputs_are_casadis(compiled, seed):
    flat, instance, x, u, p = point(compiled, np.random.default_rng(seed))
    t = 0.4 * seed
    for got, function in ((instance.derivatives(t), flat.dynamics), (instance.outputs(t), flat.output)):
        expected = np.asarray(function(t, x, u, p, [])).ravel()
        np.testing.assert_allclose(
            got, expected, rtol=0, atol=tolerance(compiled) * (1 + np.abs(expected).max())
        )


def test_products_with_the_jacobian_are_differences_and_their_transpose():
    rng = np.random.default_rng(3)
    compiled = compile_model(pendulum(), derivatives=True)
    flat, instance, x, u, p = point(compiled, rng)
    v = np.concatenate([x, u, p])
    both = ca.Function("both", [*flat.dynamics.sx_in()], flat.dynamics.call(flat.dynamics.sx_in()))

    def value(v):
        parts = (0.25, v[:3], v[3:5], v[5:], [])
        return np.concatenate([np.asarray(f(*parts)).ravel() for f in (both, flat.output)])

    steps = 1e-6 * np.eye(7)
    jacobian = np.stack([(value(v + s) - value(v - s)) / 2e-6 for s in steps], axis=1)
    seed, cotangent = rng.normal(size=7), rng.normal(size=5)
    forward = np.concatenate(instance.directional(0.25, seed[:3], seed[3:5], seed[5:]))
    reverse = np.concatenate(instance.adjoint(0.25, cotangent[:3], cotangent[3:]))
    np.testing.assert_allclose(forward, jacobian @ seed, atol=DIFFERENCES * 10)
    np.testing.assert_allclose(reverse, jacobian.T @ cotangent, atol=DIFFERENCES * 10)
    # Sharper than differences: <w, J v> = <J' w, v>.
    assert cotangent @ forward == pytest.approx(reverse @ seed, rel=1e-13)


def test_products_are_left_out_where_nobody_wants_them():
    instance = compile_model(pendulum()).instance()
    with pytest.raises(RuntimeError, match="without directional products; compile it with derivatives=True"):
        instance.directional(0.0, np.zeros(3), np.zeros(2), np.zeros(2))


def test_dependencies_come_from_the_structure():
    depends = diagram_model(pendulum()).depends
    assert depends.astype(int).tolist() == [
        [0, 1, 0, 0, 0],
        [1, 1, 0, 1, 0],
        [0, 0, 0, 0, 0],
        [1, 0, 0, 0, 0],
        [1, 0, 1, 0, 1],
    ]


def test_newton_inside_solves_and_differentiates(implicit):
    instance = compile_model(implicit, derivatives=True, flags=STRICT).instance()
    instance.x[:], instance.u[:] = 1.5, 0.5
    assert instance.derivatives(0.0)[0] == pytest.approx(1.0, abs=1e-13)  # 1 + 1^3 = 2
    assert instance.outputs(0.0)[0] == pytest.approx(2.5, abs=1e-13)
    dx, y = instance.directional(0.0, [1.0], [1.0], [])  # dw = (dx + du) / (1 + 3 w^2)
    assert (dx[0], y[0]) == pytest.approx((0.5, 1.5), abs=1e-12)
    to_x, to_u, _ = instance.adjoint(0.0, [1.0], [2.0])
    assert (to_x[0], to_u[0]) == pytest.approx((0.25 * 3 + 2, 0.25 * 3), abs=1e-12)


def test_newton_that_fails_is_told_and_nan_is_no_solution(implicit):
    instance = compile_model(implicit).instance()
    for bad in (np.nan, np.inf):
        instance.u[:] = bad
        with pytest.raises(RuntimeError, match="does not converge"):
            instance.derivatives(0.0)
    run = compile_model(implicit).simulate([0.0, 1.0], [[0.0], [np.inf]], interpolation="hold")
    assert run.status == 2
    assert run.rows == 1
    assert "Newton" in run.message


def test_newton_in_float_is_refused(implicit):
    with pytest.raises(ValueError, match=r"nonlinear algebraic loop.*use real='double'"):
        diagram_model(implicit, real="float")


def test_a_solver_without_c_code_is_refused_with_the_way_out():
    w, v, x = ca.SX.sym("w"), ca.SX.sym("v"), ca.MX.sym("x")
    residual = ca.Function("r", [w, v], [w**3 + w - v])
    function = ca.Function("f", [x], [ca.rootfinder("s", "newton", residual)(0.0, x)], ["x"], ["y"])
    with pytest.raises(
        ValueError, match=r"no C code for a part of it \(.*Newton\); solve implicit equations"
    ):
        casadi_header({"f": function}, "demo")


def test_a_float_model_has_no_double_arithmetic_in_its_equations():
    text = diagram_model(pendulum(), real="float").sources["pendulum_equations.h"]
    assert "sinf(" in text
    assert " sin(" not in text
    assert "=9.9999999999999998e-04" not in text.replace(" ", "").replace("e-04f", "")


def test_header_names_signals_with_units():
    text = diagram_model(pendulum()).sources["pendulum.h"]
    assert "PENDULUM_P_BLOCK_P0 = 0, /* block.p0, 1/s, 9.81 */" in text
    assert "PENDULUM_X_X_2 = 2 /* x[2], -, 0.4 */" in text
    assert "fast: every 0.002 s" in diagram_model(two_rates()).sources["two_rates.h"]


@pytest.mark.parametrize("real", ["double", "float"])
def test_every_symbol_has_the_prefix(real, tmp_path):
    sources = diagram_model(two_rates(), real=real).sources
    for name, text in sources.items():
        (tmp_path / name).write_text(text)
    command = find_compiler().command
    for name in sources:
        if name.endswith(".c"):
            subprocess.run([*command, "-std=c99", *STRICT, "-c", name], cwd=tmp_path, check=True)
    objects = [path.name for path in tmp_path.glob("*.o")]
    listed = subprocess.run(
        ["nm", "-g", *objects], cwd=tmp_path, check=True, capture_output=True, text=True
    ).stdout
    defined = [line.split()[2] for line in listed.splitlines() if len(line.split()) == 3]
    assert "two_rates_model" in defined
    assert all(name.startswith(("pf_", "two_rates_")) for name in defined)
    needed = {line.split()[1] for line in listed.splitlines() if line.startswith(" ")}
    assert not needed & {"malloc", "calloc", "realloc", "free", "printf"}


@pytest.mark.slow
def test_another_compiler_gives_the_same_numbers():
    if find_spec("ziglang") is None:
        pytest.skip("ziglang is not installed")
    import sys

    clang = compile_model(two_rates(), compiler=[sys.executable, "-m", "ziglang", "cc"], flags=STRICT)
    system = compile_model(two_rates(), flags=STRICT)
    times, u = np.linspace(0.0, 0.5, 101), np.ones((101, 1))
    one, other = clang.simulate(times, u, max_step=1e-3), system.simulate(times, u, max_step=1e-3)
    np.testing.assert_allclose(one.outputs, other.outputs, rtol=0, atol=1e-13)  # sin is another library's


def test_names_that_c_does_not_have():
    with pytest.raises(ValueError, match=r"expected a C identifier.*got 'two rates'; try 'two_rates'"):
        diagram_model(two_rates(), name="two rates")
    for word in ("double", "sin", "memcpy"):
        with pytest.raises(ValueError, match="no word of C"):
            diagram_model(two_rates(), name=word)
    assert diagram_model(replace(two_rates(), name="exp")).name == "exp_model"
    with pytest.raises(ValueError, match="real: expected 'double' or 'float', got 'half'"):
        diagram_model(two_rates(), real="half")
    with pytest.raises(ValueError, match="step: expected a positive number"):
        diagram_model(two_rates(), step=0.0)
    assert identifiers(["a.b", "a_b", "int*/x"]) == ("a_b", "a_b_2", "int_x")


def test_text_of_the_user_cannot_leave_its_comment():
    arguments = symbols(0, 1, 1, 0)
    flat = model("odd", arguments, ca.SX(0, 1), arguments[2] * arguments[3], parameters=(1.0,))
    odd = (Variable('say "hi" */ ??/ \\n', 1.0, "*/", "/* é"),)
    flat = FlatModel("odd", (), flat.inputs, flat.outputs, odd, (), flat.dynamics, flat.output)
    compiled = compile_model(flat, flags=STRICT)
    with pytest.raises(ValueError, match="hi"):
        compiled.instance().set_parameters([np.nan])


def test_parameters_are_put_in_force_together_or_not_at_all():
    instance = compile_model(pendulum()).instance()
    before = instance.derivatives(0.0)
    with pytest.raises(ValueError, match=r"refuses them: block\.p1 is not a number"):
        instance.set_parameters([1.0, np.nan])
    assert instance.p.tolist() == [9.81, 0.3]
    np.testing.assert_array_equal(instance.derivatives(0.0), before)
    instance.p[0] = 1.0  # set, not yet in force
    np.testing.assert_array_equal(instance.derivatives(0.0), before)
    with pytest.raises(ValueError, match=r"has no parameter 'p0'; it has \['block.p0', 'block.p1'\]"):
        instance.set_parameters({"p0": 1.0})


def test_a_discrete_diagram_is_one_sampled_block():
    import control as ct

    lag = ct.ss([[0.5, 0.1], [0.0, 0.9]], [[1.0], [0.5]], [[1.0, 2.0]], [[0.25]], 0.1, name="lag")
    rng = np.random.default_rng(1)
    u = rng.normal(size=41)
    times = 0.1 * np.arange(41)
    expected = ct.forced_response(lag, times, u)
    run = compile_model(flatten(lag), flags=STRICT).simulate(times, u[:, None], interpolation="hold")
    np.testing.assert_allclose(run.outputs[:, 0], expected.outputs, rtol=0, atol=1e-14)
    again = compile_model(flatten(lag)).simulate(
        times, u[:, None], sampled_state=[1.0, -1.0], interpolation="hold"
    )
    expected = ct.forced_response(lag, times, u, [1.0, -1.0])
    np.testing.assert_allclose(again.outputs[:, 0], expected.outputs, rtol=0, atol=1e-14)


def test_a_model_without_inputs_and_parameters():
    arguments = symbols(1, 0, 0, 0)
    run = compile_model(
        model("decay", arguments, -arguments[1], arguments[1] + 0, starts=(1.0,)),
        derivatives=True,
        flags=STRICT,
    ).simulate([0.0, 1.0], max_step=0.01)
    assert run.outputs[1, 0] == pytest.approx(np.exp(-1.0), abs=1e-9)
    assert diagram_model(oscillator()).inputs == ()


PEDANTIC = ("-Wall", "-Wextra", "-Wpedantic", "-Werror")
# What has a meaning in C, in its library, on a file system or in the generated code itself.
AWKWARD = (
    *(
        "s",
        "x",
        "u",
        "y",
        "t",
        "p",
        "z",
        "dx",
        "self",
        "start",
        "sample",
        "states",
        "inputs",
        "outputs",
        "parameters",
    ),
    *(
        "apply",
        "derivatives",
        "now",
        "before",
        "instance",
        "next_instant",
        "int",
        "class",
        "sin",
        "y0",
        "gamma",
    ),
    *(
        "string",
        "math",
        "con",
        "pf",
        "pf_x",
        "NULL",
        "int64_t",
        "pf_real",
        "INFINITY",
        "f",
        "_",
        "__",
        "1a",
        "a-b",
    ),
    *("if", "θ", "über"),
)


def awkward(name, signals=("x", "u", "y")):
    state, force, parameter = signals
    update = lambda t, x, u, p: [p[parameter] * (u[0] - x[0])]  # noqa: E731
    plant = ct.nlsys(
        update, None, inputs=[force], outputs=["out"], states=[state], params={parameter: 2.0}, name=name
    )
    return diagram_model(flatten(plant), derivatives=False)


def words(model):
    """Identifiers in the model's own two files."""
    text = model.sources[f"{model.name}.c"] + model.sources[f"{model.name}.h"]
    return set(re.findall(r"\w+", re.sub(r'/\*.*?\*/|"[^"]*"', " ", text, flags=re.DOTALL)))


@pytest.mark.parametrize("name", ["x", "start", "self", "int", "con", "pf"])
def test_no_diagram_is_called_like_its_code(name):
    model, neutral = awkward(name), words(awkward("neutral"))
    assert model.name not in neutral
    assert model.name != name
    assert f"/* {name}\n" in model.sources[f"{model.name}.h"]
    with pytest.raises(ValueError, match=f"got {name!r}; try"):
        diagram_model(flatten(ct.tf([1.0], [1.0, 1.0])), name=name)


@pytest.mark.slow
def test_every_name_compiles(tmp_path):
    """As system, as signals and as parameter; and every word of the generated code itself."""
    names = [*AWKWARD, *sorted(words(awkward("neutral")) - {"neutral"})]
    checked = 0
    for name in names:
        model = awkward(name, (name, f"{name}1", name.upper() or name))
        for file, text in model.sources.items():
            (tmp_path / file).write_text(text)
        command = [
            *find_compiler().command,
            *PEDANTIC,
            "-std=c99",
            "-fsyntax-only",
            str(tmp_path / f"{model.name}.c"),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{name}: {done.stderr}"
        checked += 1
    assert checked > 60


def test_signals_that_differ_in_capitals_or_marks_have_each_an_index():
    header = awkward("m", ("v", "u", "k")).sources["m.h"]
    assert "M_X_V = 0" in header
    names = ["v", "V", "v[0]", "v.0", "v_0", "v_0_2", "é", "e", "θ", "theta", "Θ"]
    found = identifiers(names)
    assert len({name.upper() for name in found}) == len(names)
    assert found[:4] == ("v", "V_2", "v_0", "v_0_2")
