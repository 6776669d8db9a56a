"""A filter learned from logs of walks, as ``pf.learn`` finds it: the best estimate of the residual, no use in the loop.

Walks of the policies that were trained without a filter, under payloads of the training; noise on the joint velocities
as in training. The label is the residual of every step without noise. What learning weighs is noise against delay; what
the loop adds, that f_hat moves the legs that it is estimated from, no log shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import phyfilter_ctl as pf

from .evaluation import Case, Group, phases, recorded
from .loop import FilterChoice
from .params import params
from .policy import shipped
from .robot import joint_inertia

__all__ = ["LearnedFilter", "learn_filter", "walk_logs"]

FloatArray = NDArray[np.float64]

# Parts of the weight: none, and the training's largest.
_PAYLOADS = (0.0, 0.25)
_POLICIES = ("base-0", "base-1")
_PHASES, _DURATION, _LEFT_OUT = 2, 6.0, 1.0


@dataclass(frozen=True)
class LearnedFilter:
    """What was learned.

    Attributes
    ----------
    choice : FilterChoice
        Of order 1.
    rmse : float
        Of f_hat on the walks, N m.
    to_floor : float
        Over the causal Wiener filter's.
    logs : int
        Number of walks.
    """

    choice: FilterChoice
    rmse: float
    to_floor: float
    logs: int


def walk_logs(*, seed: int = 0) -> list[pf.Recording]:
    """Walks as logs: x = M_0 q' with noise, g = tau - d q', and the residual without noise as label.

    Parameters
    ----------
    seed : int
        Of the noise.
    """
    p, inertia, rng = params(), joint_inertia(), np.random.default_rng(seed)
    dt, damping, first = p.control.dt, p.robot.damping, round(_LEFT_OUT / p.control.dt)
    walks = recorded(
        Group([shipped(name) for name in _POLICIES]),
        [Case(payload=payload) for payload in _PAYLOADS],
        starts=phases(validation=True, count=_PHASES),
        duration=_DURATION,
    )
    logs = []
    for number, (qd, torque) in enumerate(walks):
        mean = 0.5 * (qd[1:] + qd[:-1])
        residual = inertia * np.diff(qd, axis=0) / dt + damping * mean - torque[:-1]
        label = np.vstack([residual[:1], residual])[first:]
        seen = (qd + rng.normal(0.0, p.randomisation.noise_rate, qd.shape))[first:]
        times = dt * np.arange(len(seen))
        g = torque[first:] - damping * seen
        logs.append(pf.Recording(times, inertia * seen, g=g, label=label, name=f"walk {number}"))
    return logs


def learn_filter() -> LearnedFilter:
    """Learn a low-pass filter of order 1 from the walks.

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    """
    logs = walk_logs()
    result = pf.learn(logs, 1)
    floor = result.wiener
    return LearnedFilter(
        FilterChoice((round(float(result.filter.a[0]), 1),)),
        float(result.rmse),
        float("nan") if floor is None else float(floor.ratio),
        len(logs),
    )
