"""phyfilter-ctl: a control-systems toolbox around PhyFilter.

A robot obeys ``M x' = g + f`` with g known and f only partly known, by a learned model f_theta that fails outside its
training data. PhyFilter passes the learning residual through a designed filter F, without differentiating x:
``f_hat = f_theta + F(s) (M x' - g - f_theta)``.

==============  =======================================================================================
choose F        :func:`place_poles`, :func:`lowpass`, :func:`bandpass`, :class:`PhyFilter`
learn F         :func:`learn`, :func:`learn_jointly`; :mod:`phyfilter_ctl.design` has the paper's algorithms
understand it   :func:`frequency_response`, :func:`ultimate_bound`, :func:`error_variance`, :func:`prior_margin`,
                :func:`loop_margin`, :func:`signal_margin`; designs from them: :mod:`phyfilter_ctl.design.optimal`
run it          :class:`SampledPhyFilter` (``PhyFilter.sampled``), :func:`stack`
connect it      :func:`phyfilter_block`, :func:`sampled_block`, :func:`learned_block`, :func:`plant`: python-control
                systems, wired with ``control.interconnect``
simulate        :func:`flatten`, :func:`simulate`, :func:`simulate_batch`, :func:`sensitivity`
hand it over    :func:`export_c`, :func:`export_fmu`, :func:`export_ssp`
co-simulate     :func:`import_fmu`, :func:`cosimulate`
keep it         :func:`save`, :func:`load` (TOML)
data            :class:`FlightLog`, :func:`split_by_speed`
models of f     :mod:`phyfilter_ctl.learned`
others' ways    :mod:`phyfilter_ctl.baselines`
the paper's     :mod:`phyfilter_ctl.models`
==============  =======================================================================================
"""

from .analysis import (
    BandwidthLimit,
    BoundResult,
    ErrorBudget,
    FilterResponse,
    FilterResponseList,
    InertiaVerdict,
    LoopMargin,
    PoleZeroMap,
    PriorMargin,
    Variance,
    error_budget,
    error_variance,
    frequency_response,
    gauss_markov,
    largest_bandwidth,
    loop_margin,
    pole_zero_map,
    prior_margin,
    ultimate_bound,
)
from .app import designer
from .blocks import (
    BlockFunctions,
    FunctionBlock,
    PhyFilterBlock,
    SampledBlock,
    Variable,
    function_block,
    learned_block,
    phyfilter_block,
    sampled_block,
    wired,
)
from .codegen import export_c
from .design import LearnResult, bandpass, learn, learn_jointly, lowpass, numerator_of_type, place_poles
from .diagram import FlatModel, flatten
from .filter import PhyFilter
from .filterfile import Signals, load, load_signals, save
from .flightlog import FlightLog, split_by_speed, split_flights
from .fmi import cosimulate, export_fmu, export_ssp, import_fmu
from .plants import Plant, plant
from .sampled import FilterState, SampledPhyFilter, stack
from .simulation import (
    Sensitivity,
    SimulationResponse,
    linearize_sampled,
    sampled_open_loop,
    sensitivity,
    signal_margin,
    simulate,
    simulate_batch,
)

__all__ = [
    "BandwidthLimit",
    "BlockFunctions",
    "BoundResult",
    "ErrorBudget",
    "FilterResponse",
    "FilterResponseList",
    "FilterState",
    "FlatModel",
    "FlightLog",
    "FunctionBlock",
    "InertiaVerdict",
    "LearnResult",
    "LoopMargin",
    "PhyFilter",
    "PhyFilterBlock",
    "Plant",
    "PoleZeroMap",
    "PriorMargin",
    "SampledBlock",
    "SampledPhyFilter",
    "Sensitivity",
    "Signals",
    "SimulationResponse",
    "Variable",
    "Variance",
    "bandpass",
    "cosimulate",
    "designer",
    "error_budget",
    "error_variance",
    "export_c",
    "export_fmu",
    "export_ssp",
    "flatten",
    "frequency_response",
    "function_block",
    "gauss_markov",
    "import_fmu",
    "largest_bandwidth",
    "learn",
    "learn_jointly",
    "learned_block",
    "linearize_sampled",
    "load",
    "load_signals",
    "loop_margin",
    "lowpass",
    "numerator_of_type",
    "phyfilter_block",
    "place_poles",
    "plant",
    "pole_zero_map",
    "prior_margin",
    "sampled_block",
    "sampled_open_loop",
    "save",
    "sensitivity",
    "signal_margin",
    "simulate",
    "simulate_batch",
    "split_by_speed",
    "split_flights",
    "stack",
    "ultimate_bound",
    "wired",
]
__version__ = "0.1.0"
