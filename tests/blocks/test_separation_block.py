"""The parts of the residual as a block, against the filter over a recording: two routes, numpy's and CasADi's."""

import casadi as ca
import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.blocks import separation_block
from phyfilter_ctl.codegen import compile_model
from phyfilter_ctl.estimation import (
    ColouredForce,
    ModelScale,
    Payload,
    Regressor,
    SensorBias,
    SteadyForce,
    separate,
)

# A hundred steps of two forms of the measurement update, covariances of a condition below 1e6.
AGREE = 1e-9
# Of a deviation, in single precision.
SINGLE = 1e-2
H = 0.02
N = 120


def recording(M=2.0):
    rng = np.random.default_rng(4)
    t = H * np.arange(N)
    f_theta = np.stack([np.sin(3.0 * t), np.cos(t), 0.3 * t], axis=1)
    g = 2.0 * rng.standard_normal((N, 3)) + 5.0 * np.sin(np.outer(t, [2.0, 3.0, 1.0])) + [0.0, 0.0, 5.0]
    x = np.cumsum(0.3 * g * H, axis=0) + 0.01 * rng.standard_normal((N, 3))
    return pf.Recording.from_arrays(x=x, g=g, f_theta=f_theta, dt=H, inertia=M), rng.standard_normal(
        (N, 3, 2)
    )


def payload_parts(phi):
    return [Payload(1.0, mean=0.2, drift=0.01), SteadyForce(4.0, drift=0.1), ColouredForce(0.5, 5.0)]


def mixed_parts(phi):
    return [
        Regressor(phi, sd=[1.0, 2.0], drift=0.2, name="drag"),
        Regressor(phi[:, :, 0] ** 2, sd=1.0, between="hold", name="lost"),
        ModelScale(0.5),
        ColouredForce([0.7, 1.1, 0.4], bandwidth=30.0),
        SensorBias(0.03, bandwidth=0.5),
    ]


FULL = np.array([[2.0, 0.3, 0.0], [0.3, 1.0, 0.1], [0.0, 0.1, 1.5]])
CASES = {
    "payload": (payload_parts, 2.0, "hold"),
    "payload, g smooth": (payload_parts, 2.0, "average"),
    "full inertia, regressors": (mixed_parts, FULL, "average"),
    "regressors, g held": (mixed_parts, FULL, "hold"),
}


def made(case):
    parts_of, M, g = CASES[case]
    log, phi = recording(M)
    parts = parts_of(phi)
    fraction = {parts[0].name: 0.3}
    block = separation_block(parts, 3, dt=H, noise=0.02, inertia=M, g=g, fraction=fraction)
    regressors = [part.values.reshape(N, -1) for part in parts if isinstance(part, Regressor)]
    inputs = np.hstack([log.x, log.g, log.f_theta, *regressors])
    assert block.ninputs == inputs.shape[1]
    found = separate(log, parts, noise=0.02, g=g, causal=True, fraction=fraction)
    return block, inputs, found


def expected(found):
    """What the block puts out, but for the first instant: f_hat, estimates or NaN, their deviations or NaN."""
    parts = found.parts.values()
    return np.hstack([found.f_hat, *(part.course for part in parts), *(part.sd_course for part in parts)])


def compare(outputs, found):
    wanted = expected(found)
    p = (wanted.shape[1] - 3) // 2
    known = np.isfinite(wanted[:, 3 : 3 + p])
    assert 0 < known.sum() < known.size  # both kinds are there
    np.testing.assert_array_equal(outputs[:, 3 + 2 * p :] > 0.5, known)
    scale = np.nanmax(np.abs(wanted), axis=0, initial=1e-3)
    there = np.isfinite(wanted)
    there[0, :3] = False
    error = np.where(there, outputs[:, : 3 + 2 * p] - wanted, 0.0)
    assert np.max(np.abs(error) / scale) < AGREE


QUICK = ("payload", "full inertia, regressors")


@pytest.mark.parametrize(
    "case", [case if case in QUICK else pytest.param(case, marks=pytest.mark.slow) for case in CASES]
)
def test_block_is_the_filter_over_a_recording(case):
    block, inputs, found = made(case)
    law = block.law
    assert law is not None
    start = np.array([entry.start for entry in law.states])
    s, v = ca.SX.sym("s", len(start)), ca.SX.sym("v", inputs.shape[1])
    both = ca.Function("both", [s, v], [f(0.0, s, v, ca.DM(0, 1)) for f in (law.dynamics, law.output)])
    _, outputs = both.mapaccum(N)(start, inputs.T)
    compare(np.array(outputs).T, found)
    np.testing.assert_array_equal(np.array(outputs)[:3, 0], inputs[0, 6:9])  # f_theta at the first instant
    assert law.feedthrough[:3, 3:6].any() == (CASES[case][2] == "average")


@pytest.mark.slow
@pytest.mark.parametrize("case", QUICK)
def test_in_c(case):
    block, inputs, found = made(case)
    diagram = ct.interconnect(
        [block], inplist=[f"separation.{label}" for label in block.input_labels], inputs=block.input_labels,
        outlist=[f"separation.{label}" for label in block.output_labels], outputs=block.output_labels,
    )  # fmt: skip
    run = pf.simulate(diagram, H * np.arange(N), inputs.T, interpolation="hold", backend="c")
    assert run.backend == "c"
    compare(run.outputs.T, found)


@pytest.mark.slow
@pytest.mark.parametrize("moving", [3.0, 0.0])
def test_in_c_of_single_precision(moving):
    """A minute at 100 Hz on a circle and at hover: off by a small share of what is not known anyway."""
    rng, n, h = np.random.default_rng(0), 6000, 0.01
    t = h * np.arange(n)
    motion = moving * np.stack([np.sin(2.0 * t), np.cos(2.0 * t), 0.5 * np.sin(t)], axis=1)
    g = 3.5 * motion + np.array([0.0, 0.0, 0.5 * 9.81])
    gusts = np.cumsum(rng.standard_normal((n, 3)), axis=0) * 0.002
    x = np.cumsum((g + gusts - [0.0, 0.0, 0.5 * 9.81]) * h / 3.5, axis=0) + 0.01 * rng.standard_normal((n, 3))
    parts = [Payload(1.0), SteadyForce([5.0, 5.0, 0.25], name="mean"), ColouredForce(0.5, 10.0)]
    block = separation_block(parts, 3, dt=h, noise=0.03, inertia=3.0)
    diagram = ct.interconnect(
        [block], inplist=[f"separation.{label}" for label in block.input_labels], inputs=block.input_labels,
        outlist=[f"separation.{label}" for label in block.output_labels], outputs=block.output_labels,
    )  # fmt: skip
    flat, u = pf.flatten(diagram), np.hstack([x, g, np.zeros_like(x)])
    double, single = (
        np.asarray(compile_model(flat, real=real).simulate(t, u, interpolation="hold").outputs)
        for real in ("double", "float")
    )
    p = len(parts) * 3 - 2
    known = double[:, 3 + 2 * p :] > 0.5
    agree = known == (single[:, 3 + 2 * p :] > 0.5)
    assert np.mean(agree) > 0.999  # what is at the edge of known may be said a step apart
    estimate, sd = (slice(3, 3 + p), slice(3 + p, 3 + 2 * p))
    off = np.abs(single[:, estimate] - double[:, estimate]) / double[:, sd]
    assert np.max(off[known & agree]) < SINGLE
    np.testing.assert_allclose(single[1:, sd], double[1:, sd], rtol=SINGLE)
    # f_hat rests on all of them, of gusts of 0.5 N.
    assert np.max(np.abs(single[:, :3] - double[:, :3])) < SINGLE * 0.5


def test_what_is_refused():
    wind = ColouredForce(1.0, 2.0)
    for parts, options, words in [
        ([], {}, "at least one"),
        ([wind], {"noise": 0.0}, "noise: expected deviations above 0"),
        ([wind], {"dt": 0.0}, "dt"),
        ([wind], {"g": "linear"}, "'hold' or 'average'"),
        ([Payload(1.0)], {"inertia": FULL}, "constant inertia M that it is proportional to"),
        ([ColouredForce(1.0, 1.0 + i, name=f"w{i}") for i in range(8)], {}, "at most 24 states"),
    ]:
        with pytest.raises(ValueError, match=words):
            separation_block(parts, 3, **{"dt": 0.1, "noise": 0.1, **options})
