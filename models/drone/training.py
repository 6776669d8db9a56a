"""SEER-I for the unknown mass: a Chebyshev model of f over apparent acceleration and mass, from flights without wind.

    f = -dm (v' + g e_z),   f_theta = Xi Phi(z) varsigma(dm),   z = (v_k - v_{k-d})/(d h) from the history of velocities

Three features and one unknown, so Xi has 3 (p + 1)^4 entries, as the paper's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.learned import Chebyshev
from phyfilter_ctl.simulation import BackendChoice

from .experiment import fly
from .flights import conditions
from .methods import Method
from .params import params

__all__ = ["Training", "train"]

FloatArray = NDArray[np.float64]

# Every so many samples go into the fit: neighbours repeat each other.
_EVERY = 10
# The outer loop that flies while data are recorded, rad/s: in the middle of the range that is tried later.
_TRAINING_BANDWIDTH = 1.8


@dataclass(frozen=True)
class Training:
    """A trained SEER-I model, and how well it fits.

    Attributes
    ----------
    model : Chebyshev
    rmse : float
        On the training flights with the mass known, N.
    label_rms : float
        Of the force itself there, N.
    message : str
    """

    model: Chebyshev
    rmse: float
    label_rms: float
    message: str


@cache
def train(backend: BackendChoice = "auto") -> Training:
    """Train SEER-I on flights with known payloads in still air; nothing of the wind is seen.

    Parameters
    ----------
    backend : {"auto", "vm", "c"}
        As for ``simulate``.
    """
    values = params().seer
    given = conditions(params().seeds.train, "mass")
    flights = fly(
        Method("baseline", _TRAINING_BANDWIDTH),
        given,
        keep=("r", "r_ref", "v_m", "f_mass", "f_wind"),
        backend=backend,
    )
    steps = round(values.history / params().sampling.dt)
    z, f = [], []
    for v, force, mass in zip(
        flights.signals["v_m"],
        flights.signals["f_mass"] + flights.signals["f_wind"],
        given.added_mass,
        strict=True,
    ):
        feature = (v[steps:] - v[:-steps])[::_EVERY] / values.history
        z.append(np.column_stack([feature, np.full(len(feature), mass)]))
        f.append(force[steps:][::_EVERY])
    labels = np.concatenate(f)
    result = Chebyshev(values.degree, n_d=1, l2=values.l2, bounds=_bounds(np.concatenate(z))).fit(
        np.concatenate(z), labels
    )
    return Training(result.model, result.rmse, float(np.sqrt(np.mean(labels**2))), result.message)


def _bounds(z: FloatArray) -> FloatArray:
    """Ranges of the features as seen, of the mass as known beforehand (none to the heaviest)."""
    low, high = z[:, :3].min(axis=0), z[:, :3].max(axis=0)
    return np.vstack([np.column_stack([low, high]), [0.0, params().mass.high]])
