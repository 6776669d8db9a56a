"""Placement against scipy's designs, closed forms and, for ITAE, the criterion itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.linalg import expm
from scipy.optimize import brentq

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.design import bandpass, hz, lowpass, place_poles
from phyfilter_ctl.design.placement import _ITAE, Family

# Poles to coefficients and back, a root finder stopped at 1e-15: n <= 8 roundings each.
EXACT = 1e-12
# scipy expands prototypes into coefficients of very different size before it scales them.
SCIPY = 1e-9
# Stored ITAE coefficients are minimal to better than this step, relative.
ITAE_STEP = 5e-4

FAMILIES: tuple[Family, ...] = ("binomial", "butterworth", "bessel", "itae")
PUBLISHED_ITAE = {  # corrected forms as found in later handbooks, three decimals
    2: (1.505,),
    3: (2.172, 1.783),
    4: (2.648, 3.347, 1.953),
    5: (3.257, 4.675, 4.499, 2.068),
    6: (3.740, 6.793, 6.934, 5.629, 2.152),
}


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("order", range(1, 9))
def test_cutoff_is_the_half_power_frequency(family: Family, order: int) -> None:
    filter = lowpass(order, 37.0, family=family)
    assert filter.order == order
    assert filter.is_lowpass
    assert abs(abs(filter(37j)) - np.sqrt(0.5)) < EXACT


@pytest.mark.parametrize("order", range(1, 9))
def test_prototypes_are_scipys(order: int) -> None:
    b, a = signal.butter(order, 20.0, analog=True)
    np.testing.assert_allclose(lowpass(order, 20.0, family="butterworth").a, a[:0:-1], rtol=SCIPY)
    b, a = signal.bessel(order, 20.0, analog=True, norm="mag")
    np.testing.assert_allclose(lowpass(order, 20.0, family="bessel").a, a[:0:-1], rtol=SCIPY)
    assert abs(b[0] / lowpass(order, 20.0, family="bessel").a[0] - 1.0) < SCIPY


def test_hertz() -> None:
    assert signal.butter(2, hz(3.2), analog=True)[1][-1] == pytest.approx(
        lowpass(2, hz(3.2), family="butterworth").a[0]
    )
    for wrong in (np.array([1.0, 2.0]), "3 Hz", 1j):
        with pytest.raises(TypeError, match="frequency: expected a number"):
            hz(wrong)
    with pytest.raises(ValueError, match="frequency: expected a finite number"):
        hz(float("nan"))


def test_binomial_closed_form() -> None:
    filter = lowpass(4, 20.0)
    np.testing.assert_allclose(filter.poles, -20.0 / np.sqrt(2.0**0.25 - 1.0), rtol=EXACT)
    assert np.unique(filter.poles).size == 1


@pytest.mark.parametrize("family", FAMILIES)
def test_natural_norm_sets_a0(family: Family) -> None:
    np.testing.assert_allclose(lowpass(5, 3.0, family=family, norm="natural").a[0], 3.0**5, rtol=EXACT)
    assert np.all(lowpass(3, 20.0, norm="natural").poles == -20.0)


@pytest.mark.parametrize("kind", [1, 2, 3])
def test_cutoff_with_a_numerator(kind: int) -> None:
    filter = lowpass(3, 11.0, family="butterworth", type=kind)
    omega = np.linspace(0.0, 11.0, 400)[:-1]
    assert filter.type == kind
    assert abs(abs(filter(11j)) - np.sqrt(0.5)) < EXACT
    assert np.all(np.abs(filter(1j * omega)) > np.sqrt(0.5))


# -- ITAE -----------------------------------------------------------------------------------------------------------


def itae(inner: np.ndarray) -> float:
    """Integral of t |e| over samples of the step response, whose states come from one matrix exponential."""
    n, count, step = len(inner) + 1, 2**14, 0.004
    companion = np.eye(n, k=1)
    companion[-1] = -np.concatenate([[1.0], inner])
    states = np.zeros((n, 1))
    states[0] = 1.0  # e = 1 - y and its derivatives
    leap = expm(companion * step)
    while states.shape[1] < count:
        states = np.hstack([states, leap @ states])
        leap = leap @ leap
    e, slope = states[:2]
    t = step * np.arange(count)
    # Trapezoidal rule with end correction; a step in which e changes sign is a straight line, two triangles.
    f, df = t * e, e + t * slope
    piece = np.abs(0.5 * step * (f[:-1] + f[1:]) - step**2 / 12.0 * (df[1:] - df[:-1]))
    k = np.flatnonzero(f[:-1] * f[1:] < 0.0)
    piece[k] = 0.5 * step * (f[k] ** 2 + f[k + 1] ** 2) / np.abs(f[k] - f[k + 1])
    return float(np.sum(piece))


@pytest.mark.parametrize("order", range(2, 9))
def test_itae_is_a_local_minimum(order: int) -> None:
    stored = np.array(_ITAE[order])
    least = itae(stored)
    rng = np.random.default_rng(order)
    directions = [*np.eye(order - 1), *(d / np.linalg.norm(d) for d in rng.standard_normal((6, order - 1)))]
    for direction in directions:
        for sign in (-1.0, 1.0):
            assert itae(stored * (1.0 + sign * ITAE_STEP * direction)) > least


@pytest.mark.parametrize("order", PUBLISHED_ITAE)
def test_itae_is_close_to_published_corrections(order: int) -> None:
    published = np.array(PUBLISHED_ITAE[order])
    assert itae(np.array(_ITAE[order])) <= itae(published)
    np.testing.assert_allclose(_ITAE[order], published, rtol=2e-3)


# -- numerators -----------------------------------------------------------------------------------------------------


@given(
    poles=st.lists(st.floats(0.1, 300.0), min_size=1, max_size=6),
    data=st.data(),
)
@settings(max_examples=60, deadline=None)
def test_type_k(poles: list[float], data: st.DataObject) -> None:
    kind = data.draw(st.integers(1, len(poles)))
    filter = place_poles([-p for p in poles], type=kind)
    assert filter.type == kind
    np.testing.assert_array_equal(filter.b[:kind], filter.a[:kind])
    assert not filter.b[kind:].any()
    np.testing.assert_array_equal(np.sort(filter.poles.real), np.sort(-np.array(poles)))


def test_type_n_is_denominator_without_its_head() -> None:
    filter = place_poles([-5, -5, -9], type=3)
    s = np.array([0.3j, 2.0 + 1.0j])
    np.testing.assert_allclose(filter.error(s), s**3 / ((s + 5) ** 2 * (s + 9)), rtol=EXACT)


@given(
    scale=st.floats(0.1, 100.0),
    kind=st.integers(1, 3),
    ratios=st.lists(st.floats(0.05, 3.0), min_size=1, max_size=2, unique=True),
    extra=st.integers(0, 2),
)
@settings(max_examples=80, deadline=None)
def test_internal_model_zeros(scale: float, kind: int, ratios: list[float], extra: int) -> None:
    order = kind + 2 * len(ratios) + extra
    frequencies = scale * np.array(ratios)
    filter = place_poles(np.full(order, -scale), type=kind, zeros_at=frequencies)
    assert filter.type == kind
    # Each a_i - b_i is rounded to eps a_i, and |sum a_i s^i| / |D(s)| is at most sqrt(2)^n here.
    assert np.all(np.abs(filter.error(1j * frequencies)) < 2.0 ** (order / 2) * 1e-14)
    np.testing.assert_array_equal(filter.b[kind + 2 * len(ratios) :], 0.0)


def test_internal_model_follows_a_sine() -> None:
    filter = place_poles([-20.0] * 4, zeros_at=[6.0])
    t = np.linspace(0.0, 4.0, 4001)
    _, error, _ = signal.lsim((filter.error_numerator[::-1], [1.0, *filter.a[::-1]]), np.sin(6.0 * t), t)
    assert np.max(np.abs(error[t > 2.0])) < 1e-4  # lsim joins its samples by straight lines
    _, plain, _ = signal.lsim(
        (PhyFilter(filter.a).error_numerator[::-1], [1.0, *filter.a[::-1]]), np.sin(6.0 * t), t
    )
    assert np.max(np.abs(plain[t > 2.0])) > 0.5


def test_lowpass_numerator_with_zeros_is_type_one() -> None:
    assert place_poles([-3.0] * 3, zeros_at=[2.0]) == place_poles([-3.0] * 3, type=1, zeros_at=2.0)


def test_coefficients_are_taken_as_they_are() -> None:
    assert place_poles([-20, -20], numerator=[0.0, 30.0]) == PhyFilter([400.0, 40.0], [0.0, 30.0])


# -- band-pass ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("order", [2, 4, 6, 8])
@pytest.mark.parametrize("edges", [(4.0, 9.0), (1.0, 50.0), (30.0, 31.0)])
def test_band_edges_and_centre(family: Family, order: int, edges: tuple[float, float]) -> None:
    filter = bandpass(order, *edges, family=family)
    assert filter.order == order
    assert filter.b[0] == 0.0
    assert filter.dc_gain == 0.0
    centre = np.sqrt(edges[0] * edges[1])
    # A narrow band takes the difference of frequencies that agree to 3 %, at an order-fold slope.
    np.testing.assert_allclose(np.abs(filter(1j * np.array(edges))), np.sqrt(0.5), rtol=1e-10)
    np.testing.assert_allclose(filter(1j * centre), 1.0, atol=1e-10)


@pytest.mark.parametrize("order", [2, 4, 6])
def test_bandpass_is_scipys(order: int) -> None:
    b, a = signal.butter(order // 2, [4.0, 9.0], "bandpass", analog=True)
    filter = bandpass(order, 4.0, 9.0)
    np.testing.assert_allclose(filter.a, a[:0:-1], rtol=SCIPY)
    np.testing.assert_allclose(filter.b[order // 2], b[0], rtol=SCIPY)
    b, a = signal.bessel(order // 2, [4.0, 9.0], "bandpass", analog=True, norm="mag")
    np.testing.assert_allclose(bandpass(order, 4.0, 9.0, family="bessel").a, a[:0:-1], rtol=SCIPY)


def test_half_power_by_another_route() -> None:
    filter = lowpass(3, 1.0, family="itae", norm="natural")
    cutoff = brentq(lambda w: abs(filter(1j * w)) - np.sqrt(0.5), 0.1, 10.0)
    np.testing.assert_allclose(lowpass(3, 7.0, family="itae").poles, filter.poles * 7.0 / cutoff, rtol=1e-10)


# -- refusals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: lowpass(0, 1.0), "order: expected at least 1, got 0"),
        (lambda: lowpass(9, 1.0, family="itae"), r"tabulated for orders 1 \.\.\. 8, got 9"),
        (lambda: lowpass(2, 0.0), "cutoff: expected a positive frequency"),
        (lambda: lowpass(2, float("nan")), "cutoff: expected a positive frequency"),
        (lambda: lowpass(2, 1.0, family="chebyshev"), "binomial, butterworth, bessel, itae, got 'chebyshev'"),
        (lambda: lowpass(2, 1.0, norm="delay"), 'norm: expected "magnitude" or "natural"'),
        (lambda: lowpass(2, 1.0, type=3), r"can have type 1 \.\.\. 2, got 3; type 3 needs 3 poles"),
        (lambda: bandpass(3, 1.0, 2.0), "even order .*, got 3; use 2 or 4"),
        (lambda: bandpass(1, 1.0, 2.0), "even order .*, got 1; use 2"),
        (lambda: bandpass(2, 2.0, 2.0), "expected low < high, got 2 and 2"),
        (lambda: bandpass(2, -1.0, 2.0), "low: expected a positive frequency"),
        (lambda: bandpass(2, 1.0, 2.0, dt=-0.1), "dt: expected"),
        (lambda: bandpass(2, 1.0, 4.0, delay=1.0), "dt, delay: expected .* below .* 0.785398 s, got 1 s"),
        (lambda: place_poles([-1.0, 2.0]), "not Hurwitz: pole 2"),
        (lambda: place_poles([-1 + 1j]), "no conjugate"),
        (lambda: place_poles([]), "at least one pole"),
        (lambda: place_poles([-1.0, -2.0], type=0), r"type 1 \.\.\. 2, got 0"),
        (lambda: place_poles([-1.0, -2.0], numerator=[1.0]), r"numerator: expected shape \(2,\), got \(1,\)"),
        (lambda: place_poles([-1.0] * 3, type=2, zeros_at=[1.0]), r"need order 2 \+ 2 x 1 = 4, got 3"),
        (lambda: place_poles([-1.0] * 3, numerator=[1.0, 0.0, 0.0], zeros_at=[1.0]), "give one of the two"),
        (lambda: place_poles([-1.0] * 3, zeros_at=[0.0]), "expected positive frequencies"),
        (lambda: place_poles([-1.0] * 5, zeros_at=[2.0, 2.0]), "distinct"),
        (
            lambda: place_poles([-1.0] * 2, type=2, numerator=[1.0, 0.0]),
            "type: the zeros .* give one of the two",
        ),
    ],
)
def test_refusals(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize("order", [2.0, True, "2"])
def test_order_is_an_integer(order: object) -> None:
    with pytest.raises(TypeError, match="order: expected an integer"):
        lowpass(order, 1.0)


def _fed_back(filter: PhyFilter, h: float, late: int, w: float) -> float:
    """Greatest speed that a force sin(w t) on a unit mass leaves, over that without compensation, at the samples.

    The estimate is taken off the force, held and ``late`` steps late: x integrates force and command exactly.
    """
    sampled = filter.sampled(h)
    n = round(60.0 / h)
    force = np.diff(-np.cos(w * h * np.arange(n + 1)) / w)
    x, commands = 0.0, [0.0] * (late + 1)
    state = sampled.start([0.0], f_hat0=[0.0])
    speeds = []
    for k in range(n):
        acting = commands[k]
        x += h * acting + float(force[k])
        state, f_hat = sampled.step(state, [x], [acting])
        commands.append(-float(f_hat[0]))
        speeds.append(x)
    last = np.array(speeds[n // 2 :])
    return float(np.ptp(last)) / (2.0 / w)


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("late", [0, 3])
def test_lead_makes_up_for_hold_and_delay(order: int, late: int) -> None:
    """3 Hz at 100 Hz: without a lead w h/2 = 0.094 is left of it, with it what the gains leave, (w h)^2/12 = 0.003."""
    w, h = hz(3.0), 0.01
    edges = w / 1.5, 1.5 * w
    lag = (0.5 + late) * h
    plain = _fed_back(bandpass(order, *edges), h, late, w)
    ahead = _fed_back(bandpass(order, *edges, dt=h, delay=late * h), h, late, w)
    assert plain == pytest.approx(2.0 * np.sin(0.5 * w * lag), rel=0.06)  # the gain, and grid of the samples
    assert ahead < 2.0 * (w * h) ** 2 / 12.0


@pytest.mark.parametrize("order", [2, 4, 6])
def test_lead_keeps_the_poles_and_without_one_nothing_changes(order: int) -> None:
    plain, ahead = bandpass(order, 4.0, 9.0), bandpass(order, 4.0, 9.0, dt=0.02, delay=0.01)
    np.testing.assert_array_equal(ahead.a, plain.a)
    np.testing.assert_array_equal(bandpass(order, 4.0, 9.0, dt=0.0, delay=0.0).b, plain.b)
    assert ahead(6j) == pytest.approx(np.exp(6j * 0.02), rel=1e-12)
    assert ahead(0.0) == pytest.approx(-5.0 * np.sin(0.12) / 6.0 if order == 2 else 0.0, abs=1e-12)


@pytest.mark.parametrize("kind", [1.0, "highpass", [1.0, 2.0]])
def test_a_type_is_an_integer(kind: object) -> None:
    for make in (lambda: place_poles([-1.0], type=kind), lambda: lowpass(2, 1.0, type=kind)):  # type: ignore[arg-type]
        with pytest.raises(TypeError, match="type: expected an integer"):
            make()
