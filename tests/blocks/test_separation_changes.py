"""Sudden changes noticed by the block, against `Separation.changes` over the recording, and the filter that goes on."""

import casadi as ca
import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.blocks import separation_block
from phyfilter_ctl.estimation import ColouredForce, Payload, SteadyForce, separate
from phyfilter_ctl.estimation.separation.changes import Schedule

# Two forms of the measurement update over a few hundred steps.
AGREE = 1e-9
H, N, WITHIN = 0.02, 160, 0.12
PARTS = [Payload(1.0, gravity=[0.0, 9.81]), SteadyForce(3.0), ColouredForce(0.5, bandwidth=5.0)]
OPTIONS = {"dt": H, "noise": 0.03, "inertia": 3.0, "within": WITHIN}


def recording(drop):
    """A body in two axes, pushed about, that loses 0.6 kg at the sample ``drop``."""
    rng = np.random.default_rng(5)
    g = 2.0 * rng.standard_normal((N, 2)) + [0.0, 6.0]
    whole = np.where(np.arange(N - 1) < drop, 3.6, 3.0)[:, None]
    slope = (g[:-1] - (whole - 3.0) * [0.0, 9.81]) / whole
    v = np.vstack([np.zeros(2), np.cumsum(H * slope, axis=0)])
    return pf.Recording.from_arrays(x=v + 0.01 * rng.standard_normal((N, 2)), g=g, dt=H, inertia=3.0)


def run(block, log):
    law = block.law
    start = np.array([entry.start for entry in law.states])
    s, v = ca.SX.sym("s", len(start)), ca.SX.sym("v", block.ninputs)
    both = ca.Function("both", [s, v], [f(0.0, s, v, ca.DM(0, 1)) for f in (law.dynamics, law.output)])
    _, outputs = both.mapaccum(log.n)(start, np.hstack([log.x, log.g, 0.0 * log.x]).T)
    return dict(zip(block.output_labels, np.array(outputs), strict=True))


def compare(outputs, changes, part):
    """The last jumps are tested by the block at their first ages, by the recording not at all."""
    ages = Schedule.of(H, 1, false_alarms=1.0, within=WITHIN).ages
    whole = slice(0, N - ages[-1])
    wanted = changes.statistic[whole]
    assert wanted.max() > changes.threshold
    np.testing.assert_allclose(outputs["statistic"][whole], wanted, rtol=0.0, atol=AGREE * wanted.max())
    at = np.flatnonzero(outputs["alarm"][whole])
    assert 0 < len(at) == np.sum(changes.alarms < H * (N - ages[-1]))
    np.testing.assert_array_equal(H * at, changes.alarms[: len(at)])
    np.testing.assert_allclose(H * at - outputs["age"][at], changes.onsets[: len(at)], rtol=0.0, atol=AGREE)
    jumps = np.stack([row for label, row in outputs.items() if label.startswith(f"jump_{part}")], axis=1)
    np.testing.assert_allclose(jumps[at], changes.jumps[: len(at)], rtol=0.0, atol=AGREE)


@pytest.mark.parametrize("part", ["payload", pytest.param("steady", marks=pytest.mark.slow)])
def test_block_tests_as_over_a_recording(part):
    log = recording(100)
    block = separation_block(PARTS, 2, watch=part, restart=False, **OPTIONS)
    changes = separate(log, PARTS, noise=0.03, causal=True).changes(part, within=WITHIN)
    compare(run(block, log), changes, part)


def test_restarts_as_the_filter_that_knew_when_but_not_how_much():
    """With the prior of the payload added to the covariance where the jump began, and all samples since taken again."""
    log = recording(100)
    found = separate(log, PARTS, noise=0.03, causal=True)
    outputs = run(separation_block(PARTS, 2, watch="payload", **OPTIONS), log)
    end = int(np.flatnonzero(outputs["alarm"])[0])
    begin = end - round(outputs["age"][end] / H)
    ends = found._ends
    course, working = ends.run.course, ends.working
    R = np.eye(2) * 0.01**2
    Hm = np.hstack([np.eye(2), working.structure.measured])
    D = np.zeros((len(course.mean[0]), 1))
    physical = working.physical(course.mean[begin, 2:], course.covariance[begin, 2:, 2:])
    D[2:, 0] = np.linalg.inv(physical[2])[:, 0]
    apart, P = np.zeros(len(D)), course.covariance[begin] + D @ D.T  # prior deviation of 1 kg
    for k in range(begin, end):
        F, K = ends.run.F[k], ends.run.gain[k]
        foretold = np.linalg.solve(np.eye(len(D)) - K @ Hm, course.covariance[k + 1])
        Q = foretold - F @ course.covariance[k] @ F.T
        P = F @ P @ F.T + Q
        gain = P @ Hm.T @ np.linalg.inv(Hm @ P @ Hm.T + R)
        innovation = ends.run.innovation[k]
        apart = F @ apart
        apart = apart + gain @ (innovation - Hm @ apart) - K @ innovation
        P = P - gain @ Hm @ P
    mean, covariance, _ = working.physical(course.mean[end, 2:] + apart[2:], P[2:, 2:])
    assert abs(outputs["payload"][end] - found.parts["payload"].course[end, 0]) > 0.1
    assert outputs["payload"][end] == pytest.approx(
        mean[0], abs=1e-8
    )  # P is solved for, at a condition of 1e6
    assert outputs["sd_payload"][end] == pytest.approx(np.sqrt(covariance[0, 0]), abs=1e-8)
    # And from then on it is right sooner than the filter that follows.
    assert abs(outputs["payload"][-1]) < 0.25 * abs(found.parts["payload"].course[-1, 0])


@pytest.mark.slow
def test_in_c():
    log = recording(100)
    block = separation_block(PARTS, 2, watch="payload", **OPTIONS)
    diagram = ct.interconnect(
        [block], inplist=[f"separation.{label}" for label in block.input_labels], inputs=block.input_labels,
        outlist=[f"separation.{label}" for label in block.output_labels], outputs=block.output_labels,
    )  # fmt: skip
    inputs = np.hstack([log.x, log.g, 0.0 * log.x]).T
    compiled = pf.simulate(diagram, H * np.arange(N), inputs, interpolation="hold", backend="c")
    assert compiled.backend == "c"
    for label, row in run(block, log).items():
        got = np.asarray(compiled.outputs)[block.output_labels.index(label)]
        np.testing.assert_allclose(got, row, rtol=0.0, atol=AGREE * max(1.0, np.abs(row).max()))


def test_what_is_refused():
    for options, words in [
        ({"watch": "wind"}, "watch: expected one of payload, steady"),
        ({"watch": "payload", "false_alarms": 0.0}, "false_alarms"),
        ({"watch": "payload", "within": -1.0}, "within"),
    ]:
        with pytest.raises(ValueError, match=words):
            separation_block(PARTS[:2], 2, **(OPTIONS | options))
