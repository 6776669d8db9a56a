"""Learned models f_theta of the unknown dynamics, and the protocol that they share."""

from __future__ import annotations

from ._window import window
from .adaptation import AdaptationRun, AdaptationState, AdaptiveChebyshev
from .bring import learned_model
from .chebyshev import Chebyshev
from .dictionary import Dictionary
from .function_model import FunctionModel
from .koopman import Koopman
from .layers import Layers
from .model import FitResult, LearnedModel
from .network import Network
from .neural_ode import NeuralOde, Trajectory
from .online_koopman import KoopmanRun, KoopmanState, OnlineKoopman
from .onnx import OnnxGraph, OnnxNetwork, OnnxNode

__all__ = [
    "AdaptationRun",
    "AdaptationState",
    "AdaptiveChebyshev",
    "Chebyshev",
    "Dictionary",
    "FitResult",
    "FunctionModel",
    "Koopman",
    "KoopmanRun",
    "KoopmanState",
    "Layers",
    "LearnedModel",
    "Network",
    "NeuralOde",
    "OnlineKoopman",
    "OnnxGraph",
    "OnnxNetwork",
    "OnnxNode",
    "Trajectory",
    "learned_model",
    "window",
]
