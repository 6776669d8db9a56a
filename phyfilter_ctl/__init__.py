"""phyfilter-ctl: a control-systems toolbox around PhyFilter.

A robot obeys ``M x' = g + f`` with g known and f only partly known, by a learned model f_theta that fails outside its
training data. PhyFilter passes the learning residual through a designed filter F, without differentiating x:
``f_hat = f_theta + F(s) (M x' - g - f_theta)``.

==============  =======================================================================================
choose F        :func:`place_poles`, :func:`lowpass`, :func:`bandpass`, :class:`PhyFilter`
learn F         :func:`learn`, :func:`learn_jointly`; :mod:`phyfilter_ctl.design` has the paper's algorithms
understand it   :func:`frequency_response`, ``PhyFilter.describe``
run it          :class:`SampledPhyFilter` (``PhyFilter.sampled``), :func:`stack`
connect it      :func:`phyfilter_block`, a python-control system
keep it         :func:`save`, :func:`load` (TOML)
data            :class:`FlightLog`, :func:`split_by_speed`
models of f     :mod:`phyfilter_ctl.learned`
others' ways    :mod:`phyfilter_ctl.baselines`
the paper's     :mod:`phyfilter_ctl.models`
==============  =======================================================================================
"""

from .analysis import FilterResponse, FilterResponseList, frequency_response
from .blocks import PhyFilterBlock, phyfilter_block
from .design import LearnResult, bandpass, learn, learn_jointly, lowpass, numerator_of_type, place_poles
from .filter import PhyFilter
from .filterfile import Signals, load, load_signals, save
from .flightlog import FlightLog, split_by_speed, split_flights
from .sampled import FilterState, SampledPhyFilter, stack

__all__ = [
    "FilterResponse",
    "FilterResponseList",
    "FilterState",
    "FlightLog",
    "LearnResult",
    "PhyFilter",
    "PhyFilterBlock",
    "SampledPhyFilter",
    "Signals",
    "bandpass",
    "frequency_response",
    "learn",
    "learn_jointly",
    "load",
    "load_signals",
    "lowpass",
    "numerator_of_type",
    "phyfilter_block",
    "place_poles",
    "save",
    "split_by_speed",
    "split_flights",
    "stack",
]
__version__ = "0.1.0"
