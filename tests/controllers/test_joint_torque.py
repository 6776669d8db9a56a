"""The filter of joint torques: against the filter on records, closed forms and loops over single robots."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phyfilter_ctl import PhyFilter, SampledPhyFilter, Sampling, stack
from phyfilter_ctl.controllers import JointTorqueFilter
from phyfilter_ctl.plants.legged import JointQuantities, JointSpacePrior

H = 0.005
# Two sums of the same numbers in another order.
ROUNDING = 1e-12
FILTERS = {
    "n1": PhyFilter([3.0]),
    "n2": PhyFilter.from_poles([-4.0 + 3.0j, -4.0 - 3.0j]),
    "n3": PhyFilter.from_poles([-2.0, -8.0, -20.0]),
    "band": PhyFilter([8.0, 6.0], [0.0, 6.0]),
    "type2": PhyFilter([16.0, 8.0], [16.0, 8.0]),
}
FREE = JointSpacePrior(bias="none", contact="omitted")


def random_inertia(rng, *shape):
    A = rng.standard_normal(shape)
    return A @ np.swapaxes(A, -1, -2) + shape[-1] * np.eye(shape[-1])


def march(law, qd, quantities, torque, gate=None):
    """f_hat over records with time in front."""
    state = law.start(qd[0], quantities(0))
    f_hat = [np.zeros_like(qd[0])]
    for k in range(1, len(qd)):
        state, now = law.step(state, qd[k], quantities(k), torque[k], gate=None if gate is None else gate[k])
        f_hat.append(now)
    return np.array(f_hat)


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("kind", ["full", "diagonal", "constant"])
def test_equals_the_sampled_filter(name, kind):
    rng = np.random.default_rng(3)
    N, n = 60, 4
    qd, torque, bias = rng.standard_normal((3, N, n))
    M = random_inertia(rng, N, n, n)
    inertia = {"full": M, "diagonal": np.diagonal(M, axis1=1, axis2=2), "constant": np.arange(1.0, n + 1)}[
        kind
    ]
    prior = JointSpacePrior(
        inertia=kind, contact="omitted", constant_inertia=inertia if kind == "constant" else None
    )
    law = JointTorqueFilter(FILTERS[name].sampled(H, g="average"), prior)
    ours = march(law, qd, lambda k: JointQuantities(qd[k], M=M[k], bias=bias[k]), torque)
    g = np.zeros((N, n))
    g[:-1] = torque[1:] - 0.5 * (bias[1:] + bias[:-1])  # held over the step that begins at each row
    theirs = FILTERS[name].sampled(H, g="hold").run(qd, g, inertia=inertia)
    np.testing.assert_allclose(ours, theirs, atol=ROUNDING * np.abs(theirs).max())


def test_one_filter_per_joint():
    rng = np.random.default_rng(4)
    qd, torque = rng.standard_normal((2, 40, 2))
    filters = [PhyFilter([2.0]), PhyFilter([9.0])]
    prior = JointSpacePrior("constant", "none", "omitted", constant_inertia=0.3)
    law = JointTorqueFilter(SampledPhyFilter(filters, Sampling(H, g="average")), prior)
    ours = march(law, qd, lambda k: JointQuantities(qd[k]), torque)
    for j, entry in enumerate(filters):
        alone = JointTorqueFilter(entry.sampled(H, g="average"), prior)
        single = march(alone, qd[:, [j]], lambda k, j=j: JointQuantities(qd[k, [j]]), torque[:, [j]])
        np.testing.assert_allclose(ours[:, [j]], single, atol=ROUNDING * np.abs(single).max())


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    name=st.sampled_from(sorted(FILTERS)),
    anti_windup=st.sampled_from(["clamp", "back_calculation", "residual", "none"]),
    gate=st.sampled_from(["scale", "hold"]),
    base=st.sampled_from([0, 6]),
    leak=st.sampled_from([0.0, 0.5]),
)
def test_many_robots_are_each_robot_alone_and_the_limit_holds(seed, name, anti_windup, gate, base, leak):
    rng = np.random.default_rng(seed)
    robots, n, N, limit = 3, 4, 12, 5.0
    shape = (N, 2, robots, n)
    qd, torque = rng.standard_normal((2, *shape))
    M = random_inertia(rng, N, 2, robots, n + base, n + base)
    bias, contact = rng.standard_normal((2, N, 2, robots, n + base))
    gates = rng.uniform(size=(N, 2, robots, n))
    prior = JointSpacePrior(base="floating" if base else "fixed")
    law = JointTorqueFilter(
        FILTERS[name].sampled(H, g="average", limit=limit),
        prior,
        anti_windup=anti_windup,
        gate=gate,
        leak=leak,
    )

    def at(k, *robot):
        parts = (part[(k, *robot)] for part in (qd, M, bias, contact))
        return JointQuantities(*parts)

    together = march(law, qd, at, torque, gates)
    assert np.abs(together).max() <= limit
    for robot in np.ndindex(2, robots):
        index = (slice(None), *robot)
        alone = march(law, qd[index], lambda k, r=robot: at(k, *r), torque[index], gates[index])
        np.testing.assert_allclose(
            together[index], alone, atol=1e-9 * limit
        )  # BLAS sums batches in another order


def wheel(filter=FILTERS["n1"], limit=20.0, **options):
    prior = JointSpacePrior("constant", "none", "omitted", constant_inertia=1.0)
    return JointTorqueFilter(filter.sampled(H, g="average", limit=limit), prior, **options)


def respond(law, residual, gate=None):
    """f_hat for a residual torque (N,) on one wheel of 1 kg m^2: q' is its integral."""
    qd = np.concatenate([[0.0], np.cumsum(residual[1:]) * H])[:, None]
    zero = np.zeros((len(qd), 1))
    return march(law, qd, lambda k: JointQuantities(qd[k]), zero, gate)[:, 0]


@pytest.mark.parametrize("anti_windup", ["clamp", "residual"])
@pytest.mark.parametrize("name", ["n1", "n2", "n3", "type2", "band"])
def test_clamped_filter_leaves_the_limit_sooner(anti_windup, name):
    """50 N m for two seconds against a limit of 5, then none: the clamped filter is back below it first."""
    residual = np.where(np.arange(1200) < 400, 50.0, 0.0)
    loose = respond(wheel(FILTERS[name], limit=5.0, anti_windup="none"), residual)
    tight = respond(wheel(FILTERS[name], limit=5.0, anti_windup=anti_windup), residual)
    assert np.abs(tight).max() <= 5.0
    after = np.abs(tight[401:]).sum(), np.abs(loose[401:]).sum()
    assert after[0] < 0.6 * after[1]


def test_clamped_first_order_is_the_clipped_recursion():
    """w_k = clip(w + (1 - e^-ah)(u - w)) by hand."""
    residual = 40.0 * np.sin(0.02 * np.arange(500))
    expected, w = [0.0], 0.0
    for u in residual[1:]:
        w = float(np.clip(w - np.expm1(-3.0 * H) * (u - w), -6.0, 6.0))
        expected.append(w)
    np.testing.assert_allclose(respond(wheel(limit=6.0), residual), expected, atol=ROUNDING * 6.0)


def test_back_calculation_lies_between_clamped_and_free():
    residual = np.where(np.arange(600) < 300, 50.0, 0.0)
    areas = [
        respond(wheel(limit=5.0, anti_windup=kind, tracking_time=0.3), residual)[301:].sum()
        for kind in ("clamp", "back_calculation", "none")
    ]
    assert areas[0] < areas[1] < areas[2]


def test_band_pass_and_leak_forget_a_constant_torque():
    residual = np.full(4000, 2.0)
    assert respond(wheel(FILTERS["n1"]), residual)[-1] == pytest.approx(2.0)
    assert abs(respond(wheel(FILTERS["band"]), residual)[-1]) < 1e-6
    # a/(a + leak) of the constant is left, but for the sampling: a = 3, leak = 1.
    fade, gain = np.exp(-H), -np.expm1(-3.0 * H)
    expected = 2.0 * gain / (1.0 - fade * (1.0 - gain))
    assert respond(wheel(leak=1.0), residual)[-1] == pytest.approx(expected)
    assert expected == pytest.approx(2.0 * 3.0 / 4.0, rel=0.01)


@pytest.mark.parametrize(("kind", "kept"), [("hold", 1.0), ("scale", np.exp(-3.0 * H * 200))])
def test_closed_gate(kind, kept):
    """Closed after 200 samples for 200 more: held exactly, or dying out with the filter's own pole."""
    gate = (np.arange(401) <= 200).astype(float)[:, None]
    f_hat = respond(wheel(gate=kind), np.full(401, 2.0), gate)
    assert f_hat[400] == pytest.approx(kept * f_hat[200], rel=1e-10)
    np.testing.assert_allclose(f_hat[:201], respond(wheel(), np.full(201, 2.0)), rtol=0, atol=0)


def test_reset_touches_only_the_chosen_robots():
    rng = np.random.default_rng(8)
    qd, torque = rng.standard_normal((2, 30, 3, 2))
    M, bias = random_inertia(rng, 30, 3, 2, 2), rng.standard_normal((30, 3, 2))
    law = JointTorqueFilter(
        FILTERS["n2"].sampled(H, g="average", limit=20.0), JointSpacePrior(contact="omitted")
    )

    def at(k):
        return JointQuantities(qd[k], M=M[k], bias=bias[k])

    plain = state = law.start(qd[0], at(0))
    fresh = law.start(qd[10], at(10))
    for k in range(1, 30):
        plain, untouched = law.step(plain, qd[k], at(k), torque[k])
        state, f_hat = law.step(state, qd[k], at(k), torque[k])
        if k == 10:
            state = law.reset(state, [False, True, False], qd[k], at(k))
        elif k > 10:
            fresh, anew = law.step(fresh, qd[k], at(k), torque[k])
            np.testing.assert_array_equal(f_hat[[0, 2]], untouched[[0, 2]])
            np.testing.assert_allclose(f_hat[1], anew[1], rtol=ROUNDING)


ONE = FILTERS["n1"].sampled(H, g="average", limit=20.0)
GOOD = JointQuantities(np.zeros(2), M=np.eye(2), bias=np.zeros(2))


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: JointTorqueFilter(ONE, FREE, anti_windup="anti"), "anti_windup: expected one of"),
        (lambda: JointTorqueFilter(ONE, FREE, leak=-1.0), "leak: expected 0"),
        (lambda: JointTorqueFilter(FILTERS["n1"].sampled(H, delay=0.01), FREE), "expected none of delay"),
        (lambda: JointTorqueFilter(FILTERS["n1"].sampled(H, E=np.eye(2)), FREE), "expected none of E"),
        (
            lambda: JointTorqueFilter(SampledPhyFilter([FILTERS["n1"], FILTERS["n2"]], H), FREE),
            "one order for all joints",
        ),
        (lambda: JointTorqueFilter(stack([ONE] * 3), FREE).start(np.zeros(2)), "3 filters for 2 channels"),
        (
            lambda: JointTorqueFilter(FILTERS["n1"].sampled(H, limit=[1.0] * 3), FREE).start(np.zeros(2)),
            "3 bounds for 2",
        ),
        (lambda: JointTorqueFilter(ONE, FREE).start([np.nan, 0.0]), "finite joint velocities"),
    ],
)
def test_wrong_input_says_so(build, words):
    with pytest.raises(ValueError, match=words):
        build()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"qd": np.zeros(3)}, "expected qd and torque of shape"),
        ({"torque": np.zeros(3)}, "expected qd and torque of shape"),
        ({"torque": np.array([0.0, np.inf])}, "residual of joint 1 is not finite"),
        ({"gate": [2.0, 0.0]}, r"gate: expected numbers in \[0, 1\]"),
        ({"gate": [1.0, 1.0, 1.0]}, "does not broadcast"),
        ({"quantities": JointQuantities(np.zeros(3), M=np.eye(3))}, "quantities: qd of shape"),
    ],
)
def test_wrong_samples_say_so(arguments, words):
    law = JointTorqueFilter(ONE, FREE)
    given = {"qd": np.zeros(2), "quantities": GOOD, "torque": np.zeros(2), **arguments}
    with pytest.raises(ValueError, match=words):
        law.step(
            law.start(np.zeros(2)), given.pop("qd"), given.pop("quantities"), given.pop("torque"), **given
        )
