"""A filter on disk: a TOML file that a person can read and write, and that gives back every bit."""

from .document import Signals, load, load_signals, save, settled_inertia, settled_signals

__all__ = ["Signals", "load", "load_signals", "save", "settled_inertia", "settled_signals"]
