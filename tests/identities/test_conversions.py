"""Filters from and to other libraries: scipy, python-control, and the sampled filter in z."""

import control as ct
import numpy as np
import pytest
import scipy.signal

from phyfilter_ctl import PhyFilter, SampledPhyFilter, phyfilter_block
from phyfilter_ctl.design import lowpass

POINTS = np.array([0.3j, 2.0 + 1.0j, 30.0j])
GENERAL = PhyFilter([400.0, 40.0], [400.0, 30.0])


class TestFromTf:
    @pytest.mark.parametrize("n", [1, 2, 3, 6])
    @pytest.mark.parametrize("output", ["ba", "zpk", "sos"])
    def test_scipy(self, n, output):
        F = PhyFilter.from_tf(scipy.signal.butter(n, 20.0, analog=True, output=output))
        assert F.is_lowpass
        assert np.allclose(F.a, lowpass(n, 20.0, family="butterworth").a, rtol=1e-12)

    @pytest.mark.parametrize("output", ["ba", "zpk", "sos"])
    def test_with_zeros(self, output):
        given = scipy.signal.butter(2, [5.0, 20.0], "bandpass", analog=True, output=output)
        b, a = scipy.signal.butter(2, [5.0, 20.0], "bandpass", analog=True)
        F = PhyFilter.from_tf(given)
        assert np.allclose(F(POINTS), np.polyval(b, POINTS) / np.polyval(a, POINTS), rtol=1e-9)

    @pytest.mark.parametrize(
        "given",
        [
            GENERAL,
            ct.tf(GENERAL),
            ct.ss(GENERAL),
            ([30.0, 400.0], [1.0, 40.0, 400.0]),
            ([0.0, 60.0, 800.0], [2.0, 80.0, 800.0]),
            ([-400.0 / 30.0], [-20.0, -20.0], 30.0),
            scipy.signal.lti([30.0, 400.0], [1.0, 40.0, 400.0]),
            scipy.signal.ZerosPolesGain([-400.0 / 30.0], [-20.0, -20.0], 30.0),
            scipy.signal.StateSpace(*ct.ssdata(GENERAL)),
            scipy.signal.ss2tf(*ct.ssdata(GENERAL)),
        ],
    )
    def test_all_kinds(self, given):
        F = PhyFilter.from_tf(given)
        assert np.allclose(F.a, GENERAL.a, rtol=1e-12)
        assert np.allclose(F.b, GENERAL.b, rtol=1e-12)

    def test_coefficients_come_back_bit_for_bit(self):
        assert PhyFilter.from_tf(ct.tf(GENERAL)) == GENERAL
        assert PhyFilter.from_tf(GENERAL) == GENERAL

    def test_given_poles_are_kept(self):
        F = PhyFilter.from_tf(([], [-3.0] * 8, 3.0**8))
        assert F.poles.tolist() == [-3.0] * 8

    @pytest.mark.parametrize(
        ("given", "reason"),
        [
            (([1.0, 2.0], [1.0, 3.0]), "not strictly proper"),
            (([1.0], [1.0, -3.0]), "not Hurwitz"),
            (([1.0], [0.0, 1.0, 3.0]), "begins with zero"),
            (([], [-1.0 + 2.0j], 1.0), "no conjugate"),
            (([1.0j], [-1.0, -2.0], 1.0), "conjugate pairs"),
            (([], [-1.0], [1.0, 2.0]), "one gain"),
            (([[1.0], [2.0]], [1.0, 3.0]), "one input and one output"),
            (ct.tf([1.0], [1.0, 0.5], 0.01), "discrete"),
            (ct.tf([1.0], [1.0, 0.5], True), "discrete"),
            (scipy.signal.dlti([1.0], [1.0, 0.5], dt=0.01), "discrete"),
            (GENERAL.sampled(0.01), "discrete"),
            (GENERAL.state_space(2), "one input and one output, got 6 and 2"),
            (scipy.signal.butter(2, 0.2), "not strictly proper.*analog=True"),
            (scipy.signal.butter(2, 0.2, output="sos"), "not strictly proper.*analog=True"),
            (np.zeros((1, 6)), "no denominator"),
        ],
    )
    def test_refused_with_the_reason(self, given, reason):
        with pytest.raises(ValueError, match=reason):
            PhyFilter.from_tf(given)

    @pytest.mark.parametrize(
        "given", [3.0, "lowpass", ct.frd([1.0], [1.0]), ct.nlsys(None, lambda t, x, u, p: u)]
    )
    def test_no_transfer_function(self, given):
        with pytest.raises(TypeError, match="from_tf"):
            PhyFilter.from_tf(given)


class TestSampled:
    @pytest.mark.parametrize(
        "options", [{}, {"method": "tustin"}, {"method": "euler"}, {"g": "average"}, {"delay": 0.004}]
    )
    def test_to_ss_is_what_run_does(self, options):
        sampled = GENERAL.sampled(0.002, **options)
        x, g, f_theta = np.random.default_rng(1).standard_normal((3, 40, 2))
        system = sampled.to_ss(2, inertia=[2.0, 3.0])
        start = phyfilter_block(sampled, 2, inertia=[2.0, 3.0]).rest_state(x[0], g[0], f_theta[0])
        response = ct.forced_response(system, inputs=np.hstack([x, g, f_theta]).T, initial_state=start)
        expected = sampled.run(x, g, f_theta, [2.0, 3.0])
        assert np.allclose(response.outputs.T, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())

    @pytest.mark.parametrize("options", [{}, {"delay": 0.004}])
    def test_to_tf_is_to_ss(self, options):
        sampled = GENERAL.sampled(0.002, **options)
        system, z = sampled.to_tf(), np.exp(1j * np.array([0.05, 0.5, 2.0]))
        assert system.dt == 0.002
        assert (system.input_labels, system.output_labels) == (["x[0]", "g[0]", "f_theta[0]"], ["f_hat[0]"])
        assert np.allclose(system(z), sampled.to_ss()(z), rtol=1e-8)

    def test_channels_follow_from_filters_and_direction(self):
        E = [[1.0], [2.0]]
        assert GENERAL.sampled(0.002, E=E).to_ss().shape == (1, 5)
        both = SampledPhyFilter([GENERAL, PhyFilter([20.0])], 0.002).to_ss()
        assert both.state_labels == ["w[0,0]", "w[0,1]", "w[1,0]"]

    def test_refused(self):
        with pytest.raises(ValueError, match="limit"):
            GENERAL.sampled(0.002, limit=1.0).to_ss()
        with pytest.raises(ValueError, match="channels"):
            GENERAL.sampled(0.002).to_ss(0)
