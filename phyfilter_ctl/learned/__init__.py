"""Learned models f_theta of the unknown dynamics, and the protocol that they share."""

from __future__ import annotations

from ._model import FitResult, LearnedModel
from ._window import window
from .network import Network

__all__ = ["FitResult", "LearnedModel", "Network", "window"]
