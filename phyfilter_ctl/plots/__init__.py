"""Draws results that were computed elsewhere; computes nothing. python-control's plotting conventions."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from ._style import COLOURS, PAGE, dress, letter_panels, typeset
from .frequency import FrequencyCurve, FrequencyLimit

# What results do not draw themselves: the style of figures, and what stands beside a response.
__all__ = ["COLOURS", "PAGE", "FrequencyCurve", "FrequencyLimit", "dress", "letter_panels", "typeset"]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
