"""Draws results that were computed elsewhere; computes nothing. python-control's plotting conventions."""

from .frequency import FrequencyCurve, frequency_plot
from .learning import learning_plot
from .promises import analysis_plot, bound_plot, trade_off_plot

__all__ = [
    "FrequencyCurve",
    "analysis_plot",
    "bound_plot",
    "frequency_plot",
    "learning_plot",
    "trade_off_plot",
]
