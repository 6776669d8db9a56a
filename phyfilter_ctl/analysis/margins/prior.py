"""How wrong the modelled inertia may be with f_hat fed back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import ComplexArray
from ...filter import PhyFilter, SampledPhyFilter
from ...results import Result
from ..channels import per_channel
from ..options import Told
from . import _inertia
from .actuator import checked_number
from .ratio_margins import RatioMargins, build_loop

__all__ = ["InertiaVerdict", "PriorMargin", "prior_margin"]


@dataclass(frozen=True, eq=False, repr=False)
class InertiaVerdict(Result):
    """Whether a loop is stable for an inertia matrix, or for every one of a set.

    Parameters
    ----------
    stable : bool
        For a set: True is a proof; False says that the test cannot tell, or that there is a member that is unstable.
    test : {"eigenvalues", "range", "small gain"}
        What decided: the eigenvalues of M_hat M^-1 one by one (exact), the range they cannot leave, or the norm.
    ratios : (n,) complex array
        Eigenvalues of M_hat M^-1, or the two ends of their range.
    message : str
    """

    stable: bool
    test: Literal["eigenvalues", "range", "small gain"]
    ratios: ComplexArray
    message: str


@dataclass(frozen=True, eq=False, repr=False)
class PriorMargin(RatioMargins):
    """Margins of the inner loop 1 + F (mu Act e^(-s delay) - 1) = 0; made by :func:`prior_margin`.

    For matrices Q I + M_hat M^-1 P = 0 splits into one scalar loop for each eigenvalue of M_hat M^-1, real or complex,
    as long as all axes share filter and actuator.

    Parameters
    ----------
    inertia_ratio : float
        mu at which gain, phase, delay, modulus and disk margins are taken.
    loop : Loop
        The characteristic function on the boundary of stability.
    filter : PhyFilter or SampledPhyFilter
        As it runs.
    """

    def inertia(self, M_hat: ArrayLike, M: ArrayLike) -> InertiaVerdict:
        """Whether the loop is stable for one pair of inertia matrices.

        Parameters
        ----------
        M_hat, M : float, (n,) or (n, n) arrays
            Modelled and true inertia, diagonal or full.

        Returns
        -------
        InertiaVerdict
            Exact: every eigenvalue of M_hat M^-1 decided by :meth:`stable`.

        Raises
        ------
        ValueError
            If a matrix is not square, not finite or singular, or the shapes differ.

        Examples
        --------
        >>> margin = prior_margin(PhyFilter.from_poles([-20.0] * 3))
        >>> margin.inertia([[2.0, 0.5], [0.5, 8.0]], [1.0, 1.0]).stable
        True
        >>> margin.inertia([2.0, 10.0], [1.0, 1.0]).message
        'unstable at the eigenvalue 10 of M_hat M^-1'
        """
        found = _inertia.ratios(_inertia.checked_inertia("M_hat", M_hat), _inertia.checked_inertia("M", M))
        lost = [value for value in found if not self.stable(complex(value))]
        if lost:
            message = f"unstable at the eigenvalue {_short(lost[0])} of M_hat M^-1"
        else:
            message = "stable at every eigenvalue of M_hat M^-1"
        return InertiaVerdict(not lost, "eigenvalues", found, message)

    def inertia_between(self, M_hat: ArrayLike, low: ArrayLike, high: ArrayLike) -> InertiaVerdict:
        """Whether the loop is stable for every symmetric M with low <= M <= high (differences positive semidefinite).

        Parameters
        ----------
        M_hat, low, high : float, (n,) or (n, n) arrays
            Symmetric positive definite: modelled inertia, least and largest true one (an empty and a loaded robot).

        Returns
        -------
        InertiaVerdict
            Sufficient: the eigenvalues of M_hat M^-1 are real and stay between the least one for ``high`` and the
            largest one for ``low``; the loop must be stable on that whole range. A constant M is meant.

        Raises
        ------
        ValueError
            If a matrix is not square, symmetric and positive definite, or ``high - low`` is not positive semidefinite.

        Examples
        --------
        >>> margin = prior_margin(PhyFilter.from_poles([-20.0] * 3))
        >>> margin.inertia_between(1.0, 0.2, 5.0).stable, margin.inertia_between(1.0, 0.1, 5.0).stable
        (True, False)
        """
        named = {"M_hat": M_hat, "low": low, "high": high}
        checked = [
            _inertia.definite(name, _inertia.checked_inertia(name, value)) for name, value in named.items()
        ]
        if len({each.shape for each in checked}) > 1:
            raise ValueError(
                f"M_hat, low and high: expected one shape, got {[each.shape for each in checked]}"
            )
        least, most = float(np.linalg.eigvalsh(checked[2] - checked[1])[0]), float(np.max(np.abs(checked[2])))
        if least < -1e-12 * most:
            raise ValueError(
                f"low and high: high - low has the eigenvalue {least:.4g}, expected none below 0; are they exchanged?"
            )
        return self._range(*_inertia.loewner_range(*checked))

    def inertia_within(self, M_hat: ArrayLike, deviation: ArrayLike) -> InertiaVerdict:
        """Whether the loop is stable for every M within a deviation of M_hat.

        Parameters
        ----------
        M_hat : float, (n,) or (n, n) array
            Modelled inertia; symmetric positive definite if ``deviation`` is a matrix.
        deviation : float or (n, n) array
            float: M any matrix with |M - M_hat| <= deviation in the spectral norm, also one that is not symmetric.
            Matrix: M symmetric with |M - M_hat| <= deviation entry by entry.

        Returns
        -------
        InertiaVerdict
            float: sufficient; small gain, |M - M_hat| |M_hat^-1| below :attr:`modulus_margin`, so all axes should have
            one unit. Matrix: exact up to 13 axes, whatever their units; the eigenvalues of M_hat M^-1 fill a real
            range, which the vertices of the box give, and must all be stable. A constant M is meant.

        Raises
        ------
        ValueError
            If M_hat is not regular (matrix: not symmetric positive definite), or ``deviation`` is negative or of
            another shape; or if the margins were not taken at ``inertia_ratio`` = 1.

        Examples
        --------
        >>> margin = prior_margin(PhyFilter([20.0]))
        >>> margin.inertia_within([2.0, 1.0], 0.5).stable
        True
        >>> margin.inertia_within([2.0, 1.0], [[1.0, 0.1], [0.1, 0.5]]).test
        'range'
        """
        model = _inertia.checked_inertia("M_hat", M_hat)
        spread = _signals.real("deviation", deviation)
        if not (np.all(np.isfinite(spread)) and np.all(spread >= 0.0)):
            raise ValueError(f"deviation: expected finite bounds of 0 or more, got {deviation!r}")
        if spread.shape not in ((), model.shape):
            raise ValueError(f"deviation: expected a number or shape {model.shape}, got {spread.shape}")
        if spread.ndim == 0:
            return self._small_gain(float(spread) * float(np.linalg.norm(np.linalg.inv(model), 2)))
        model = _inertia.definite("M_hat", model)
        return self._set(*_inertia.hull_range(model, model[None], np.maximum(spread, spread.T)))

    def inertia_hull(
        self, M_hat: ArrayLike, vertices: ArrayLike, *, deviation: ArrayLike | None = None
    ) -> InertiaVerdict:
        """Whether the loop is stable for every M of a polytope: loads and configurations, and all mixtures of them.

        Parameters
        ----------
        M_hat : float, (n,) or (n, n) array
            Modelled inertia, symmetric positive definite.
        vertices : (J, n, n), (J, n) or (J,) array
            Symmetric positive definite matrices, diagonals or numbers; M is in their convex hull.
        deviation : (n, n) array, optional
            M may lie off the hull by as much, entry by entry: what is between sampled configurations
            (:func:`configuration_hull`). One vertex with a deviation is an interval matrix.

        Returns
        -------
        InertiaVerdict
            Exact, whatever the units of the axes, where the stable ratios are one interval (with a deviation up to 13
            axes): the ends of the range of the eigenvalues of M_hat M^-1 are attained at vertices. A constant M is
            meant; :func:`moving_inertia` is about one that moves.

        Raises
        ------
        ValueError
            If a matrix is not symmetric positive definite, or shapes differ.

        Notes
        -----
        The largest eigenvalue of M_hat^-1/2 M M_hat^-1/2 is a convex function of M, the least a concave one.

        Examples
        --------
        An arm of 2 kg m^2 and 8 kg that takes up to 1 kg with a lever, of which the model knows nothing:

        >>> margin = prior_margin(PhyFilter([20.0]), dt=0.002)
        >>> margin.inertia_hull([2.0, 8.0], [[[2.0, 0.0], [0.0, 8.0]], [[2.5, 0.5], [0.5, 9.0]]]).message
        'the eigenvalues of M_hat M^-1, 0.7534 to 1, lie within one stable interval'
        """
        model = _inertia.definite("M_hat", _inertia.checked_inertia("M_hat", M_hat))
        corners = _inertia.checked_vertices(model, vertices)
        if deviation is None:
            return self._set(*_inertia.hull_range(model, corners))
        spread = _signals.array("deviation", deviation, model.shape)
        if np.any(spread < 0.0):
            raise ValueError("deviation: expected bounds of 0 or more")
        return self._set(*_inertia.hull_range(model, corners, np.maximum(spread, spread.T)))

    def _set(self, low: float, high: float, attained: bool) -> InertiaVerdict:
        """The verdict over a set of M from the range of the eigenvalues."""
        if np.isinf(high):
            message = "a singular M is not excluded: give tighter bounds"
            return InertiaVerdict(False, "range", np.array([low, np.inf], dtype=np.complex128), message)
        verdict = self._range(low, high)
        if attained or verdict.stable:
            return verdict
        return replace(
            verdict, message=f"{verdict.message}; with so many axes this need not mean instability"
        )

    def _range(self, low: float, high: float) -> InertiaVerdict:
        whole = any(a < low and high < b for a, b in self.stable_ratios)
        verb = "lie within" if whole else "are not all within"
        message = f"the eigenvalues of M_hat M^-1, {low:.4g} to {high:.4g}, {verb} one stable interval"
        return InertiaVerdict(whole, "range", np.array([low, high], dtype=np.complex128), message)

    def _small_gain(self, relative: float) -> InertiaVerdict:
        if self.inertia_ratio != 1.0:
            raise ValueError(
                f"a deviation from M_hat needs the margins at inertia_ratio = 1, got {self.inertia_ratio:g}"
            )
        # min |Q + P|/|Q|: with the command as g the modulus margin.
        limit = self._over_ratios.disk(1.0).value if self.is_stable else 0.0
        fine = relative < limit
        sign, name = "<" if fine else ">=", "modulus margin" if self.g == "commanded" else "1/max |S|,"
        message = f"|M - M_hat| |M_hat^-1| = {relative:.4g} {sign} {name} {limit:.4g}"
        ends = [1.0 / (1.0 + relative), 1.0 / (1.0 - relative) if relative < 1.0 else np.inf]
        return InertiaVerdict(fine, "small gain", np.array(ends, dtype=np.complex128), message)


@per_channel
def prior_margin(
    filter: PhyFilter | SampledPhyFilter,
    *,
    actuator: ct.TransferFunction | ct.StateSpace | None = None,
    delay: float = 0.0,
    dt: float | None = None,
    inertia_ratio: float = 1.0,
    g: Told = "commanded",
) -> PriorMargin:
    """How wrong the modelled inertia may be with f_hat fed back, tau = tau_0 - f_hat.

        1 + F(s) (mu Act(s) e^(-s delay) - 1) = 0,    mu = M_hat / M

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter or several
        A sampled one runs at its rate with the command held over the step, as it is (method, delay of the
        measurement); its limit is left out. Several, by ``stack`` or as a sequence: the answer is a ``PerChannel``, and
        every other argument one for all or a list.
    actuator : control.TransferFunction or control.StateSpace, optional
        Continuous, stable, proper, one input and one output. None means an ideal one.
    delay : float
        Delay of the command in seconds.
    dt : float, optional
        Sampling interval in seconds: for a PhyFilter short for ``filter.sampled(dt)``.
    inertia_ratio : float
        mu at which gain, phase, delay, modulus and disk margins are taken.
    g : {"commanded", "applied"}
        What the filter is told, as for :func:`loop_margin`: with "applied" 1 + Act e^(-s delay) (mu - 1) F = 0.

    Returns
    -------
    PriorMargin, or PerChannel of it

    Raises
    ------
    TypeError
        If the filter or the actuator is of another kind.
    ValueError
        If the actuator is unstable, improper, discrete or has several inputs, the delay is negative, the ratio is not
        positive, the filter has g="average" or one filter per channel, or ``dt`` contradicts a sampled filter.

    Notes
    -----
    Plant M x' = Act e^(-s delay) tau + f, filter f_hat = F (M_hat x' - tau). Crossings of the boundary of stability are
    searched along the frequency axis; between two of them the verdict is that of one ratio, taken from the closed-loop
    poles, with delay from a certified count (see :meth:`PriorMargin.stable`). This is the inner loop alone: with
    a lag or delay and an outer loop the limit is set by :func:`loop_margin`.

    Examples
    --------
    Three repeated poles tolerate an inertia taken nine times too large, and no lower limit:

    >>> margin = prior_margin(PhyFilter.from_poles([-20.0] * 3))
    >>> round(margin.min_ratio, 9), round(margin.max_ratio, 9)
    (0.0, 9.0)
    >>> print(prior_margin(PhyFilter([20.0]), dt=0.002).describe())
    stable M_hat/M    0 ... 51.01
    at M_hat/M = 1    stable
    gain margin       0 to 51.01 times at 1571 rad/s (250 Hz)
    phase margin      88.88 deg at 19.61 rad/s (3.12 Hz)
    delay margin      79.13 ms at 19.6 rad/s (3.12 Hz)
    modulus margin    0.9804 at 1571 rad/s (250 Hz)
    disk margin       1.923 at 1571 rad/s (250 Hz): 0.01961 to 51.01 times with 87.75 deg
    sensitivity       peak 1.02
    """
    system, loop = build_loop(filter, actuator, delay, dt, told=g)
    return PriorMargin(_positive(inertia_ratio), loop, system)


def _positive(ratio: float) -> float:
    ratio = checked_number("inertia_ratio", ratio, least=0.0)
    if ratio == 0.0:
        raise ValueError("inertia_ratio: expected a positive ratio M_hat / M, got 0")
    return ratio


def _short(value: complex) -> str:
    return f"{value.real:.6g}" if abs(value.imag) <= 1e-9 * abs(value) else f"{value:.6g}"
