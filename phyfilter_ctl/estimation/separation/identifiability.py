"""Which parts the data can tell apart, and which only as a sum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._sections import FloatArray
from ...results import Result
from .structure import Working

__all__ = ["WEAK", "Combination", "Identifiability", "identifiability", "with_weak_priors"]

WEAK = 0.01  # share of its prior information that a parameter keeps where it is asked how much that matters
_NEGLIGIBLE = 0.05  # of the largest entry of a combination, in units of prior deviations


@dataclass(frozen=True, eq=False, repr=False)
class Combination(Result):
    """A sum that the data know though its terms they do not; made by :func:`separate`.

    Attributes
    ----------
    coefficients : dict of str to float
        By label, the one of the largest share 1.
    value, sd : float
        Of the sum at the end of the recording, in the unit of the term with coefficient 1.
    """

    coefficients: Mapping[str, float]
    value: float
    sd: float

    def __str__(self) -> str:
        terms = " ".join(
            f"{'+' if c >= 0.0 else '-'} {abs(c):.3g} {name}" for name, c in self.coefficients.items()
        )
        return f"{terms.removeprefix('+ ')} = {self.value:.4g} +- {1.96 * self.sd:.2g}"


@dataclass(frozen=True, eq=False, repr=False)
class Identifiability(Result):
    """What the data can tell apart; made by :func:`separate`.

    Attributes
    ----------
    ratio : dict of str to float
        By label: what the data leave of the prior standard deviation, rms over the time asked for, were the priors of
        the parameters ten times as wide as stated. 10 where the data say nothing.
    identified : dict of str to bool
        Whether that is at most the fraction asked for.
    combinations : tuple of Combination
        Sums of those not identified that are, best known first.
    """

    ratio: Mapping[str, float]
    identified: Mapping[str, bool]
    combinations: tuple[Combination, ...]

    def partners(self, labels: tuple[str, ...]) -> tuple[str, ...]:
        """Labels that are known only in a sum with any of some, through others too; they themselves left out.

        Parameters
        ----------
        labels : tuple of str
        """
        group, before = set(labels), 0
        while len(group) > before:
            before = len(group)
            for each in self.combinations:
                if group & each.coefficients.keys():
                    group |= each.coefficients.keys()
        return tuple(label for label in self.ratio if label in group - set(labels))


def with_weak_priors(
    working: Working, covariance: FloatArray, elapsed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Covariance (..., p, p) of working scalars with weak priors, and prior variances (..., p); in units of sd.

    A Gaussian posterior less the information D of its prior is P + P E (1/D - E' P E)^-1 E' P, E the parameters'
    columns: nothing that is nearly singular is inverted.
    """
    structure, units = working.structure, working.sd
    prior = 1.0 + structure.parameter * structure.density * elapsed[..., None] / structure.sd**2
    P = covariance / (units[:, None] * units)
    own = np.flatnonzero(structure.parameter)
    if not len(own):
        return P, prior
    left = -P[..., own[:, None], own]
    left[..., np.arange(len(own)), np.arange(len(own))] += prior[..., own] / (1.0 - WEAK)
    return P + P[..., own] @ np.linalg.solve(left, P[..., own, :]), prior


def identifiability(
    working: Working,
    covariance: FloatArray,
    elapsed: FloatArray,
    last: FloatArray,
    fraction: FloatArray,
    turned: FloatArray,
) -> tuple[Identifiability, NDArray[np.bool_]]:
    """Of covariances (N, p, p) of working scalars at times since the start.

    ``last`` (p,) are the physical ones at the end, ``turned`` (p, p) their derivative by the working ones. Returns the
    report and, sample by sample, whether each scalar is identified.
    """
    structure = working.structure
    alone, prior = with_weak_priors(working, covariance, elapsed)
    share = np.diagonal(alone, axis1=-2, axis2=-1) / prior
    ratio = np.sqrt(share.mean(axis=0))
    identified = ratio <= fraction
    D = turned * working.sd
    units = structure.sd * np.sqrt(prior[-1])
    scaled = D @ alone.mean(axis=0) @ D.T / (units[:, None] * units)
    return (
        Identifiability(
            dict(zip(structure.labels, ratio.tolist(), strict=True)),
            dict(zip(structure.labels, identified.tolist(), strict=True)),
            tuple(
                _combinations(structure.labels, scaled, np.flatnonzero(~identified), units, last, fraction)
            ),
        ),
        np.sqrt(share) <= fraction,
    )


def _combinations(
    labels: tuple[str, ...],
    scaled: FloatArray,
    of: NDArray[np.intp],
    units: FloatArray,
    last: FloatArray,
    fraction: FloatArray,
) -> list[Combination]:
    """Directions among the scalars ``of`` along which little is left of the prior."""
    if len(of) < 2:
        return []
    found = []
    values, vectors = np.linalg.eigh(scaled[of][:, of])
    for value, vector in zip(values, vectors.T, strict=True):
        if value > np.min(fraction[of]) ** 2:
            break
        share = np.abs(vector) / np.max(np.abs(vector))
        main = int(np.argmax(share > 1.0 - 1e-9))
        kept = share > _NEGLIGIBLE
        if kept.sum() < 2:
            continue
        others, main = of[kept & (of != of[main])], of[main]
        # What of the main term the others do not foretell: the sum of least variance.
        weights = np.linalg.solve(scaled[others][:, others], scaled[others, main])
        left = scaled[main, main] - weights @ scaled[others, main]
        terms = {int(main): 1.0}
        terms |= {int(i): float(-w * units[main] / units[i]) for i, w in zip(others, weights, strict=True)}
        found.append(
            Combination(
                {labels[i]: terms[i] for i in sorted(terms)},
                float(sum(a * last[i] for i, a in terms.items())),
                float(units[main] * np.sqrt(max(left, 0.0))),
            )
        )
    return found
