"""The filter: its coefficients (``PhyFilter``), and the same filter on sampled data (``SampledPhyFilter``).

``phyfilter`` holds both classes, ``bank`` one of them per channel; ``rational`` is what follows from the coefficients
alone, ``lti`` what python-control asks of them, ``sampling`` the options of a sampled filter, ``recursion`` the one
step that everything runs on. ``record`` runs whole logs (``blocked``: without a loop per sample), ``loop`` one sample
at a time, ``live`` samples as they come (``live_rules``, ``live_state``: on disk). ``retuning`` changes coefficients
on the way, ``windows`` averages signals over (delayed, longer) steps. ``paper_form`` is Eq. (5) verbatim.
"""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .bank import FilterBank, SampledBank, stack
from .live import LiveFilter
from .live_rules import LiveHealth, LiveRules
from .loop import FilterState, PastStep
from .lti import Roots
from .paper_form import PaperFilter, PaperMatrices, PaperState
from .phyfilter import PhyFilter, SampledPhyFilter
from .record import Estimator, Log
from .recursion import Chain, Recursion, StepConstants
from .sampled_form import SampledForm
from .sampling import Sampling

__all__ = [
    "Chain",
    "Estimator",
    "FilterBank",
    "FilterState",
    "LiveFilter",
    "LiveHealth",
    "LiveRules",
    "Log",
    "PaperFilter",
    "PaperMatrices",
    "PaperState",
    "PastStep",
    "PhyFilter",
    "Recursion",
    "Roots",
    "SampledBank",
    "SampledForm",
    "SampledPhyFilter",
    "Sampling",
    "StepConstants",
    "stack",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
