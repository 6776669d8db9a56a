"""The filter: its coefficients (``PhyFilter``), and the same filter on sampled data (``SampledPhyFilter``).

``phyfilter`` and ``sampled_filter`` hold the classes, ``record`` runs whole logs on the numerics of ``recursion``,
``loop`` advances one sample at a time, ``retuning`` changes coefficients on the way, ``windows`` averages signals over
(delayed, longer) steps, and ``paper_form`` is Eq. (5) as printed.
"""

from .loop import FilterState, Interval
from .paper_form import PaperState
from .phyfilter import PhyFilter
from .sampled_filter import SampledPhyFilter, stack

__all__ = ["FilterState", "Interval", "PaperState", "PhyFilter", "SampledPhyFilter", "stack"]
