"""phyfilter-ctl: a control-systems toolbox around PhyFilter."""

from .blocks import PhyFilterBlock, phyfilter_block
from .filter import PhyFilter
from .sampled import FilterState, SampledPhyFilter, stack

__all__ = ["FilterState", "PhyFilter", "PhyFilterBlock", "SampledPhyFilter", "phyfilter_block", "stack"]
__version__ = "0.1.0"
