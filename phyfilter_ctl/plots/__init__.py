"""Draws results that were computed elsewhere; computes nothing. python-control's plotting conventions."""

from .._renamed import former
from ._style import COLOURS, PAGE, dress, letter_panels, typeset
from .frequency import FrequencyCurve, FrequencyLimit

# What results do not draw themselves: the style of figures, and what stands beside a response.
__all__ = ["COLOURS", "PAGE", "FrequencyCurve", "FrequencyLimit", "dress", "letter_panels", "typeset"]


def __getattr__(name: str) -> object:
    return former(__name__, name)
