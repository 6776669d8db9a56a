"""What :func:`separate` found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..._sections import FloatArray
from ...recording import Recording
from ...results import Result
from .changes import Changes, Schedule, changes_of
from .identifiability import Identifiability
from .kalman import Course, Forward
from .structure import Samples, Structure, Working

__all__ = ["Ends", "PartEstimate", "PartialSum", "Separation"]


@dataclass(frozen=True, eq=False, repr=False)
class PartialSum(Result):
    """The force of one part or several together.

    Attributes
    ----------
    force : (N, n_x) array
        At the end of the step up to each sample, as f_hat; NaN where it is not identified.
    sd : (N, n_x) array
        Standard deviation.
    """

    force: FloatArray
    sd: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class PartEstimate(PartialSum):
    """One part of the residual; made by :func:`separate`. What the data cannot tell apart is NaN.

    Attributes
    ----------
    force, sd : (N, n_x) arrays
        As for :class:`PartialSum`.
    labels : tuple of str
        Of its p scalars: parameters, or the channels of a force.
    identified : (p,) array
        Which of them the data tell from the other parts.
    value, sd_value : (p,) arrays
        At the end of the recording: of a parameter that is constant the estimate.
    course, sd_course : (N, p) arrays
        Over time.
    only_with : tuple of str
        Labels of other parts that it is known in a sum with.
    message : str
    """

    labels: tuple[str, ...]
    identified: NDArray[np.bool_]
    value: FloatArray
    sd_value: FloatArray
    course: FloatArray
    sd_course: FloatArray
    only_with: tuple[str, ...]
    message: str

    @property
    def interval(self) -> FloatArray:
        """95 % interval (p, 2) of the value."""
        return self.value[:, None] + 1.96 * self.sd_value[:, None] * np.array([-1.0, 1.0])


@dataclass(frozen=True, eq=False, repr=False)
class Separation(Result):
    """What the residual is made of; made by :func:`separate`.

    Attributes
    ----------
    recording : Recording
    parts : dict of str to PartEstimate
        By name.
    f_hat, f_hat_sd : (N, n_x) arrays
        f_theta and all parts: the estimate of f, whatever can be told apart in it, with its standard deviation.
    identifiability : Identifiability
    noise : (n_x,) array
        Deviation of the noise of M x that was counted on.
    log_likelihood : float
        Of the recording under these parts: compare it between bandwidths, deviations and sets of parts.
    consistency : float
        Mean square of the innovations in their own units: 1 where the parts describe the data. Above it intervals are
        too narrow.
    causal : bool
        As asked for.
    notes : tuple of str
        What to look at before trusting the figures.
    _ends : object
        What :meth:`together` and :meth:`changes` reckon with.
    """

    recording: Recording = field(repr=False)
    parts: Mapping[str, PartEstimate]
    f_hat: FloatArray
    f_hat_sd: FloatArray
    identifiability: Identifiability
    noise: FloatArray
    log_likelihood: float
    consistency: float
    causal: bool
    notes: tuple[str, ...]
    _ends: Ends = field(repr=False)

    _figures = (
        "parts",
        "f_hat",
        "f_hat_sd",
        "identifiability",
        "noise",
        "log_likelihood",
        "consistency",
        "notes",
    )

    def together(self, *names: str) -> PartialSum:
        """The force of several parts in sum, also of those known only as a sum.

        Parameters
        ----------
        names : str
            Of the parts.

        Raises
        ------
        ValueError
            If one is unknown, or has partners that are missing: the sum is then not known either.
        """
        unknown = [name for name in names if name not in self.parts]
        if unknown or not names:
            got = ", ".join(unknown) if names else "none"
            raise ValueError(f"names: expected some of {', '.join(self.parts)}, got {got}")
        inside = {label for name in names for label in self.parts[name].labels}
        for name in names:
            missing = [label for label in self.parts[name].only_with if label not in inside]
            if missing:
                raise ValueError(
                    f"names: {name} is known only in a sum with {', '.join(missing)}; name its part too"
                )
        return PartialSum(*self._ends.force([name in names for name in self.parts]))

    def changes(self, part: str, *, false_alarms: float = 1.0, within: float = 0.3) -> Changes:
        """Sudden changes of one part, from the innovations of the filter.

        Parameters
        ----------
        part : str
            Its name.
        false_alarms : float
            How many an hour are accepted at most.
        within : float
            Age at which a change is tested last, s. Older ones are for the filter to follow.

        Returns
        -------
        Changes

        Raises
        ------
        ValueError
            If there is no such part, it is not of ``causal=True``, the recording is shorter than ``within``, or an
            option is out of range.

        Notes
        -----
        The generalised likelihood ratio of A. S. Willsky and H. L. Jones, "A generalized likelihood ratio
        approach to the detection and estimation of jumps in linear systems", IEEE Transactions on Automatic Control 21
        (1), 1976: a jump at sample k leaves a known signature in the innovations, which are white without it. Tested
        are jumps every within/30, at four ages. Bonferroni's inequality sets the threshold, so that the rate holds
        whatever the tests have in common, as long as the innovations are white, of which ``Separation.consistency``
        speaks.

        A filter that has seen a change follows it slowly: separate the recording anew from the alarm on. In flight
        :func:`~phyfilter_ctl.blocks.separation_block` does these tests with ``watch``, and goes on with the change
        counted.

        Examples
        --------
        A load of 0.6 kg that falls off after 2 s:

        >>> from phyfilter_ctl.estimation import ColouredForce, Payload, separate
        >>> from phyfilter_ctl.recording import Recording
        >>> rng, t = np.random.default_rng(0), 0.01 * np.arange(301)
        >>> slope = np.where(t < 2.0, 0.0, 0.6 * 9.81 / 3.0)
        >>> v = np.cumsum(slope) * 0.01 + 0.01 * rng.standard_normal(t.shape)
        >>> log = Recording.from_arrays(x=v, g=np.full(301, 0.6 * 9.81), dt=0.01, inertia=3.0)
        >>> parts = [Payload(1.0, gravity=[9.81]), ColouredForce(0.5, bandwidth=5.0)]
        >>> found = separate(log, parts, noise=0.03, causal=True).changes("payload")
        >>> bool(2.0 < found.alarms[0] < 2.3), bool(found.jumps[0, 0] < -0.3)
        (True, True)
        """
        if part not in self.parts:
            raise ValueError(f"part: expected one of {', '.join(self.parts)}, got {part!r}")
        if not self.causal:
            raise ValueError("separate(causal=True) is needed: innovations are then those of the flight")
        log, own = self.recording, np.flatnonzero(self._ends.structure.part == list(self.parts).index(part))
        schedule = Schedule.of(log.dt, len(own), false_alarms=false_alarms, within=within)
        if log.n <= schedule.ages[-1]:
            raise ValueError(
                f"within: expected less than the recording of {log.duration:.3g} s, got {within:g} s"
            )
        return changes_of(log, self._ends.working, self._ends.run, own, schedule)


@dataclass(frozen=True, eq=False)
class Ends:
    """The model at the end of each step: what forces follow from the scalars.

    Attributes
    ----------
    structure : Structure
    data : Samples
    c : (N, p) array
    covariance : (N, p, p) array
    working : Working
    working_covariance : (N, p, p) array
        Of the working scalars.
    turned : (N, p, p) array
        Derivative of c by these.
    run : Forward
    """

    structure: Structure
    data: Samples
    c: FloatArray
    covariance: FloatArray
    working: Working
    working_covariance: FloatArray
    turned: FloatArray
    run: Forward

    @classmethod
    def of(cls, working: Working, data: Samples, run: Forward, course: Course) -> Ends:
        """Of a filter's or smoother's course."""
        n_x = working.structure.n_x
        P = course.covariance[:, n_x:, n_x:]
        found, covariance, turned = working.physical(course.mean[:, n_x:], P)
        return cls(working.structure, data, found, covariance, working, P, turned, run)

    def map(self, inside: Sequence[bool]) -> tuple[FloatArray, FloatArray]:
        """Force (N, n_x) of the parts inside, and its derivative (N, n_x, p) by all scalars."""
        structure, data = self.structure, self.data
        own = np.asarray(inside)[structure.part]
        L = data.load_end.copy()
        if (i := structure.theta) is not None:
            L[:, :, i] = structure.weight
        force = (L * own @ self.c[..., None])[..., 0]
        if i is None:
            return force, L * own
        into_x = np.linalg.inv(data.M_end + self.c[:, i, None, None] * structure.J)
        slope = (into_x @ (data.force_end[..., None] + L @ self.c[..., None]))[..., 0]
        resist, moved = slope @ structure.J, into_x @ L
        moved[:, :, i] -= (into_x @ resist[..., None])[..., 0]
        D = L * own
        if own[i]:
            theta = self.c[:, i, None]
            force = force - theta * resist
            D = D - theta[..., None] * (structure.J @ moved)
            D[:, :, i] -= resist
        return force, D

    def force(self, inside: Sequence[bool]) -> tuple[FloatArray, FloatArray]:
        """And its standard deviation."""
        force, D = self.map(inside)
        variance = np.einsum("nip,npq,niq->ni", D, self.covariance, D)
        return force, np.sqrt(np.maximum(variance, 0.0))
