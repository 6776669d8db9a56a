"""Cost and gradient of the learning problem against complex steps through the plain recursion.

The other route shares no code: companion matrices instead of chains, scipy's matrix exponential in complex arithmetic,
a loop over the samples.
"""

import numpy as np
import pytest
from scipy.linalg import expm

from phyfilter_ctl import PhyFilter, Recording
from phyfilter_ctl.design.learning.correlation import Correlations, Stretch
from phyfilter_ctl.design.learning.residuals import flights_of
from phyfilter_ctl.design.learning.samples import Samples
from phyfilter_ctl.design.learning.sensitivity import coefficient_gradient

# Relative to the norm of the gradient in scaled coefficients; both routes round at about 1e-13 of it.
GRADIENT = 1e-9
# A cost is a difference of sums: their rounding, times how much larger they are than the cost.
COST = 1e-11
STEP = 1e-30

H, N = 0.01, 150
POLES = {
    "apart": [-3.0, -8.0 + 6.0j, -8.0 - 6.0j, -20.0, -45.0, -90.0],
    "repeated": [-20.0] * 6,
    "weakly damped": [-1.0 + 9.0j, -1.0 - 9.0j, -3.0 + 15.0j, -3.0 - 15.0j, -30.0, -60.0],
}


def record():
    rng = np.random.default_rng(3)
    x = np.cumsum(rng.standard_normal((N, 2)), axis=0)
    g, f_theta, label = rng.standard_normal((3, N, 2))
    return Recording.from_arrays(x=x, dt=H, g=g, f_theta=f_theta, label=label)


def plain_cost(log, a, b, w, method):
    """Mean square of label - f_hat for scaled coefficients a, b (p, n) complex, all p at once, steps one by one."""
    p, n = a.shape
    M = np.zeros((p, n + 1, n + 1), dtype=complex)
    M[:, np.arange(n - 1), np.arange(1, n)] = w
    M[:, n - 1, :n] = -w * a
    M[:, n - 1, n] = w  # y = b z: z_i = s^i w^(n-i) / D u
    if method == "exact":
        increment = np.stack([expm(entry * H) - np.eye(n + 1) for entry in M])
    elif method == "euler":
        increment = M * H
    else:
        increment = np.stack([np.linalg.solve(np.eye(n + 1) - entry * H / 2, entry * H) for entry in M])
    E, B = increment[:, :n, :n] + np.eye(n), increment[:, :n, n]
    z = np.zeros((p, n, 2), dtype=complex)
    total = np.zeros(p, dtype=complex)
    for k in range(1, N):
        residual = (log.x[k] - log.x[k - 1]) / H - log.g[k - 1] - 0.5 * (log.f_theta[k - 1] + log.f_theta[k])
        z = E @ z + B[:, :, None] * residual
        miss = log.label[k] - log.f_theta[k] - np.einsum("pn,pnc->pc", b, z)
        total += (miss**2).sum(axis=1)
    return total / ((N - 1) * 2)


def complex_step(log, filter, form, method):
    n = filter.order
    w = filter.a[0] ** (1.0 / n)
    powers = w ** np.arange(n, 0, -1)
    nudge = 1j * STEP * np.eye(2 * n)
    a = filter.a / powers + nudge[:, :n]
    b = filter.b / powers + nudge[:, n:]
    if form == "lowpass":
        b[:n] = 0.0
        b[:, 0] = a[:, 0]
        a, b = a[:n], b[:n]
    cost = plain_cost(log, a, b, w, method)
    return cost[0].real, cost.imag / STEP


def filters(n, kind, method):
    poles = np.array(POLES[kind][:n])
    if poles[-1].imag > 0.0:  # the first of a pair
        poles[-1] = poles[-1].real
    lowpass = PhyFilter.from_poles(poles)
    rng = np.random.default_rng(n)
    return {"lowpass": lowpass, "general": PhyFilter.from_poles(poles, lowpass.a * rng.uniform(0.2, 1.5, n))}


@pytest.mark.parametrize("kind", POLES)
@pytest.mark.parametrize("method", ["exact", "euler", "tustin"])
@pytest.mark.parametrize("n", range(1, 7))
def test_gradient_is_that_of_the_sampled_filter(n, method, kind):
    log = record()
    (flight,) = flights_of([log])
    sources = [Correlations.of([Stretch(flight, 0, N - 1, 1.0)], method), Samples(flight, method)]
    for form, filter in filters(n, kind, method).items():
        cost, gradient = complex_step(log, filter, form, method)
        for data in sources:
            ours, by_a, by_b = coefficient_gradient(data, filter, form)
            found = by_a if form == "lowpass" else np.concatenate([by_a, by_b])
            assert ours == pytest.approx(cost, rel=COST)
            assert np.linalg.norm(found - gradient) <= GRADIENT * np.linalg.norm(gradient)


def test_other_scale_is_the_chain_rule():
    (flight,) = flights_of([record()])
    data = Samples(flight, "exact")
    filter = PhyFilter([900.0, 40.0], [800.0, 10.0])
    _, a_one, b_one = coefficient_gradient(data, filter, "general", scale=1.0)
    _, a_ten, b_ten = coefficient_gradient(data, filter, "general", scale=10.0)
    np.testing.assert_allclose(a_ten, a_one * [100.0, 10.0], rtol=GRADIENT)
    np.testing.assert_allclose(b_ten, b_one * [100.0, 10.0], rtol=GRADIENT)


def test_unstable_sampling_is_named():
    (flight,) = flights_of([record()])
    with pytest.raises(ValueError, match="not stable"):
        coefficient_gradient(Samples(flight, "euler"), PhyFilter([300.0]), "lowpass")
