"""A filter on disk: a TOML file that a person can read and write, and that gives back every bit."""

from .._renamed import former
from .document import Signals, load, load_signals, save

__all__ = ["Signals", "load", "load_signals", "save"]


def __getattr__(name: str) -> object:
    return former(__name__, name)
