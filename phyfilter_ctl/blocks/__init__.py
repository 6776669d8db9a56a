"""Blocks for python-control diagrams."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .adaptive import adaptive_block
from .delay_line import delay_line, transport_delay
from .function_block import FunctionBlock, function_block
from .functions import BlockEvent, BlockFunctions, Memory, Variable
from .hybrid import Event, HybridBlock, event, hybrid
from .interpreted import Interpreted
from .learned import learned_block
from .lookup import lookup_table
from .phyfilter import PhyFilterBlock, phyfilter_block
from .sampled import FilterLaw, SampledBlock, sampled_block
from .separation import separation_block
from .wiring import signal_names, wired

__all__ = [
    "BlockEvent",
    "BlockFunctions",
    "Event",
    "FilterLaw",
    "FunctionBlock",
    "HybridBlock",
    "Interpreted",
    "Memory",
    "PhyFilterBlock",
    "SampledBlock",
    "Variable",
    "adaptive_block",
    "delay_line",
    "event",
    "function_block",
    "hybrid",
    "learned_block",
    "lookup_table",
    "phyfilter_block",
    "sampled_block",
    "separation_block",
    "signal_names",
    "transport_delay",
    "wired",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
