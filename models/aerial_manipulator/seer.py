"""SEER-I's models of the arm: which features each sees, and their coefficients."""

from __future__ import annotations

from dataclasses import dataclass

from phyfilter_ctl.learned import Chebyshev

from .features import FeatureSet

__all__ = ["Seer"]


@dataclass(frozen=True, eq=False)
class Seer:
    """Models of the arm's force (N, body axes) and torque (N m, body axes, less that at home).

    Attributes
    ----------
    force, torque : Chebyshev
        Fitted, without unknown parameters.
    force_features, torque_features : FeatureSet
    """

    force: Chebyshev
    torque: Chebyshev
    force_features: FeatureSet
    torque_features: FeatureSet
