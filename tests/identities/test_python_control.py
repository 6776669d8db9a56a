"""python-control's functions on a PhyFilter: the table of docs/python_control.md, call by call, and the arithmetic."""

import copy
import operator
import pickle
import re
from dataclasses import FrozenInstanceError
from pathlib import Path

import control as ct
import matplotlib
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, lowpass, phyfilter_block

PAGE = Path(__file__).parents[2] / "docs" / "python_control.md"
CALLS = re.findall(r"^\| `(.+?)` \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
POINTS = np.array([0.3j, 2.0 + 1.0j, 30.0j])
GENERAL = PhyFilter([400.0, 40.0], [400.0, 30.0])


@pytest.fixture(autouse=True)
def no_window():
    matplotlib.use("Agg")
    yield
    matplotlib.pyplot.close("all")


def given(F):
    return {
        "ct": ct, "np": np, "F": F,
        "K": ct.tf([2.0], [0.05, 1.0]),
        "P": ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]]),
        "t": np.linspace(0.0, 1.0, 101),
        "omega": np.logspace(0, 3, 50),
    }  # fmt: skip


def drawn(plot):
    """Data of all lines of a plot, each (2, N)."""
    lines = [line for cell in np.ravel(plot.lines) for line in (cell if isinstance(cell, list) else [cell])]
    return [np.asarray(line.get_data(), dtype=float) for line in lines if hasattr(line, "get_data")]


def assert_same(one, other, time=1e-8):
    """Equal answers: systems by their response, plots by their lines, numbers as such."""
    if isinstance(other, ct.FrequencyResponseData):
        assert np.allclose(one.frdata, other.frdata, rtol=1e-9, atol=1e-12)
    elif isinstance(other, ct.LTI):
        assert one.dt == other.dt
        assert np.allclose(one(POINTS), other(POINTS), rtol=1e-9, atol=1e-12)
    elif isinstance(other, ct.TimeResponseData):
        assert np.allclose(one.outputs, other.outputs, rtol=time, atol=time)
    elif isinstance(other, dict):
        assert one == pytest.approx(other, rel=1e-6, nan_ok=True)
    elif isinstance(other, ct.ControlPlot):
        assert np.shape(one.lines) == np.shape(other.lines)
        for mine, theirs in zip(drawn(one), drawn(other), strict=True):
            # A root locus takes as many gains as it sees fit: it begins at the same poles.
            alike = slice(None) if mine.shape == theirs.shape else slice(1)
            assert np.allclose(mine[:, alike], theirs[:, alike], rtol=1e-5, atol=1e-6, equal_nan=True)
    elif isinstance(other, ct.PoleZeroData):
        assert np.allclose(one.gains, other.gains, rtol=1e-2)
        assert np.allclose(np.sum(one.loci, axis=1), np.sum(other.loci, axis=1), rtol=1e-6)
    elif isinstance(other, tuple | list):
        assert len(one) == len(other)
        for mine, theirs in zip(one, other, strict=True):
            assert_same(mine, theirs, time)
    elif other is not None:
        # The repeated pole of D: python-control finds it to the root of the rounding, the filter knows it.
        assert np.allclose(one, other, rtol=1e-5, atol=1e-8, equal_nan=True)


def test_the_page_has_the_most_used_calls():
    assert len(CALLS) >= 40


@pytest.mark.parametrize("call", CALLS)
def test_call(call):
    reference = ct.tf([400.0], [1.0, 40.0, 400.0])
    if call.startswith(("ct.input_output_response", "ct.linearize")):
        reference = ct.ss(reference)  # they refuse transfer functions
    # input_output_response integrates to rtol 1e-3 only, in other coordinates.
    time = 1e-3 if call.startswith("ct.input_output_response") else 1e-8
    assert_same(eval(call, given(PhyFilter([400.0, 40.0]))), eval(call, given(reference)), time)


class TestConversion:
    @pytest.mark.parametrize("F", [GENERAL, PhyFilter([20.0]), lowpass(6, 20.0)])
    def test_tf_has_the_coefficients(self, F):
        ((num,),), ((den,),) = ct.tfdata(ct.tf(F, name="named"))
        assert np.array_equal(den[::-1], [*F.a, 1.0])
        assert np.array_equal(num[::-1], np.trim_zeros(F.b, "b"))

    def test_ss_has_the_sections(self):
        F = PhyFilter.from_poles([-3.0] * 8)
        system = ct.ss(F)
        A, equilibrium, C = F.sections
        assert system.state_labels == [f"w[{i}]" for i in range(7, -1, -1)]  # the last section first
        assert np.array_equal(system.A, A[::-1, ::-1])
        assert np.array_equal(system.B[::-1, 0], -A @ equilibrium)
        assert np.array_equal(system.C[0, ::-1], C)
        # Where python-control's companion form has lost five digits the sections have lost none.
        assert np.allclose(np.linalg.eigvals(system.A), -3.0, rtol=1e-12)

    def test_sampling_keeps_the_digits_of_repeated_poles(self):
        F = PhyFilter.from_poles([-3.0] * 8)
        sampled = ct.sample_system(F, 1e-3)
        assert np.allclose(sampled.poles(), np.exp(-3e-3), rtol=1e-12)
        assert np.isclose(sampled(1.0), 1.0, rtol=1e-9)
        matched = ct.sample_system(GENERAL, 1e-3, method="matched")  # which state spaces do not have
        assert np.isclose(matched(1.0), GENERAL.dc_gain, rtol=1e-9)

    @pytest.mark.parametrize(
        "F", [PhyFilter.from_poles([-1.0, -100.0]), PhyFilter([5.427e3, 1.00005427e4], [5427.0, 1e4])]
    )
    def test_step_response_is_as_long_as_that_of_its_transfer_function(self, F):
        assert ct.step_response(F).time[-1] == pytest.approx(ct.step_response(F.transfer_function).time[-1])
        assert ct.step_info(F) == pytest.approx(ct.step_info(F.transfer_function), rel=1e-4)

    def test_a_constant_is_no_filter(self):
        for system in (
            ct.tf([0.0], [1.0]),
            ct.tf([0.0], [1.0, 1.0]),
            ct.ss([], [], [], [[0.0]]),
            ([0.0], [2.0]),
        ):
            with pytest.raises(
                ValueError, match="from_tf: the system is a constant; expected one with at least one"
            ):
                PhyFilter.from_tf(system)

    def test_names_go_to_what_comes_of_it(self):
        system = ct.ss(GENERAL, name="fast", inputs="r", outputs="v")
        assert (system.name, system.input_labels, system.output_labels) == ("fast", ["r"], ["v"])
        with pytest.raises(TypeError, match="name the system"):
            GENERAL.update_names(name="fast")
        with pytest.raises(FrozenInstanceError):
            GENERAL.name = "fast"  # pyright: ignore

    def test_blocks_take_it_twice_in_one_diagram(self):
        with pytest.warns(UserWarning, match="[Dd]uplicate"):
            loop = ct.interconnect(
                [GENERAL, GENERAL], connections=[[(1, 0), (0, 0)]], inplist=[(0, 0)], outlist=[(1, 0)]
            )
        assert np.allclose(loop(POINTS), GENERAL(POINTS) ** 2)

    def test_in_continuation_it_stays_what_it_was(self):
        before = vars(GENERAL).copy()
        assert {"a", "b", "poles"} <= set(before)
        assert set(vars(PhyFilter([400.0, 40.0]))) == {"a", "b", "poles"}  # nothing is stored until asked for
        for same in (copy.copy(GENERAL), copy.deepcopy(GENERAL), pickle.loads(pickle.dumps(GENERAL))):
            assert same == GENERAL
            assert hash(same) == hash(GENERAL)
            assert not same.a.flags.writeable
        assert str(GENERAL) == repr(GENERAL)
        assert GENERAL._repr_html_() is None

    def test_roots_are_arrays_and_answer_a_call(self):
        assert type(GENERAL.poles()) is np.ndarray
        assert np.array_equal(GENERAL.poles(), GENERAL.poles)
        GENERAL.poles().sort()  # the caller's own
        assert type(2.0 * GENERAL.poles) is np.ndarray
        assert isinstance(np.max(GENERAL.poles.real), float)
        assert repr(GENERAL.poles) == repr(np.asarray(GENERAL.poles))

    def test_responses_from_a_state(self):
        t, system = [0.0, 0.1], ct.ss(GENERAL)
        expected = ct.impulse_response(system, t).outputs
        assert np.array_equal(GENERAL.impulse_response(t).outputs, expected)
        with pytest.warns(UserWarning, match="[Nn]on-zero initial"):
            assert np.array_equal(ct.impulse_response(GENERAL, t).outputs, expected)
        assert np.array_equal(
            GENERAL.initial_response(t, [1.0, 2.0]).outputs,
            ct.initial_response(system, t, [1.0, 2.0]).outputs,
        )
        assert np.array_equal(
            GENERAL.forced_response(t, 1.0, [1.0, 2.0]).outputs,
            ct.forced_response(system, t, 1.0, [1.0, 2.0]).outputs,
        )

    def test_squeeze_as_python_control(self):
        for squeeze in (None, False, True):
            assert GENERAL(POINTS, squeeze=squeeze).shape == ct.tf(GENERAL)(POINTS, squeeze=squeeze).shape
        assert not np.isfinite(PhyFilter([20.0])(-20.0, warn_infinite=False))


class TestArithmetic:
    OTHERS = (3, 2.5, np.float64(0.5), ct.tf([1.0, 3.0], [1.0, 2.0]), PhyFilter([20.0]))

    @pytest.mark.parametrize("operation", [operator.add, operator.sub, operator.mul, operator.truediv])
    @pytest.mark.parametrize("other", OTHERS)
    def test_is_a_transfer_function(self, operation, other):
        value = other(POINTS) if isinstance(other, ct.LTI) else other
        for result, expected in (
            (operation(GENERAL, other), operation(GENERAL(POINTS), value)),
            (operation(other, GENERAL), operation(value, GENERAL(POINTS))),
        ):
            assert type(result) is ct.TransferFunction
            assert np.allclose(result(POINTS), expected, rtol=1e-12)

    @pytest.mark.parametrize("operation", [operator.add, operator.sub, operator.mul])
    @pytest.mark.parametrize("other", [ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.5]]), GENERAL.copy("other")])
    def test_is_a_state_space_with_one(self, operation, other):
        for result, expected in (
            (operation(GENERAL, other), operation(GENERAL(POINTS), other(POINTS))),
            (operation(other, GENERAL), operation(other(POINTS), GENERAL(POINTS))),
        ):
            assert type(result) is ct.StateSpace
            assert np.allclose(result(POINTS), expected, rtol=1e-12)

    def test_one_less_the_filter_keeps_its_zeros_at_zero(self):
        F = lowpass(4, 0.1)
        ((num,),), _ = ct.tfdata(1 - F)
        assert np.array_equal(num[::-1], F.error_numerator)

    def test_with_data_a_nonlinear_system_and_a_block(self):
        data = ct.frd([1.0, 2.0j], [1.0, 2.0])
        assert np.allclose((GENERAL * data).frdata[0, 0], GENERAL(1j * data.omega) * [1.0, 2.0j])
        assert np.allclose((GENERAL / data).frdata[0, 0], GENERAL(1j * data.omega) / [1.0, 2.0j])
        tanh = ct.nlsys(None, lambda t, x, u, params: np.tanh(u), inputs=1, outputs=1)
        assert (tanh * GENERAL).nstates == (GENERAL * tanh).nstates == 2
        block = phyfilter_block(GENERAL, 1)
        assert (GENERAL * block).shape == (1, 3)

    def test_with_what_is_no_system(self):
        with pytest.raises(TypeError, match="unsupported operand"):
            GENERAL + "3"  # pyright: ignore
        assert GENERAL != 3
