"""A filter without a learned model as a block: no input f_theta, and the answers are those of one that is held at 0."""

import itertools

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.codegen import compile_model

H = 0.01
F = pf.PhyFilter.from_poles([-20.0, -6 + 8j, -6 - 8j])
# The same arithmetic with and without zeros that are added.
ROUNDING = 1e-12
# Two compilations of one recursion, double against double.
COMPILED = 1e-11
# Rounding of x and f_hat of size 1 to float, some of it over h.
FLOAT = 2e-4
T = np.linspace(0.0, 0.6, 61)


def loop(block, outputs=("f_hat[0]", "x[0]")):
    """A mass with drag pushed by f; what the filter finds is cancelled, and the force that acts is known to it."""
    mass = ct.ss([[-1.0]], [[0.5]], [[1.0]], [[0.0]], inputs="force", outputs="x[0]", name="mass")
    cancel = ct.ss([], [], [], [[-0.6]], inputs="f_hat[0]", outputs="g[0]", name="cancel")
    add = ct.summing_junction(inputs=["g[0]", "f"], output="force", name="add")
    inputs = ["f"] + [label for label in block.input_labels if label.startswith("f_theta")]
    return ct.interconnect([mass, cancel, add, block], inputs=inputs, outputs=list(outputs), name="loop")


def pair(maker, *args, **options):
    return loop(maker(*args, **options)), loop(maker(*args, f_theta=False, **options))


def both(sampled):
    filter = F.sampled(H) if sampled else F
    return pair(pf.sampled_block if sampled else pf.phyfilter_block, filter, 1, inertia=2.0)


@pytest.mark.parametrize("sampled", [False, True])
def test_the_block_has_no_such_input_and_nothing_is_missing(sampled):
    """No warning of python-control about an unused input, none of an undriven one here."""
    _, without = both(sampled)
    flat = pf.flatten(without)
    assert [v.name for v in flat.inputs] == ["f"]
    assert flat.undriven == ()
    assert not any("f_theta" in v.name for v in (*flat.states, *flat.inputs, *flat.held))


@pytest.mark.parametrize("sampled", [False, True])
def test_it_runs_and_is_analysed_as_with_f_theta_zero(sampled):
    given, without = both(sampled)
    runs = [
        pf.simulate(given, T, [np.sin(5.0 * T), 0.0]).outputs,
        pf.simulate(without, T, np.sin(5.0 * T)).outputs,
    ]
    np.testing.assert_allclose(runs[1], runs[0], atol=ROUNDING)
    assert np.abs(runs[0]).max() > 0.5  # it did find something
    linear = [pf.flatten(each).linearize() for each in (given, without)]
    s = 3.0j
    np.testing.assert_allclose(linear[1](s)[:, 0], linear[0](s)[:, 0], rtol=ROUNDING)
    margins = [pf.margins(each, at="cancel.g[0]") for each in (given, without)]
    assert margins[1].phase_margin == pytest.approx(margins[0].phase_margin, rel=1e-9)
    assert margins[1].delay_margin == pytest.approx(margins[0].delay_margin, rel=1e-6)


@pytest.mark.parametrize(("g", "f"), list(itertools.product(["hold", "average"], repeat=2)))
@pytest.mark.parametrize("options", [{}, {"delay": 0.013}, {"limit": 0.5, "nonfinite": "hold"}])
def test_the_law_is_run_without_f_theta(g, f, options):
    """Against :meth:`SampledPhyFilter.run`, which shares no code with the law of a block."""
    sampled = F.sampled(H, g=g, f_theta=f, **options)
    rng = np.random.default_rng(1)
    x, known = np.cumsum(0.02 * rng.standard_normal((61, 2)), axis=0), rng.standard_normal((61, 2))
    block = pf.sampled_block(sampled, 2, f_theta=False)
    assert block.input_labels == ["x[0]", "x[1]", "g[0]", "g[1]"]
    run = pf.simulate(block, T, np.hstack([x, known]).T, interpolation="hold")
    expected = sampled.run(x, known)
    np.testing.assert_allclose(run.outputs.T, expected, atol=ROUNDING * np.abs(expected).max() * len(T))


@pytest.mark.parametrize("kind", ["scalar", "diagonal", "full"])
def test_inertia_as_an_input_follows_g(kind):
    block = pf.sampled_block(F.sampled(H, delay=0.4 * H), 2, inertia=kind, f_theta=False)
    assert block.input_labels[4] == ("M[0,0]" if kind == "full" else "M[0]")
    given = pf.sampled_block(F.sampled(H, delay=0.4 * H), 2, inertia=kind)
    M = {"scalar": [2.0], "diagonal": [2.0, 3.0], "full": [2.0, 0.1, 0.2, 3.0]}[kind]
    s = 7.0j
    ours, theirs = block.linearize(u0=[0.0] * 4 + M)(s), given.linearize(u0=[0.0] * 6 + M)(s)
    np.testing.assert_allclose(ours[:, :4], theirs[:, :4], rtol=1e-12)
    flat = pf.flatten(block).linearize(u0=[0.0] * 4 + M)(s)
    np.testing.assert_allclose(flat[:, :4], theirs[:, :4], rtol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.4 * H, 3.2 * H])
@pytest.mark.parametrize("f", ["hold", "average"])
def test_the_discrete_block(delay, f):
    """python-control's own simulation, against run."""
    sampled = F.sampled(H, f_theta=f, delay=delay)
    block = pf.phyfilter_block(sampled, 1, inertia=2.0, f_theta=False)
    x, g = np.sin(3.0 * T) + 1.0, np.cos(2.0 * T)
    start = block.rest_state([x[0]], [g[0]])
    response = ct.forced_response(block, T, [x, g], X0=start)
    np.testing.assert_allclose(
        response.outputs.T, sampled.run(x[:, None], g[:, None], inertia=2.0), atol=1e-11
    )
    with pytest.raises(ValueError, match="f_theta0: expected shape"):
        block.rest_state([1.0], f_theta0=[1.0])


@pytest.mark.parametrize(
    ("real", "precision", "allowed"),
    [
        ("double", "float64", COMPILED),
        ("float", "float64", FLOAT),
        pytest.param("double", "float32", FLOAT, marks=pytest.mark.slow),
    ],
)
def test_c_runs_it(real, precision, allowed):
    """Precision float32 in a diagram in double: the filter has numbers of its own."""
    without = loop(pf.sampled_block(F.sampled(H, precision=precision), 1, inertia=2.0, f_theta=False))
    ours = pf.simulate(without, T, 1.0, method="rk4", max_step=H, backend="vm").outputs
    run = compile_model(pf.flatten(without), real=real).simulate(T, np.ones((len(T), 1)), max_step=H)
    np.testing.assert_allclose(run.outputs.T, ours, atol=allowed)


@pytest.mark.parametrize(
    "maker", [pf.phyfilter_block, lambda f, n, **k: pf.sampled_block(f.sampled(H), n, **k)]
)
def test_something_else_than_a_bool_is_refused(maker):
    with pytest.raises(TypeError, match="f_theta: expected True"):
        maker(F, 1, f_theta="hold")


def test_only_a_filter_has_the_option():
    with pytest.raises(ValueError, match="f_theta: only a SampledPhyFilter"):
        pf.sampled_block(ct.tf([1.0], [1.0, 0.5], H), f_theta=False)
