"""Learned models f_theta of the unknown dynamics, and the protocol that they share."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from ._window import window
from .adaptation import AdaptationRun, AdaptationState, AdaptiveChebyshev
from .bring import learned_model
from .chebyshev import Chebyshev
from .dictionary import Dictionary
from .koopman import Koopman
from .layers import Layers
from .model import FitResult, LearnedModel
from .network import Network
from .neural_ode import NeuralOde, Trajectory
from .online_koopman import KoopmanRun, KoopmanState, OnlineKoopman
from .windowed import Windowed

__all__ = [
    "AdaptationRun",
    "AdaptationState",
    "AdaptiveChebyshev",
    "Chebyshev",
    "Dictionary",
    "FitResult",
    "Koopman",
    "KoopmanRun",
    "KoopmanState",
    "Layers",
    "LearnedModel",
    "Network",
    "NeuralOde",
    "OnlineKoopman",
    "Trajectory",
    "Windowed",
    "learned_model",
    "window",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
