"""Sampled laws on continuous plants, delays, filters, motors."""

from __future__ import annotations

import control as ct
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.blocks import delay_line

from tests.corpus.reference import Hybrid, filippov, smooth
from tests.corpus.system import System, block


def systems() -> list[System]:
    """Of the family sampled."""
    return []
