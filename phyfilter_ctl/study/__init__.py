"""A study of one's own system: numbers with units, flights over seeds, tuning at equal margin, statistics, output."""

from .cluster import on_cluster
from .flights import flight_signals, flight_times, realtime_factor, unit_noise
from .outputs import Outputs, add_output_options
from .parameters import parameter_file, read_parameters
from .progress import Report, progress, silent
from .statistics import Interval, finite, median_interval, reduction
from .tuning import TunedMethod, command_jitter, fastest, read_tuned, tuned_text

__all__ = [
    "Interval",
    "Outputs",
    "Report",
    "TunedMethod",
    "add_output_options",
    "command_jitter",
    "fastest",
    "finite",
    "flight_signals",
    "flight_times",
    "median_interval",
    "on_cluster",
    "parameter_file",
    "progress",
    "read_parameters",
    "read_tuned",
    "realtime_factor",
    "reduction",
    "silent",
    "tuned_text",
    "unit_noise",
]
