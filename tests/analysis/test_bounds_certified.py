"""Certificates against 60-digit arithmetic: partial fractions over the roots of D, changes of sign by bisection."""

from itertools import pairwise

import mpmath
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import error_bound
from phyfilter_ctl.analysis.bounds import kernels

DIGITS = 60


def exact_area(f, k):
    """||(1 - F)/s^k||_1, k >= 1, of the coefficients as they stand."""
    with mpmath.workdps(DIGITS):
        a = [mpmath.mpf(float(v)) for v in f.a] + [mpmath.mpf(1)]
        c = [mpmath.mpf(float(v)) for v in f.error_numerator[k:]]
        roots = mpmath.polyroots(a[::-1], maxsteps=2000, extraprec=2000)
        slope = [mpmath.fprod(p - q for j, q in enumerate(roots) if j != i) for i, p in enumerate(roots)]
        weights = [mpmath.polyval(c[::-1], p) / d for p, d in zip(roots, slope, strict=True)]

        def kernel(t):
            return mpmath.fsum(mpmath.re(w * mpmath.exp(p * t)) for w, p in zip(weights, roots, strict=True))

        def area(t):
            return mpmath.fsum(
                mpmath.re(w / p * mpmath.exp(p * t)) for w, p in zip(weights, roots, strict=True)
            )

        grid = {0.0}
        for p in np.array([complex(p) for p in roots]):
            dense = max(60, int(120.0 * abs(p.imag / p.real)))
            grid |= set(np.linspace(0.0, 60.0 / abs(p.real), min(dense, 4000)).tolist())
        times = [mpmath.mpf(t) for t in sorted(grid)]
        values = [kernel(t) for t in times]
        switches = [times[0]]
        for t0, t1, v0, v1 in zip(times, times[1:], values, values[1:], strict=False):
            if v0 * v1 < 0:
                switches.append(
                    mpmath.findroot(kernel, (t0, t1), solver="anderson", tol=mpmath.mpf(10) ** -80)
                )
        marks = [area(t) for t in switches] + [mpmath.mpf(0)]
        return mpmath.fsum(abs(b - a) for a, b in pairwise(marks))


def encloses(f, k):
    certificate = error_bound(f, {k: 1.0}).certificate
    exact = exact_area(f, k)
    assert mpmath.mpf(certificate.lower) <= exact <= mpmath.mpf(certificate.upper)
    assert certificate.gap <= 1e-6
    return certificate


def some_filter(rng):
    order, spread = int(rng.integers(1, 6)), rng.uniform(0.0, 4.0)
    poles = []
    while len(poles) < order:
        size = 10.0 ** rng.uniform(0.0, spread)
        if order - len(poles) > 1 and rng.random() < 0.5:
            angle = rng.uniform(0.1, 1.45)
            poles += [size * complex(-np.cos(angle), s * np.sin(angle)) for s in (1.0, -1.0)]
        else:
            poles.append(complex(-size))
    kind = int(rng.integers(1, order + 1))
    return pf.place_poles(poles, type=kind), int(rng.integers(1, kind + 1))


@pytest.mark.parametrize(
    ("poles", "k"),
    [
        ([-20.0, -20.001, -20.002], 1),
        ([-1.0, -1e4], 1),
        ([-0.5, -3 + 4j, -3 - 4j, -5e3], 2),
        ([-1e-3, -1.0, -1e3], 3),
        ([-1.0, -1.0 - 1e-9, -2.0], 1),
    ],
)
def test_the_exact_gain_is_enclosed(poles, k):
    encloses(pf.place_poles(poles, type=max(k, 1)), k)


@pytest.mark.slow
def test_random_gains_are_enclosed():
    rng = np.random.default_rng(11)
    certificates = [encloses(*some_filter(rng)) for _ in range(60)]
    assert max(c.rounding / c.upper for c in certificates) <= 1e-9


@pytest.mark.parametrize(
    "poles", [[-1e-4, -1e4], [-1e-3, -1.0, -1e3, -1e6], [-1.0, -2 + 5j, -2 - 5j, -3e3, -1e4]]
)
def test_poles_far_apart_are_quick(poles):
    """Real poles, type 1: the gain is the sum of the time constants, in some 100 steps a pole."""
    f = pf.place_poles(poles)
    certificate = error_bound(f, {1: 1.0}).certificate
    assert certificate.gap <= 1e-7
    assert certificate.points <= 1000
    if np.all(np.isreal(poles)):
        assert certificate.lower <= -np.sum(1.0 / np.array(poles)) <= certificate.upper


def test_an_hour_of_ringing_is_refused():
    with pytest.raises(ValueError, match="ellipsoid"):
        error_bound(pf.place_poles([-1e-4 + 1e4j, -1e-4 - 1e4j]), {1: 1.0})


def test_a_sampled_gain_is_enclosed():
    """The recursion's own numbers in 60 digits: sum of |1 - s_i|, on straight lines, over the steps."""
    for poles, h in (([-20.0] * 3, 0.01), ([-2 + 25j, -2 - 25j, -1.0], 0.02)):
        sampled = pf.place_poles(poles).sampled(h)
        certificate = error_bound(sampled, {1: 1.0}).certificate
        with mpmath.workdps(DIGITS):
            dA, e, C = (mpmath.matrix(part.tolist()) for part in sampled.transition)
            x, total = e, mpmath.mpf(0)
            for _ in range(5 * certificate.points):
                after = x + dA * x
                first, last = (mpmath.fdot(C, v) for v in (x, after))
                square = (first**2 + last**2) / (abs(first) + abs(last)) / 2
                total += mpmath.mpf(h) * (square if first * last < 0 else abs(first + last) / 2)
                x = after
            assert mpmath.mpf(certificate.lower) <= total <= mpmath.mpf(certificate.upper)


def test_poles_that_are_not_quite_those_of_a_widen_the_enclosure():
    """By 1e-9, far more than other roundings: the area that a stands for is enclosed all the same."""
    f = pf.place_poles([-0.25, -0.5, -2.0, -4.0])  # of product 1: speed 1, so that a is scaled already
    off = pf.PhyFilter(f.a * (1.0 + 1e-9 * np.array([0.0, 1.0, -1.0, 1.0])))
    certificate = kernels._kernel(f, 1.0, off.a, off.error_numerator[1:], 0.0, 1.0).l1
    assert certificate.lower <= exact_area(off, 1) <= certificate.upper
    assert certificate.rounding >= 1e-10 * certificate.upper


def test_the_area_so_far_counts_what_was_left_out(monkeypatch):
    """Ringing of which a part in a thousand is left out: the bound holds long after the last step too."""
    monkeypatch.setattr(kernels, "_TAIL", 1e-3)
    f = pf.place_poles([-0.05 + 1j, -0.05 - 1j])
    kernel, exact = kernels.error_kernel(f, 1), exact_area(f, 1)
    assert kernel.l1.tail > 1e-5 * kernel.l1.upper
    running = kernel.running(np.array([0.5, 2.0]) * kernel.l1.horizon)
    assert running[0] < exact <= running[1]
    assert running[1] == pytest.approx(kernel.l1.upper, rel=1e-14)
