"""A filter on disk: a TOML file that a person can read and write, and that gives back every bit."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .document import load, save

__all__ = ["load", "save"]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
