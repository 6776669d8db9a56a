"""Scalar functions without CasADi's questions and in pieces: the same numbers, to the last digit."""

import casadi as ca
import control as ct
import numpy as np
import pytest

from phyfilter_ctl.codegen import compile_model
from phyfilter_ctl.codegen.casadi_source import casadi_header
from phyfilter_ctl.codegen.diagram_source import diagram_model
from phyfilter_ctl.diagram import flatten


def network(n, seed=4):
    rng = np.random.default_rng(seed)
    weights, sources = rng.normal(size=(n, 3)), rng.integers(0, n, size=(n, 3))

    def rates(t, x, u, params):
        return [
            params["k"] * np.tanh(weights[i] @ x[sources[i]] + u[0])
            - np.where(x[i] > 0.1, x[i], x[i] ** 3) * x[0]
            for i in range(n)
        ]

    return ct.nlsys(rates, None, inputs=1, outputs=n, states=n, params={"k": 1.3}, name="network")


def test_no_question_and_no_wrapper_is_left():
    """A scalar function is its own entry; one that others call too keeps CasADi's form."""
    x, y = ca.SX.sym("x", 3), ca.MX.sym("y", 3)
    inner = ca.Function("inner", [x], [ca.sin(x) * x[0]], ["x"], ["dx"])
    outer = ca.Function("outer", [y], [inner(inner(y))], ["y"], ["dy"])
    text = casadi_header({"alone": inner}, "demo")
    assert "? arg" not in text
    assert "res[0]!=0" not in text
    assert "static int demo_alone(const pf_real *x, pf_real *dx) {" in text
    both = casadi_header({"nested": outer}, "demo")
    assert "? arg" in both


@pytest.mark.slow
@pytest.mark.parametrize("piece", [7, 40, 10_000])
def test_pieces_compute_what_the_whole_does(monkeypatch, piece):
    """C against CasADi's virtual machine: tanh may differ in its last digit between the two, all else may not."""
    monkeypatch.setattr("phyfilter_ctl.codegen.scalar_source._PIECE", piece)
    flat = flatten(network(40))
    model = diagram_model(flat, name=f"network_{piece}")
    assert ("PF_APART static void" in model.sources[f"network_{piece}_equations.h"]) == (piece < 10_000)
    instance = compile_model(model, flags=("-Wall", "-Wextra", "-Wpedantic", "-Werror")).instance()
    rng = np.random.default_rng(0)
    for _ in range(5):
        instance.x[:], instance.u[:] = rng.normal(size=40), rng.normal()
        expected = flat.dynamics(0.0, instance.x, instance.u, flat.start_parameters(), [])
        np.testing.assert_allclose(
            instance.derivatives(0.0), np.asarray(expected).ravel(), rtol=1e-14, atol=1e-15
        )
        seeds = rng.normal(size=40), rng.normal(size=1), rng.normal(size=1)
        along = instance.directional(0.0, *seeds)[0]
        back = instance.adjoint(0.0, weight := rng.normal(size=40), np.zeros(40))
        np.testing.assert_allclose(
            weight @ along, sum(s @ b for s, b in zip(seeds, back, strict=True)), rtol=1e-12
        )
