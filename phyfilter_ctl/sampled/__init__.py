"""The filter on sampled data: whole records, loops and every discretisation by one recursion.

``sampled_filter`` holds the class, ``record`` runs whole logs on the numerics of ``recursion``, ``loop`` advances one
sample at a time, ``windows`` averages signals over (delayed, longer) steps, and ``paper_form`` is Eq. (5) as printed.
"""

from .loop import FilterState, Interval
from .paper_form import PaperState
from .sampled_filter import SampledPhyFilter, stack

__all__ = ["FilterState", "Interval", "PaperState", "SampledPhyFilter", "stack"]
