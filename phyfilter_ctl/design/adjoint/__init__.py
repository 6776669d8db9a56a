"""The paper's learning: rollout, costate recursion and gradient (Algorithm 1), stochastic descent (Algorithm 2).

``gradient`` is Algorithm 1, ``training`` Algorithm 2, ``costs`` the stage costs, ``rollout`` any discretised filter
forwards and backwards, segment beside segment (``block_map``), ``paper_rollout`` the paper's own realisation.
"""

from .costs import CasadiCost, CostTerms, SquaredError, StageCost
from .gradient import AdjointGradient, adjoint_gradient
from .rollout import Cotangents, Rollout, RolloutInputs, RolloutTrace
from .training import Adam, TrainResult, train

__all__ = [
    "Adam",
    "AdjointGradient",
    "CasadiCost",
    "CostTerms",
    "Cotangents",
    "Rollout",
    "RolloutInputs",
    "RolloutTrace",
    "SquaredError",
    "StageCost",
    "TrainResult",
    "adjoint_gradient",
    "train",
]
