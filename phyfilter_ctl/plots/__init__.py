"""Draws results that were computed elsewhere; computes nothing. python-control's plotting conventions."""

from ._style import COLOURS, PAGE, dress, letter_panels, typeset
from ._units import frequency_unit
from .budget import budget_curves, budget_plot
from .estimates import estimate_plot
from .frequency import FrequencyCurve, FrequencyLimit, frequency_plot
from .learning import learning_plot
from .logs import log_plot
from .missed import density_plot, missed_plot
from .poles import PoleSet, pole_plot
from .promises import analysis_plot, bound_plot, trade_off_plot
from .report import ReportPage, report_html, report_pdf

__all__ = [
    "COLOURS",
    "PAGE",
    "FrequencyCurve",
    "FrequencyLimit",
    "PoleSet",
    "ReportPage",
    "analysis_plot",
    "bound_plot",
    "budget_curves",
    "budget_plot",
    "density_plot",
    "dress",
    "estimate_plot",
    "frequency_plot",
    "frequency_unit",
    "learning_plot",
    "letter_panels",
    "log_plot",
    "missed_plot",
    "pole_plot",
    "report_html",
    "report_pdf",
    "trade_off_plot",
    "typeset",
]
