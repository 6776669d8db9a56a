"""A study of one's own system: numbers with units, flights over seeds, tuning at equal margin, statistics, output.

===========================  ===================================================================================
numbers from a TOML file     :func:`parameter_file`, :func:`read_parameters`: typed, each with its unit and reason
flights over seeds           :func:`flight_times`, :func:`unit_noise`, then ``simulate_batch``, :func:`flight_signals`
tuning at equal margin       :func:`least_error` of what :func:`fastest` finds; :func:`tuned_text`, :func:`read_tuned`
methods by cases by seeds    :func:`score_methods`: medians with intervals, reductions flight by flight
over cores and machines      :class:`Executor`; :class:`Checkpoint` to go on where a study was broken off
table, JSON, picture         :func:`add_output_options`, :class:`Outputs`
===========================  ===================================================================================

The systems in ``models/`` are studied with nothing else; :func:`phyfilter_ctl.fmi.hand_over` hands their parts over.
"""

from ..execution import Checkpoint, Executor, Kind, Report, progress, silent
from .comparison import Scores, score_methods
from .flights import flight_signals, flight_times, realtime_factor, unit_noise
from .outputs import Outputs, add_output_options
from .parameters import parameter_file, read_parameters
from .statistics import Interval, median_interval, reduction
from .tuning import TunedMethod, command_jitter, fastest, least_error, read_tuned, tuned_text

__all__ = [
    "Checkpoint",
    "Executor",
    "Interval",
    "Kind",
    "Outputs",
    "Report",
    "Scores",
    "TunedMethod",
    "add_output_options",
    "command_jitter",
    "fastest",
    "flight_signals",
    "flight_times",
    "least_error",
    "median_interval",
    "parameter_file",
    "progress",
    "read_parameters",
    "read_tuned",
    "realtime_factor",
    "reduction",
    "score_methods",
    "silent",
    "tuned_text",
    "unit_noise",
]
