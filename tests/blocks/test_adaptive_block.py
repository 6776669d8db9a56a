"""The adaptive law as a block, against AdaptiveChebyshev on the same signals, and in a loop, in VM and C."""

from dataclasses import replace

import casadi as ca
import control as ct
import numpy as np
import pytest

from phyfilter_ctl import simulate, simulate_batch
from phyfilter_ctl.blocks import SampledBlock, adaptive_block
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.learned import AdaptiveChebyshev, Chebyshev

H = 0.01
N = 400
# LDL' step by step against an inverse and one banded solution, of equations whose condition is below 1e3.
AGREE = 1e-12
# VM and C evaluate the same expressions; C may fuse a product and a sum.
VM_IS_C = 1e-13


def random_model(n_z=2, n_x=2, degree_d=2, n_d=1, outside="clip"):
    rng = np.random.default_rng(0)
    terms = 3**n_z * (degree_d + 1) ** n_d
    bounds = np.column_stack([-1.0 - rng.random(n_z + n_d), 1.0 + rng.random(n_z + n_d)])
    return Chebyshev(
        2,
        n_d=n_d,
        degree_d=degree_d,
        bounds=bounds,
        Xi=rng.standard_normal((n_x, terms)),
        outside=outside,
    )


def record(n_z=2, n_x=2):
    """Features that leave their bounds, x that starts anywhere, g of any kind."""
    rng = np.random.default_rng(1)
    z = 1.5 * np.sin(np.linspace(0.0, 20.0, N)[:, None] + rng.uniform(0.0, 6.0, n_z))
    x = 5.0 + 0.02 * np.cumsum(rng.standard_normal((N, n_x)), axis=0)
    return z, x, rng.standard_normal((N, n_x))


def by_block(block: SampledBlock, *signals, q=None):
    """Outputs at all instants, (N, n_y), by the functions alone."""
    law = block.law
    assert law is not None
    v = np.hstack(signals)
    start = np.array([entry.start for entry in law.states])
    q = np.array([entry.start for entry in law.parameters]) if q is None else q
    state, put_in = ca.SX.sym("s", len(start)), ca.SX.sym("v", v.shape[1])
    results = [function(0.0, state, put_in, q) for function in (law.dynamics, law.output)]
    _, outputs = ca.Function("both", [state, put_in], results).mapaccum(len(v))(start, v.T)
    return np.array(outputs).T


def check(block, law, z, x, g, q=None):
    run = law.run(z, x, g)
    expected = np.hstack([run.f_theta, run.varsigma])
    n_x = x.shape[1]
    # The data move the estimate, or there is nothing to compare.
    assert np.ptp(run.varsigma, axis=0)[1:].min() > 0.01
    out = by_block(block, z, x, g, q=q)
    for part in (slice(n_x), slice(n_x, None)):
        scale = np.abs(expected[:, part]).max()
        np.testing.assert_allclose(out[:, part], expected[:, part], rtol=0.0, atol=AGREE * scale)


@pytest.mark.parametrize("between", ["hold", "average"])
@pytest.mark.parametrize("memory", [0.0, 0.7])
@pytest.mark.parametrize("leakage", [0.0, 0.3])
@pytest.mark.parametrize("constant", [False, True])
def test_block_is_the_law(between, memory, leakage, constant):
    law = AdaptiveChebyshev(
        random_model(), H, rate=8.0, memory=memory, leakage=leakage, adapt_constant=constant, g=between
    )
    block = adaptive_block(law)
    check(block, law, *record())
    law_functions = block.law
    assert law_functions is not None
    g_acts = law_functions.feedthrough[:2, 4:6].any()
    assert g_acts == (between == "average")


@pytest.mark.parametrize(
    ("model", "n_z", "n_x"),
    [
        (random_model(outside="extrapolate"), 2, 2),
        (random_model(n_z=1, n_x=3, n_d=2, degree_d=2), 1, 3),
        (random_model(n_z=3, n_x=1, degree_d=1), 3, 1),
    ],
    ids=["extrapolate", "two parameters", "three features"],
)
def test_other_models(model, n_z, n_x):
    law = AdaptiveChebyshev(model, H, rate=5.0, memory=0.5, leakage=0.1, g="average")
    check(adaptive_block(law), law, *record(n_z, n_x))


def test_parameters_are_those_of_the_law():
    base = AdaptiveChebyshev(random_model(), H, rate=1.0, bandwidth=10.0, leakage=0.0, memory=1.0)
    block = adaptive_block(base)
    other = replace(base, rate=15.0, bandwidth=25.0, leakage=0.4, memory=0.2)
    assert block.law is not None
    assert [entry.name for entry in block.law.parameters] == ["rate", "bandwidth", "leakage", "memory"]
    check(block, other, *record(), q=np.array([15.0, 25.0, 0.4, 0.2]))
    held = by_block(block, *record(), q=np.array([0.0, 25.0, 0.0, 0.2]))[:, 2:]
    np.testing.assert_array_equal(held, np.broadcast_to(base.prior, held.shape))


def test_a_model_without_anything_to_adapt():
    law = AdaptiveChebyshev(random_model(degree_d=0), H)
    z, x, g = record()
    expected = law.run(z, x, g).f_theta
    np.testing.assert_allclose(by_block(adaptive_block(law), z, x, g)[:, :2], expected, rtol=0.0, atol=1e-13)


def drag_law(**options):
    v, d = (part.ravel() for part in np.meshgrid(np.linspace(-6.0, 6.0, 30), np.linspace(0.0, 1.0, 9)))
    model = Chebyshev(3, degree_d=1).fit(np.column_stack([v, d]), (-d * v - 0.02 * v**3)[:, None]).model
    return AdaptiveChebyshev(model, H, rate=20.0, **options)


def drag_loop(law):
    """A body whose drag 0.7 v + 0.02 v^3 is unknown, held at a reference with the estimate taken off."""
    body = ct.nlsys(
        lambda t, x, u, p: [u[0] - 0.7 * x[0] - 0.02 * x[0] ** 3], None, states=["v"], inputs=["command"],
        outputs=["v"], name="body",
    )  # fmt: skip
    control = ct.ss(
        [], [], [], [[2.0, -2.0, -1.0]], inputs=["r", "v", "drag"], outputs=["command"], name="control"
    )
    block = adaptive_block(law, features=["v"], outputs=["drag"])
    return ct.interconnect(
        [body, control, block],
        connections=[["body.command", "control.command"], ["control.v", "body.v"], ["seer.v", "body.v"],
                     ["seer.x[0]", "body.v"], ["seer.g[0]", "control.command"], ["control.drag", "seer.drag"]],
        inplist=["control.r"], inputs=["r"], outlist=["body.v", "control.command", "seer"],
        outputs=["v", "g", "drag", "varsigma[0]", "varsigma[1]"], name="loop",
    )  # fmt: skip


@pytest.fixture(scope="module")
def flat_loop():
    return flatten(drag_loop(drag_law(g="hold")))


def test_in_a_loop(flat_loop):
    """With g held the command may use f_theta at once; in VM and C; and d is found."""
    times = H * np.arange(1200)
    r = 3.0 * np.sin(times) + np.sign(np.sin(0.7 * times))
    options = {"method": "rk4", "max_step": 0.005}
    in_vm, in_c = (
        simulate(flat_loop, times, r, [2.0], backend=backend, **options) for backend in ("vm", "c")
    )
    assert in_c.backend == "c"
    np.testing.assert_allclose(in_c.outputs, in_vm.outputs, rtol=0.0, atol=VM_IS_C * 10.0)
    law = drag_law(g="hold")
    d = law.model.d_from_varsigma(in_vm.outputs[3:].T[-1:])
    # The command changes with v inside a sample, the law takes it as held: first order in H.
    assert abs(d[0, 0] - 0.7) < 0.02


def test_signals_of_a_run_are_the_law_on_its_own_record():
    """Open loop, where the block's g is known at the instants from the record itself."""
    law = drag_law(g="average", memory=1.0)
    block = adaptive_block(law)
    body = ct.ss([[-0.7]], [[1.0]], [[1.0]], [[0.0]], inputs=["g"], outputs=["v"], name="body")
    diagram = ct.interconnect(
        [body, block], connections=[["seer.z[0]", "body.v"], ["seer.x[0]", "body.v"]],
        inplist=[["body.g", "seer.g[0]"]], inputs=["g"], outlist=["body.v", "seer"],
        outputs=["v", "f", "s0", "s1"], name="open",
    )  # fmt: skip
    times = H * np.arange(500)
    g = 2.0 * np.sin(times)
    response = simulate(diagram, times, g, [1.0])
    v = response.outputs[0][:, None]
    run = law.run(v, v, g[:, None])
    np.testing.assert_allclose(response.outputs[2:].T, run.varsigma, rtol=0.0, atol=1e-11)
    # Tuned without a new block, in a batch.
    batch = simulate_batch(diagram, times, g, [1.0], params={"seer.rate": [20.0, 2.0]})
    np.testing.assert_allclose(batch[0].outputs, response.outputs, rtol=0.0, atol=1e-9)
    slower = replace(law, rate=2.0).run(v, v, g[:, None]).varsigma
    np.testing.assert_allclose(batch[1].outputs[2:].T, slower, rtol=0.0, atol=1e-9)


def test_linear_at_the_start_is_the_model_with_its_prior():
    law = AdaptiveChebyshev(random_model(), H)
    z = np.array([0.3, -0.2])
    slope = adaptive_block(law).linearize(u0=[*z, 0.0, 0.0, 0.0, 0.0]).D[:2, :2]
    for j, step in enumerate(1e-6 * np.eye(2)):
        change = (law.model.regressor([z + step]) - law.model.regressor([z - step]))[0] @ law.prior / 2e-6
        np.testing.assert_allclose(slope[:, j], change, atol=1e-8)


def test_a_copy_runs_alike():
    block = adaptive_block(AdaptiveChebyshev(random_model(), H))
    twin = block.copy("twin")
    assert isinstance(twin, SampledBlock)
    np.testing.assert_array_equal(by_block(twin, *record()), by_block(block, *record()))


@pytest.mark.parametrize(
    ("act", "error", "words"),
    [
        (lambda: adaptive_block(random_model()), TypeError, "expected an AdaptiveChebyshev, got Chebyshev"),
        (
            lambda: adaptive_block(AdaptiveChebyshev(random_model(), H), features=["v"]),
            ValueError,
            "features: expected 2 labels, got 1",
        ),
        (
            lambda: adaptive_block(AdaptiveChebyshev(random_model(), H), outputs=["f"]),
            ValueError,
            "outputs: expected 2 labels, got 1",
        ),
        (
            lambda: adaptive_block(AdaptiveChebyshev(random_model(n_z=1, n_d=2, degree_d=4), H)),
            ValueError,
            "at most 16 entries, got 25",
        ),
    ],
)
def test_bad_input(act, error, words):
    with pytest.raises(error, match=words):
        act()
