"""A filter by itself as a C model: samples, tasks and continuous states, with coefficients set while it runs."""

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, phyfilter_block, stack
from phyfilter_ctl.codegen.compiled import compile_model
from phyfilter_ctl.codegen.filter_cmodel import filter_model

H = 0.002
# Sums of a few dozen terms in another order.
AGREE = 2e-14
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror", "-O1"]

SECOND = PhyFilter([400.0, 40.0])
GENERAL = PhyFilter([1780.0, 289.0, 30.0], [1780.0, 200.0, 12.0])
FULL = np.array([[1.2, 0.1, 0.0], [0.1, 0.9, -0.2], [0.0, -0.2, 2.0]])


def signals(count=60, seed=0):
    rng = np.random.default_rng(seed)
    return 2.0 * H * np.cumsum(rng.standard_normal((count, 3)), axis=0), *rng.standard_normal((2, count, 3))


def instance(model):
    return compile_model(model, flags=STRICT).instance()


def names(variables):
    return [variable.name for variable in variables]


@pytest.fixture(scope="module")
def continuous():
    return {
        "shared": filter_model(SECOND, 3, inertia=FULL),
        "each": filter_model([SECOND, PhyFilter([3.0]), GENERAL], 3, inertia=1.5),
    }


@pytest.mark.parametrize("g_rule", ["hold", "average"])
def test_one_sample_per_communication_step(g_rule):
    sampled = GENERAL.sampled(H, g=g_rule, limit=[3.0, 9.0, 9.0], g_limit=(-0.5, [0.3, 1.0, 2.0]))
    model = filter_model(sampled, 3, inertia="diagonal")
    assert names(model.inputs)[-3:] == ["M[0]", "M[1]", "M[2]"]
    assert names(model.parameters) == [
        *(f"{c}[{j}]" for c in "ab" for j in range(3)),
        *(f"{end}[{i}]" for end in ("limit", "g_low", "g_high") for i in range(3)),
    ]
    assert model.communication == H
    assert model.tasks == ()
    assert not model.depends.any()
    ours = instance(model)
    x, g, f_theta = signals()
    M = 1.0 + 0.1 * np.random.default_rng(1).standard_normal((60, 3))
    times = np.cumsum(np.random.default_rng(2).uniform(0.3 * H, 2.0 * H, 60))
    expected = sampled.run(x, g, f_theta, M, times)
    ours.u[:] = np.concatenate([x[0], g[0], f_theta[0], M[0]])
    np.testing.assert_array_equal(ours.outputs(times[0]), expected[0])  # before the start too
    assert ours.start(times[0]) == 0
    for k in range(60):
        if k:
            ours.u[:] = np.concatenate([x[k], g[k], f_theta[k], M[k]])
            assert ours._table.update(ours.address, times[k], times[k] - times[k - 1]) == 0
        np.testing.assert_allclose(ours.outputs(times[k]), expected[k], atol=AGREE * 9)
    assert ours.sampled_states().shape == (9,)


def test_on_its_own_grid():
    sampled = stack([entry.sampled(H) for entry in (SECOND, PhyFilter([3.0]), GENERAL)])
    model = filter_model(sampled, 3, rate="fixed", name="wing")
    assert model.tasks == (("wing", H),)
    assert names(model.sampled_states) == ["w[0,0]", "w[0,1]", "w[1,0]", "w[2,0]", "w[2,1]", "w[2,2]"]
    assert "b[2,1]" in names(model.parameters)
    ours = instance(model)
    x, g, f_theta = signals()
    expected = sampled.run(x, g, f_theta)
    assert ours.next() == 1e300
    for k in range(60):
        ours.u[:] = np.concatenate([x[k], g[k], f_theta[k]])
        if k == 0:
            assert ours.start(3.0) == 0
        else:
            assert ours.next() == 3.0 + k * H
            assert ours.sample(3.0 + k * H - 1e-4) == 0  # not due yet
            assert ours.sample(3.0 + k * H) == 0
        np.testing.assert_allclose(ours.outputs(0.0), expected[k], atol=AGREE * 9)


def test_coefficients_are_set_together_or_not_at_all():
    sampled = SECOND.sampled(H, limit=50.0)
    ours = instance(filter_model(sampled, 3, rate="fixed"))
    x, g, f_theta = signals()
    state = sampled.start(x[0], f_theta0=f_theta[0])
    for k in range(60):
        ours.u[:] = np.concatenate([x[k], g[k], f_theta[k]])
        if k == 20:
            ours.set_parameters({"a[0]": 900.0, "a[1]": 50.0})
            assert ours.p[2] == 900.0  # b[0] follows
            following = sampled.with_filter(PhyFilter([900.0, 50.0]))
            state, sampled = sampled.retune(state, following), following
        if k == 30:
            before = ours.memory.copy()
            for refused in (
                {"a[1]": -1.0},
                {"a[0]": float("nan")},
                {"b[1]": float("inf")},
                {"limit[2]": 0.0, "a[0]": 1.0},
            ):
                with pytest.raises(ValueError, match="refuses"):
                    ours.set_parameters(refused)
            np.testing.assert_array_equal(ours.memory, before)
        if k == 40:  # with b set it is the general form, and stays
            ours.set_parameters({"a[0]": 400.0, "a[1]": 40.0, "b[0]": 400.0, "b[1]": 10.0})
            following = sampled.with_filter(PhyFilter([400.0, 40.0], [400.0, 10.0]))
            state, sampled = sampled.retune(state, following), following
            ours.set_parameters({"a[0]": 500.0})
            assert ours.p.tolist()[:4] == [500.0, 40.0, 400.0, 10.0]
            following = sampled.with_filter(PhyFilter([500.0, 40.0], [400.0, 10.0]))
            state, sampled = sampled.retune(state, following), following
        if k == 0:
            assert ours.start(0.0) == 0
            continue
        assert ours.sample(k * H) == 0
        state, expected = sampled.step(state, x[k], g[k - 1], f_theta[k])
        np.testing.assert_allclose(ours.outputs(0.0), expected, atol=AGREE * 50)


@pytest.mark.slow
def test_what_is_not_finite_is_refused_or_held():
    x, g, f_theta = signals()
    for nonfinite in ("raise", "hold"):
        sampled = SECOND.sampled(H, nonfinite=nonfinite)
        ours = instance(filter_model(sampled, 3))
        for k in range(20):
            ours.u[:] = np.concatenate([x[k] if k != 10 else [np.nan, 0.0, 0.0], g[k], f_theta[k]])
            if k == 0:
                assert ours.start(0.0) == 0
                continue
            before = ours.outputs(0.0)
            code = ours._table.update(ours.address, k * H, H)
            assert code == (1 if nonfinite == "raise" and k == 10 else 0)
            if k == 10:
                wanted = before if nonfinite == "raise" else before + f_theta[10] - f_theta[9]
                np.testing.assert_allclose(ours.outputs(0.0), wanted, atol=AGREE)
        assert ours._table.update(ours.address, 1.0, 0.0) == 3
        assert ours._table.update(ours.address, 1.0, float("nan")) == 3


# -- continuous -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["shared", "each"])
def test_continuous_is_the_block(kind, continuous):
    """Derivatives, outputs and both derivative products against the block's matrices, counted from x(0)."""
    model = continuous[kind]
    filters, inertia = (
        (SECOND, FULL) if kind == "shared" else ([SECOND, PhyFilter([3.0]), GENERAL], 1.5 * np.eye(3))
    )
    block = phyfilter_block(filters, 3, inertia=inertia)
    assert names(model.states) == block.state_labels
    assert names(model.inputs) == block.input_labels
    ours = instance(model)
    rng = np.random.default_rng(3)
    u0, u, z = rng.standard_normal(9), rng.standard_normal(9), rng.standard_normal(block.nstates)
    ours.u[:] = u0
    np.testing.assert_allclose(ours.outputs(0.0), u0[6:], atol=1e-15)
    assert ours.start(0.0) == 0
    ours.u[:], ours.x[:] = u, z
    as_block = z + block.rest_state(u0[:3])
    size = np.abs(block.A).max() * 10
    np.testing.assert_allclose(ours.derivatives(0.0), block.A @ as_block + block.B @ u, atol=1e-14 * size)
    np.testing.assert_allclose(ours.outputs(0.0), block.C @ as_block + block.D @ u, atol=1e-14 * size)
    matrix = np.block([[block.A, block.B], [block.C, block.D]])
    seeds = rng.standard_normal(block.nstates + 9)
    dx, y = directional(ours, seeds[: block.nstates], seeds[block.nstates :])
    np.testing.assert_allclose(np.concatenate([dx, y]), matrix @ seeds, atol=1e-14 * size * 10)
    seeds = rng.standard_normal(block.nstates + 3)
    back = adjoint(ours, seeds[: block.nstates], seeds[block.nstates :])
    np.testing.assert_allclose(back, seeds @ matrix, atol=1e-14 * size * 10)
    fixed = filter_model(filters if kind == "shared" else tuple(filters), 3, inertia=inertia, tunable=False)
    np.testing.assert_array_equal(fixed.depends, np.abs(matrix) > 1e-12 * np.abs(matrix).max())
    assert np.all(model.depends >= fixed.depends)


def directional(ours, seed_x, seed_u):
    n_x, n_y = len(ours.x), 3
    dx, y, p = np.empty(n_x), np.empty(n_y), np.zeros(len(ours.p))
    pointers = [v.ctypes.data for v in (np.array(seed_x), np.array(seed_u), p, dx, y)]
    assert ours._table.directional(ours.address, 0.0, *pointers) == 0
    return dx, y


def adjoint(ours, seed_dx, seed_y):
    x, u, p = np.empty(len(ours.x)), np.empty(9), np.full(len(ours.p), np.nan)
    pointers = [v.ctypes.data for v in (np.array(seed_dx), np.array(seed_y), x, u, p)]
    assert ours._table.adjoint(ours.address, 0.0, *pointers) == 0
    assert not p.any()
    return np.concatenate([x, u])


@pytest.mark.slow
def test_continuous_runs_as_python_control_does():
    """0.3 s with x(0) far from 0: a bumpless start, then the same response."""
    compiled = compile_model(filter_model(GENERAL, 1), flags=STRICT)
    times = np.linspace(0.0, 0.3, 301)
    inputs = np.stack([7.0 + np.sin(20.0 * times), np.cos(9.0 * times), 0.5 * times], axis=1)
    run = compiled.simulate(times, inputs, method="adaptive", rtol=1e-11, atol=1e-12)
    assert run.success
    block = phyfilter_block(GENERAL, 1)
    expected = ct.forced_response(block, times, inputs.T, X0=block.rest_state([7.0]))
    assert run.outputs[0, 0] == 0.0
    # forced_response is exact for inputs on straight lines, which is what the compiled run integrates.
    np.testing.assert_allclose(run.outputs[:, 0], np.ravel(expected.outputs), atol=1e-8)


def test_continuous_retuning_does_not_jump(continuous):
    ours = instance(continuous["each"])
    rng = np.random.default_rng(4)
    ours.u[:] = rng.standard_normal(9)
    assert ours.start(0.0) == 0
    ours.u[:], ours.x[:] = rng.standard_normal(9), rng.standard_normal(6)
    before, z = ours.outputs(0.0), ours.x.copy()
    ours.set_parameters({"a[0,0]": 700.0, "a[1,0]": 11.0, "a[2,2]": 35.0, "b[2,2]": 1.0})
    assert np.any(ours.x != z)
    np.testing.assert_allclose(ours.outputs(0.0), before, rtol=1e-13)
    assert ours.p[6:8].tolist() == [700.0, 0.0]
    memory = ours.memory.copy()
    with pytest.raises(ValueError, match="Hurwitz"):
        ours.set_parameters({"a[2,0]": 1e9})
    np.testing.assert_array_equal(ours.memory, memory)


def test_continuous_rest_stays_rest(continuous):
    """An equilibrium of the old coefficients is one of the new: no state moves."""
    ours = instance(continuous["each"])
    ours.u[:] = [1.0, -2.0, 0.5, *([-5.0] * 3), *([0.0] * 3)]
    assert ours.start(0.0) == 0
    ours.x[:] = 5.0 * np.concatenate([entry.sections[1] for entry in (SECOND, PhyFilter([3.0]), GENERAL)])
    for changed in (
        {"a[0,0]": 400.0, "a[0,1]": 8.0, "a[1,0]": 11.0, "a[2,2]": 35.0, "b[2,2]": 1.0},
        {"a[0,1]": 900.0, "a[2,2]": 28.0, "b[2,1]": -40.0},
    ):
        ours.set_parameters(changed)
        np.testing.assert_allclose(ours.outputs(0.0), 5.0, rtol=1e-13)
        # Each derivative is a sum of terms as large as the fastest pole, 900 rad/s, times the state.
        np.testing.assert_allclose(ours.derivatives(0.0), 0.0, atol=1e-13 * 900.0 * 5.0)


def test_names_and_units():
    known = {"channels": ["north", "east"], "units": {"x": "m/s", "g": "N", "f": "N"}, "inertia": 1.2}
    model = filter_model(SECOND.sampled(H, limit=np.inf, **known), 2)
    assert model.inputs[1].description == "measured state of east"
    assert [v.unit for v in (model.inputs[0], model.inputs[2], model.outputs[0], model.parameters[0])] == [
        "m/s",
        "N",
        "N",
        "(rad/s)^2",
    ]
    assert np.isfinite(model.parameters[-1].start)
    assert "400/(s**2 + 40*s + 400)" in model.formula


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"inertia": "full"}, "sampled"),
        ({"inertia": np.ones(3)}, "shape"),
        ({"channels": 0}, "channel"),
        ({"name": "3d"}, "identifier"),
        ({"filter": [SECOND] * 3}, "per channel"),
        ({"names": ["x"]}, "names"),
        ({"filter": SECOND.sampled(H), "rate": "sometimes"}, "rate"),
        ({"filter": PhyFilter.from_poles([-1.0] * 13).sampled(H)}, "13"),
    ],
)
def test_refused(settings, message):
    arguments = {"filter": SECOND, "channels": 2} | settings
    with pytest.raises(ValueError, match=message):
        filter_model(arguments.pop("filter"), arguments.pop("channels"), **arguments)
