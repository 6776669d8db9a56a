"""PhyFilter: coefficients, poles, responses by independent routes, refusals."""

import copy
import dataclasses
import pickle

import control as ct
import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from phyfilter_ctl import PhyFilter

# tf, state space and sections round n products each; a few hundred eps for n <= 6 and poles within a factor 200.
SAME_RESPONSE = 1e-11
# A repeated root that was recognised is a mean of eigenvalues, exact to a few eps times their number.
SAME_POLE = 1e-13

stable_pole = st.floats(0.5, 100.0).map(lambda w: [complex(-w)])
stable_pair = st.tuples(st.floats(0.5, 100.0), st.floats(0.05, 0.999)).map(
    lambda wz: [
        wz[0] * complex(-wz[1], (1 - wz[1] ** 2) ** 0.5),
        wz[0] * complex(-wz[1], -((1 - wz[1] ** 2) ** 0.5)),
    ]
)
poles = st.lists(st.one_of(stable_pole, stable_pair), min_size=1, max_size=3).map(
    lambda parts: [pole for part in parts for pole in part]
)


@settings(max_examples=60, deadline=None)
@given(poles, st.data())
def test_every_route_gives_the_same_response(roots, data):
    lowpass = PhyFilter.from_poles(roots)
    share = data.draw(
        st.lists(st.integers(-200, 200).map(lambda i: i / 100), min_size=len(roots), max_size=len(roots))
    )
    for filter in (lowpass, PhyFilter(lowpass.a, lowpass.a * share, poles=lowpass.poles)):
        s = 1j * np.logspace(-2, 3, 7)
        expected = np.polyval(filter.b[::-1], s) / np.polyval([1.0, *filter.a[::-1]], s)
        A, equilibrium, C = filter.sections
        # F is the sum of states of unit gain weighted by C: its rounding is that of its largest summand.
        peak = max(np.max(np.abs(expected)), np.sum(np.abs(C)))
        B = -A @ equilibrium
        by_sections = [C @ np.linalg.solve(si * np.eye(len(A)) - A, B) for si in s]
        block = filter.state_space(1)
        for route in (filter(s), by_sections, filter.transfer_function(s), -block(s)[0, 1]):
            np.testing.assert_allclose(route, expected, atol=SAME_RESPONSE * peak, rtol=0)
        np.testing.assert_allclose(filter.error(s), 1.0 - expected, atol=SAME_RESPONSE * (1 + peak), rtol=0)
        np.testing.assert_allclose(
            block(s)[0, 0], s * expected, atol=SAME_RESPONSE * np.max(np.abs(s * expected))
        )
        np.testing.assert_allclose(block(s)[0, 2], 1.0 - expected, atol=SAME_RESPONSE * (1 + peak), rtol=0)


@pytest.mark.parametrize("order", range(1, 9))
@pytest.mark.parametrize("pole", [-0.5, -20.0, -1234.5])
def test_repeated_poles_are_recognised_in_the_coefficients(order, pole):
    filter = PhyFilter(PhyFilter.from_poles([pole] * order).a)
    np.testing.assert_allclose(filter.poles, pole, rtol=SAME_POLE)


def test_close_but_distinct_poles_are_not_merged():
    assert len(np.unique(PhyFilter(PhyFilter.from_poles([-20.0, -20.2]).a).poles.round(6))) == 2


@pytest.mark.parametrize("order", range(1, 6))
def test_type_counts_the_zeros_of_the_error_at_zero(order):
    a = PhyFilter.from_poles(-np.linspace(3.0, 30.0, order)).a
    for k in range(order + 1):
        b = np.where(np.arange(order) < k, a, 0.0)
        if k == 0:
            b[0] = 0.5 * a[0]
        filter = PhyFilter(a, b)
        assert filter.type == k
        if k:
            small = 1e-4j
            slope = abs(filter.error(small)) / abs(small) ** k
            assert slope == pytest.approx(abs(filter.error_numerator[k]) / a[0], rel=1e-3)


def test_error_response_has_no_cancellation_near_zero():
    filter = PhyFilter([400.0, 40.0])
    assert abs(filter.error(1e-12j)) == pytest.approx(1e-13, rel=1e-12)


def test_block_follows_a_constant_force():
    # x' = g + f with f = 2, g = -1: the error is the step response of 1 - F.
    filter = PhyFilter.from_poles([-5.0, -8.0])
    t = np.linspace(0.0, 2.0, 201)
    block = filter.state_space(1)
    f_hat = ct.forced_response(block, t, np.array([t, -np.ones_like(t), np.zeros_like(t)])).outputs[0]
    expected = 2.0 * ct.step_response(filter.transfer_function, t).outputs
    np.testing.assert_allclose(f_hat, expected, atol=1e-9)


def test_formula_and_latex():
    s = sympy.Symbol("s")
    filter = PhyFilter([400.0, 40.0], [0.0, 30.0])
    assert sympy.simplify(filter.formula() - 30 * s / (s**2 + 40 * s + 400)) == 0
    assert "\\frac{30 s}{s^{2} + 40 s + 400}" in filter._repr_latex_()
    assert "general form" in filter.describe()


def test_is_frozen_and_comparable():
    filter = PhyFilter([400.0, 40.0])
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(filter, "a", np.array([1.0]))  # noqa: B010  (a plain assignment would not pass the type checker)
    with pytest.raises(ValueError, match="read-only"):
        filter.a[0] = 1.0
    assert filter == PhyFilter([400.0, 40.0], [400.0, 0.0])
    assert hash(filter) == hash(PhyFilter.from_poles([-20.0, -20.0]))
    assert filter != PhyFilter([400.0, 41.0])


def test_input_arrays_are_copied():
    a = np.array([400.0, 40.0])
    filter = PhyFilter(a)
    a[0] = -1.0
    assert filter.a[0] == 400.0


@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        ([-1.0], None, "not Hurwitz: pole 1"),
        ([0.0, 1.0], None, "not Hurwitz: pole"),
        ([1.0, 0.0], None, "not Hurwitz"),
        ([4.0, 0.1, 0.1], None, "real part 0\\."),
        ([], None, "a_0"),
        ([[1.0]], None, "one dimension"),
        ([1.0, np.nan], None, "finite"),
        ([np.inf], None, "finite"),
        (["a"], None, "real numbers"),
        ([1.0 + 1.0j], None, "real numbers"),
        ([1.0, 1.0], [1.0], "b has 1 coefficients but a has 2"),
        ([1.0], [1.0, 2.0], "b has 2 coefficients but a has 1"),
        ([1.0], [], "b_0"),
        ([1.0], [np.nan], "finite"),
    ],
)
def test_bad_coefficients_are_refused(a, b, message):
    with pytest.raises((TypeError, ValueError), match=message):
        PhyFilter(a, b)


@pytest.mark.parametrize(
    ("roots", "message"),
    [
        ([-1.0 + 2.0j], "no conjugate.*add -1-2j"),
        ([-1.0 - 2.0j], "no conjugate.*add -1\\+2j"),
        ([], "at least one pole"),
        ([np.nan], "finite"),
        ([1.0, -2.0], "not Hurwitz: pole 1"),
        ([0.0], "not Hurwitz"),
    ],
)
def test_bad_poles_are_refused(roots, message):
    with pytest.raises(ValueError, match=message):
        PhyFilter.from_poles(roots)


def test_poles_that_do_not_belong_are_refused():
    with pytest.raises(ValueError, match="do not belong to a"):
        PhyFilter([400.0, 40.0], poles=[-20.0, -21.0])
    with pytest.raises(ValueError, match="expected 2"):
        PhyFilter([400.0, 40.0], poles=[-20.0])


@pytest.mark.parametrize(
    ("a", "message"),
    [
        ([400.0, -40.0], "not Hurwitz: a_1 = -40"),
        ([400.0, 0.0], "not Hurwitz: a_1 = 0"),
        ([-400.0, -40.0], "not Hurwitz: a_0 = -400"),
    ],
)
def test_poles_do_not_cover_for_unstable_coefficients(a, message):
    with pytest.raises(ValueError, match=message):
        PhyFilter(a, poles=[-20.0, -20.0])
    with pytest.raises(ValueError, match="not Hurwitz"):
        PhyFilter(a, [1.0, 2.0])


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
def test_given_poles_must_be_finite(bad):
    for a in ([400.0, 40.0], [-1.0]):
        with pytest.raises(ValueError, match="poles: expected finite"):
            PhyFilter(a, poles=[bad] * len(a))


def test_sizes_that_leave_double_precision_are_refused():
    for roots in ([-1e-200] * 2, [-1e-160] * 2, [-1e200] * 2):
        with pytest.raises(ValueError, match="poles: their product leaves the range"):
            PhyFilter.from_poles(roots)
    with pytest.raises(ValueError, match="poles: expected finite ones below"):
        PhyFilter.from_poles([complex(-1e308, 1e308), complex(-1e308, -1e308)])
    with pytest.raises(ValueError, match="too far apart"):
        PhyFilter([1e-300, 1e308])
    with pytest.raises(ValueError, match="b_i / a_i leaves the range"):
        PhyFilter([1e-200], [1e200])


def test_far_beyond_the_poles_the_highest_powers_count():
    """s^2 and s^4 overflow, F and 1 - F do not: b_2 / s^2 and 1 to some roundings, with b_3 = 0."""
    filter = PhyFilter(PhyFilter.from_poles([-1.0, -2.0, -3.0, -4.0]).a, [1.0, 2.0, 1e10, 0.0])
    for s in (1e150j, 1e150 + 1e150j):
        assert filter(s) == pytest.approx(1e10 / s / s, rel=1e-14, abs=0.0)
        assert filter.error(s) == pytest.approx(1.0, rel=1e-14)
    both = filter([1e150j, 3.0j])  # beside one that does not overflow
    assert both[1] == filter(3.0j)


@pytest.mark.parametrize("b", [None, [400.0, 0.0], [400.0, 40.0], [300.0, 7.0]])
@pytest.mark.parametrize("a", [[400.0, 40.0], [400.0003, 40.0], [399.9999, 40.00003]])
def test_f_and_its_error_add_up_to_one(a, b):
    """Of real poles sum |a_i s^i| <= 2^(n/2) |D| on the axis: what a rounds away grows by no more than that."""
    given = np.array(a)
    # b where it equals a stays so: that is what the type is.
    filter = PhyFilter(given, b and np.where(np.array(b) == [400.0, 40.0], given, b), poles=[-20.0, -20.0])
    s = 1j * np.logspace(-6, 6, 400)
    rounding = 2 * 2 * 1e-14 + 32 * np.finfo(float).eps
    np.testing.assert_allclose(filter(s) + filter.error(s), 1.0, atol=rounding, rtol=0)
    assert filter.poles.tolist() == [-20.0, -20.0]
    assert filter.is_lowpass == (b is None or b == [400.0, 0.0])
    assert filter.type == {None: 1, 400.0: 1 + (b is not None and b[1] == 40.0), 300.0: 0}[b and b[0]]
    # Two roundings of the ratio.
    assert filter.dc_gain == pytest.approx(1.0 if b is None or b[0] == 400.0 else 300.0 / a[0], rel=4e-16)
    again = PhyFilter(filter.a, filter.b, poles=filter.poles)
    assert again == filter


def test_coefficients_that_poles_give_to_rounding_stay():
    a = np.array([400.0, 40.0]) * (1.0 + 4 * np.finfo(float).eps)
    assert PhyFilter(a, poles=[-20.0, -20.0]).a.tolist() == a.tolist()


def test_equal_filters_hash_alike_whatever_the_sign_of_a_zero():
    one, other = PhyFilter([400.0, 40.0], [0.0, 40.0]), PhyFilter([400.0, 40.0], [-0.0, 40.0])
    assert one == other
    assert hash(one) == hash(other)
    assert hash(one.sampled(0.01)) == hash(other.sampled(0.01, delay=-0.0))
    roots = PhyFilter.from_poles([complex(-20.0, -0.0), -20.0]).poles
    assert not np.any(np.signbit(roots.imag))


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
def test_copies_are_read_only_and_the_same(again):
    filter = PhyFilter(PhyFilter.from_poles([-1e-6, -3.0, -1e6]).a, [1.0, 2.0, 3.0])
    assert filter.type == 0  # something cached to carry over
    twin = again(filter)
    assert twin == filter
    assert hash(twin) == hash(filter)
    for name in ("a", "b", "poles"):
        assert getattr(twin, name).tobytes() == getattr(filter, name).tobytes()
        assert not getattr(twin, name).flags.writeable


def test_orders_have_an_end():
    assert PhyFilter.from_poles([-1.0] * 64).order == 64
    with pytest.raises(ValueError, match="a: expected at most 64"):
        PhyFilter(np.ones(65))
    with pytest.raises(ValueError, match="poles: expected at most 64"):
        PhyFilter.from_poles(-np.ones(100_000))


def test_zeros_beyond_double_precision_are_none():
    a = PhyFilter.from_poles([-1.0, -2.0, -3.0]).a
    assert PhyFilter(a, [1.0, 2.0, 5e-324]).zeros.tolist() == [-0.5]
    assert PhyFilter(a, [1.0, 5e-324, 0.0]).zeros.tolist() == []
    assert np.max(np.abs(PhyFilter(a, [0.0, 1.0, 1e-250]).zeros)) == pytest.approx(1e250)


def test_channels_are_checked():
    with pytest.raises(ValueError, match="at least 1"):
        PhyFilter([1.0]).state_space(0)
