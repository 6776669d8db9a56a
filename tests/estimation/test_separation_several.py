"""Several recordings with parts in common, against dense Gaussian conditioning of all of them at once."""

import numpy as np
import pytest
from test_separation import DENSE, S, hover_then_climb, lifted

import phyfilter_ctl as pf
from phyfilter_ctl.estimation import ColouredForce, Payload, Regressor, SensorBias, SteadyForce, separate

# Smoothers of the same data in another order: 1e-9 of estimates of order 1.
SAME = 1e-8


def two(n=(25, 31)):
    """Of one channel each: a shared regressor and a shared bias of x, gusts and a steady force of their own."""
    rng, logs, parts, made = np.random.default_rng(8), [], [], []
    for count in n:
        times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.02, 0.1, count - 1))])
        phi = rng.standard_normal((count, 1))
        x = 0.2 * np.cumsum(rng.standard_normal((count, 1)), axis=0)
        logs.append(pf.Recording(times, x))
        own = [
            Regressor(phi, sd=2.0, name="drag"),
            SteadyForce(1.5),
            ColouredForce(0.7, 3.0),
            SensorBias(0.1),
        ]
        parts.append(own)
        loads = np.stack(
            [0.5 * (phi[1:, 0] + phi[:-1, 0]), *np.array([[1.0, 1.0, 0.0]] * (count - 1)).T], axis=-1
        )
        rates, densities = [0.0, 0.0, 3.0, 0.0], [0.0, 0.0, 6.0 * 0.49, 0.0]
        sds, measured = np.array([2.0, 1.5, 0.7, 0.1]), np.array([[0.0, 0.0, 0.0, 1.0]])
        made.append(
            lifted(times, np.eye(1), loads[:, None], rates, densities, sds, measured, S**2 * np.eye(1))
        )
    return logs, parts, made


@pytest.mark.filterwarnings("ignore:the innovations' mean square")  # any numbers do
@pytest.mark.parametrize("causal", [False, True])
def test_estimates_are_gaussian_conditioning_of_all(causal):
    logs, parts, ((seen, of_c, chance), (other, of_other, more)) = two()
    found = separate(logs, parts, noise=S, causal=causal, fraction=0.999999, shared=["drag", "bias"])
    # Sources of both side by side, those of the second's shared scalars moved onto the first's.
    count, both = len(chance), len(chance) + len(more)
    joint = np.zeros((both, both))
    joint[:count, :count], joint[count:, count:] = chance, more
    moved = np.eye(both)
    for i in (0, 3):
        moved[count + i, count + i], moved[count + i, i] = 0.0, 1.0
    rows = np.zeros((len(seen) + len(other), both))
    rows[: len(seen), :count], rows[len(seen) :, count:] = seen, other
    rows = rows @ moved
    y = np.concatenate([(log.x[1:] - log.x[0]).ravel() for log in logs])
    compared = 0
    for k, (log, one) in enumerate(zip(logs, (of_c, of_other), strict=True)):
        course = np.hstack([part.course for part in found[k].parts.values()])
        sd = np.hstack([part.sd_course for part in found[k].parts.values()])
        for at in (5, log.n - 1):
            wanted = np.zeros((4, both))
            wanted[:, k * count : k * count + one.shape[-1]] = one[at]
            wanted = wanted @ moved
            end = (k * len(seen) + at) if causal else len(y)
            V, cross = rows[:end] @ joint @ rows[:end].T, wanted @ joint @ rows[:end].T
            mean = cross @ np.linalg.solve(V, y[:end])
            left = np.diag(wanted @ joint @ wanted.T - cross @ np.linalg.solve(V, cross.T))
            there = np.isfinite(course[at])
            compared += there.sum()
            np.testing.assert_allclose(
                course[at][there], mean[there], rtol=0.0, atol=DENSE * np.abs(mean).max()
            )
            np.testing.assert_allclose(sd[at][there], np.sqrt(left)[there], rtol=DENSE * 10)
    assert compared >= 9
    V = rows @ joint @ rows.T
    whole = np.linalg.slogdet(V)[1] + y @ np.linalg.solve(V, y) + len(y) * np.log(2.0 * np.pi)
    assert sum(one.log_likelihood for one in found) == pytest.approx(-0.5 * whole, rel=DENSE)


@pytest.mark.filterwarnings("ignore:the innovations' mean square")  # any numbers do
def test_the_order_does_not_matter():
    logs, parts, _ = two((25, 31))
    first = separate(logs, parts, noise=S)
    second = separate(logs[::-1], parts[::-1], noise=S)[::-1]
    for one, other in zip(first, second, strict=True):
        np.testing.assert_allclose(one.f_hat, other.f_hat, rtol=0.0, atol=SAME)
        np.testing.assert_allclose(one.f_hat_sd, other.f_hat_sd, rtol=SAME)


def test_a_payload_is_one_and_winds_are_not():
    rng = np.random.default_rng(3)
    logs = [hover_then_climb(rng, 3.0, n=120)[0] for _ in range(2)]
    parts = [Payload(1.0), SteadyForce([3.0, 3.0, 0.3], name="mean"), ColouredForce(0.5, 5.0)]
    alone = [separate(log, parts, noise=S) for log in logs]
    found = separate(logs, parts, noise=S)
    values = np.array([one.parts["payload"].value for one in found])
    np.testing.assert_allclose(values[0], values[1], rtol=1e-6)  # eta is turned back at the end
    assert found[0].parts["payload"].sd_value < 0.85 * min(one.parts["payload"].sd_value for one in alone)
    assert abs(values[0] - 0.5) < 3.0 * found[0].parts["payload"].sd_value
    means = [one.parts["mean"].value[0] for one in found]
    assert abs(means[0] - means[1]) > 1e-3
    own = separate(logs, parts, noise=S, shared=())
    np.testing.assert_allclose(own[1].f_hat, alone[1].f_hat, rtol=0.0, atol=SAME)


def test_what_is_refused():
    log = pf.Recording.from_arrays(x=np.zeros((30, 3)), dt=0.1, inertia=2.0)
    heavier = pf.Recording.from_arrays(x=log.x, dt=0.1, inertia=3.0)
    wind = ColouredForce(1.0, 2.0)
    for logs, parts, options, words in [
        ([], [wind], {}, "at least one, got none"),
        ([log, log], [[wind]], {}, "one sequence for each of 2 recordings, got 1"),
        ([log, log], [[wind], [ColouredForce(2.0, 2.0)]], {}, "differ in the values of regressors alone"),
        ([log, log], [wind], {"shared": ["wind"]}, "constant parts, got wind"),
        ([log, log], [wind], {"shared": ["gust"]}, "names of wind, got gust"),
        ([log, heavier], [Payload(1.0)], {}, "one inertia in all"),
    ]:
        with pytest.raises(ValueError, match=words):
            separate(logs, parts, **{"noise": 0.1, **options})
    with pytest.raises(TypeError, match="Recording or several, got str"):
        separate(["log"], [wind], noise=0.1)
