# What the room offers, and where it lives: read by type checkers, and at run time by `__init__.py`.

from .flights import flight_signals, flight_times, realtime_factor, unit_noise
from .machines import Checkpoint, Executor, Kind, Report, progress, silent
from .method_comparison import Scores, score_methods
from .method_tuning import TunedMethod, command_jitter, fastest, least_error, read_tuned, tuned_text
from .outputs import Outputs, add_output_options
from .parameters import parameter_file, read_parameters
from .statistics import median_interval, reduction

__all__ = [
    "Checkpoint",
    "Executor",
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
