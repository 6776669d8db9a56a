"""What users write around a filter, each argument in its turn wrong in every usual way: it works, or names it.

A call either answers or raises a TypeError or a ValueError that names the argument: no error of Python's own, no
answer that takes long.
"""

from __future__ import annotations

import re

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import Bounded, Gaussian, Implementation, Loop, LoopGoal

F = pf.lowpass(2, 20.0)
SAMPLED = F.sampled(0.002)
LOOP = Loop(10.0, 6.0)
GUSTS = pf.gauss_markov(1.0, 0.5)
PLANT = ct.tf([1.0], [1.0, 3.0, 3.0, 1.0], inputs="u", outputs="y", name="plant")
LAW = ct.tf([2.0], [1.0], inputs="e", outputs="u", name="p")
DIAGRAM = ct.interconnect(
    [PLANT, LAW, ct.summing_junction(["r", "-y"], "e", name="error")], inputs="r", outputs="y"
)

BOUNDED, COLOURED = Bounded({1: 3.0}, noise=0.01), Gaussian(GUSTS, noise=0.01)


def given(**arguments):
    return arguments


CALLS = {
    "Loop": (
        Loop,
        given(
            kp=10.0, kd=6.0, actuator=0.02, delay=0.01, inertia_ratio=1.0, g="commanded", command_limit=5.0
        ),
    ),
    "Bounded": (
        Bounded,
        given(
            residual={1: 3.0},
            noise=0.01,
            inertia_error=0.1,
            rate=2.0,
            actuation={0: 0.1},
            position_noise=1e-3,
        )
        | given(implementation=Implementation()),
    ),
    "Gaussian": (Gaussian, given(residual=GUSTS, noise=0.01, actuation=GUSTS, position_noise=1e-3)),
    "Implementation": (
        Implementation,
        given(g={1: 1.0}, f_theta={1: 1.0}, x={2: 1.0}, f=1.0, jitter=1e-4, x_step=1e-3, rounding=1e-7),
    ),
    "LoopGoal": (
        LoopGoal,
        given(loop=LOOP, modulus_margin=0.4, delay_margin=0.01, inertia_ratios=(0.8, 1.2), noise_gain=10.0)
        | given(cost="estimation"),
    ),
    "gauss_markov": (pf.gauss_markov, given(deviation=1.0, time_constant=0.5)),
    "frequency_response": (pf.frequency_response, given(system=F, omega=[1.0, 10.0])),
    "margins of a filter": (pf.margins, given(system=F, loop=LOOP, dt=0.002)),
    "margins of L": (pf.margins, given(system=ct.tf(1, [1, 1, 0]))),
    "margins of a diagram": (pf.margins, given(system=DIAGRAM, at="plant.u")),
    "inertia_tolerance": (
        pf.inertia_tolerance,
        given(filter=F, loop=Loop(), ratios=(0.8, 1.2), rate=0.0, dt=None),
    ),
    "inertia_tolerance of matrices": (
        pf.inertia_tolerance,
        given(filter=F, vertices=[np.eye(2)], M_hat=np.eye(2), rate=0.0),
    ),
    "saturation_margin": (pf.saturation_margin, given(filter=F, loop=LOOP, g="commanded", dt=None)),
    "error_bound": (pf.error_bound, given(filter=F, disturbance=BOUNDED, method="exact", inertia=2.0)),
    "error_bound, sampled": (pf.error_bound, given(filter=SAMPLED, disturbance=BOUNDED, inertia=2.0)),
    "error_variance": (pf.error_variance, given(filter=F, disturbance=Gaussian(GUSTS), inertia=2.0)),
    "error_variance, sampled": (pf.error_variance, given(filter=SAMPLED, disturbance=COLOURED, inertia=2.0)),
    "tracking_error": (
        pf.tracking_error,
        given(filter=SAMPLED, loop=LOOP, disturbance={1: 3.0}, inertia=2.0, dt=None),
    ),
    "analyze": (
        pf.analyze,
        given(filter=SAMPLED, loop=LOOP, disturbance={1: 3.0}, noise_deviation=0.01, inertia=2.0)
        | given(ratios=(0.9, 1.1)),
    ),
    "largest_bandwidth": (
        pf.largest_bandwidth,
        given(make=lambda w: pf.PhyFilter([w]), loop=Loop(delay=0.02)),
    ),
    "fixed_point": (pf.fixed_point, given(sampled=SAMPLED, x=10.0, g=20.0, f_theta=20.0)),
    "between": (pf.between, given(system=DIAGRAM, source="r", target="plant.y")),
}
WRONG = {
    "None": None,
    "text": "a",
    "negative": -1.0,
    "nan": float("nan"),
    "zero": 0,
    "empty list": [],
    "two": [1.0, 2.0],
    "empty dict": {},
    "dict of names": {"a": 1.0},
    "object": object(),
    "matrix": np.ones((2, 2)),
    "true": True,
    "complex": 1 + 2j,
    "function": lambda s: s,
    "tuple": (),
    "large": 1e300,
    "row": np.array([[1.0, 2.0, 3.0]]),
}
# What an argument's own parts are called.
PARTS = {
    "disturbance": "residual|noise",
    "at": "signal",
    "source": "signal",
    "target": "signal",
    "make": "filter|bandwidth",
    "loop": "kp",
    "g": "ranges",
    "vertices": "M",
}


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", CALLS)
def test_a_wrong_argument_is_named(name):
    call, usual = CALLS[name]
    call(**usual)
    unnamed = []
    for argument in usual:
        for kind, value in WRONG.items():
            try:
                call(**{**usual, argument: value})
            except (TypeError, ValueError) as error:
                if not re.search(rf"\b({argument}|{PARTS.get(argument, argument)})\b", str(error)):
                    unnamed.append(f"{argument}, {kind}: {error}")
            except Exception as error:
                unnamed.append(f"{argument}, {kind}: {type(error).__name__}: {error}")
    assert not unnamed, "\n".join(unnamed)
