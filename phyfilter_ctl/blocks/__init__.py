"""Blocks for python-control diagrams."""

from .functions import BlockFunctions, Variable, dependencies
from .phyfilter import PhyFilterBlock, phyfilter_block

__all__ = ["BlockFunctions", "PhyFilterBlock", "Variable", "dependencies", "phyfilter_block"]
