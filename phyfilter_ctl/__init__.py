"""phyfilter-ctl: a control-systems toolbox around PhyFilter."""

from .filter import PhyFilter
from .sampled import FilterState, SampledPhyFilter, stack

__all__ = ["FilterState", "PhyFilter", "SampledPhyFilter", "stack"]
__version__ = "0.1.0"
