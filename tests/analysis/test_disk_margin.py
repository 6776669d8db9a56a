"""Disk margins: python-control's, published ones, and the structured singular value searched for over all phases."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import Loop, PhyFilter, margins

# Searches stop at 1e-7 of a minimum's place; values are flat there.
CLOSE = 1e-6
# Phases are searched in steps of pi/200: a maximum is that square off.
PHASES = 2e-4

# P. Seiler, A. Packard, P. Gahinet (2020), the example of its first figures.
SEILER = ct.tf([25.0], [1.0, 10.0, 10.0, 10.0])
# A. Packard's spinning satellite, after J. Doyle: 90 degrees in each loop, little in both.
SATELLITE = ct.ss([[0, 10], [-10, 0]], np.eye(2), [[1, 10], [-10, 1]], np.zeros((2, 2)))


def test_published_example() -> None:
    disk = margins(SEILER).disk
    assert disk.alpha == pytest.approx(0.46, abs=0.005)
    assert disk.gain_margin == pytest.approx((0.63, 1.59), abs=0.005)
    assert np.rad2deg(disk.phase_margin) == pytest.approx(25.8, abs=0.05)


@pytest.mark.parametrize("skew", [-1.0, 0.0, 0.6, 1.0])
def test_one_channel_is_what_python_control_says(skew: float) -> None:
    disk = margins(SEILER).disk_margin(skew=skew)
    near = disk.frequency * np.array([1.0 - 1e-4, 1.0, 1.0 + 1e-4])
    alpha, gain, phase = ct.disk_margins(SEILER, near, skew=skew)
    assert disk.alpha == pytest.approx(alpha, rel=CLOSE)
    low, high = disk.gain_margin
    assert 20.0 * np.log10(min(1.0 / low, high)) == pytest.approx(gain, rel=CLOSE)
    assert np.rad2deg(disk.phase_margin) == pytest.approx(phase, rel=CLOSE)
    assert ct.disk_margins(SEILER, np.geomspace(1e-2, 1e2, 400), skew=skew)[0] >= disk.alpha * (1.0 - CLOSE)


def largest_over_phases(M: np.ndarray, phases: np.ndarray) -> float:
    """mu of a complex matrix with scalar blocks: the largest spectral radius of U M over diagonal unitary U."""
    grids = np.meshgrid(*[np.exp(1j * phases)] * (len(M) - 1), indexing="ij")
    U = np.stack([np.ones(grids[0].size), *(grid.ravel() for grid in grids)], axis=1)
    return float(np.abs(np.linalg.eigvals(U[:, :, None] * M)).max())


def test_both_loops_of_the_satellite() -> None:
    """Where it binds, mu is found by trying all phases; with slycot, python-control finds it too."""
    disk = margins(SATELLITE).disk
    M = np.linalg.inv(np.eye(2) + np.asarray(SATELLITE(1j * disk.frequency))) - 0.5 * np.eye(2)
    assert 1.0 / disk.alpha == pytest.approx(
        largest_over_phases(M, np.linspace(0, 2 * np.pi, 400)), rel=PHASES
    )
    # One loop at a time: 1/s, so nothing but S - T on the unit circle.
    alone = margins(ct.tf([1.0], [1.0, 0.0])).disk
    assert (alone.alpha, np.rad2deg(alone.phase_margin)) == pytest.approx((2.0, 90.0), rel=CLOSE)
    try:
        theirs = ct.disk_margins(SATELLITE, disk.frequency * np.array([0.999, 1.0, 1.001]))[0]
        assert theirs == pytest.approx(disk.alpha, rel=1e-4)
    except ct.ControlMIMONotImplemented:
        pass  # no slycot here


def test_three_channels() -> None:
    """Up to three channels the bound is mu itself."""
    rng = np.random.default_rng(2)
    A = rng.standard_normal((5, 5)) - 4.0 * np.eye(5)
    L = ct.ss(A, rng.standard_normal((5, 3)), rng.standard_normal((3, 5)), np.zeros((3, 3)))
    disk = margins(L).disk
    M = np.linalg.inv(np.eye(3) + np.asarray(L(1j * disk.frequency))) - 0.5 * np.eye(3)
    found = largest_over_phases(M, np.linspace(0.0, 2.0 * np.pi, 120))
    assert found <= 1.0 / disk.alpha * (1.0 + CLOSE)
    assert found == pytest.approx(1.0 / disk.alpha, rel=2e-3)  # phases in steps of pi/60


def test_a_factor_of_the_disk_reaches_the_boundary() -> None:
    """Sampled: at the frequency that binds, the loop is lost at 1.001 of the disk and stable at 0.999."""
    margin = margins(PhyFilter([20.0]), Loop(delay=0.004), dt=0.01)
    for skew in (-1.0, 0.0, 1.0):
        disk = margin.disk_margin(skew=skew)
        Q, P = margin.loop(np.array([disk.frequency]))
        up, down = 0.5 * (1.0 - skew), 0.5 * (1.0 + skew)
        f = complex(-Q[0] / P[0])
        d = (f - 1.0) / (up + down * f)
        assert abs(d) == pytest.approx(disk.alpha, rel=CLOSE)
        for share in (0.999, 1.001):
            assert margin.stable((1.0 + up * share * d) / (1.0 - down * share * d)) == (share < 1.0)
    assert margin.modulus_margin == pytest.approx(margin.disk_margin(skew=1.0).alpha)


def test_unstable_or_static_loops() -> None:
    gone = margins(ct.tf([20.0], [1.0, 1.0, 1.0, 0.0])).disk
    assert (gone.alpha, gone.gain_margin, gone.phase_margin) == (0.0, (1.0, 1.0), 0.0)
    assert margins(ct.ss([], [], [], -np.eye(2))).disk.alpha == 0.0  # I + L is singular
    # L = 1 stays at S - T = 0: any factor but -1, which no disk of gain 2 and more holds back.
    assert margins(ct.tf([1.0], [1.0, 1.0])).disk.alpha == pytest.approx(2.0, rel=CLOSE)


def test_bad_input() -> None:
    with pytest.raises(ValueError, match="as many outputs as inputs, got 1 and 2"):
        margins(ct.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]))
    with pytest.raises(TypeError, match=r"StateSpace or TransferFunction L.*got float"):
        margins(1.0)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="skew"):
        margins(SEILER).disk_margin(skew=np.nan)
