"""The paper's learning: rollout, costate recursion and gradient (Algorithm 1), stochastic descent (Algorithm 2).

``algorithms`` holds both, ``costs`` the stage costs, ``rollout`` any discretised filter forwards and backwards, segment
beside segment (``block_map``), ``paper_rollout`` the paper's own realisation.
"""

from .algorithms import Adam, AdjointGradient, TrainResult, adjoint_gradient, train
from .costs import CasadiCost, CostTerms, SquaredError, StageCost
from .rollout import Rollout

__all__ = [
    "Adam",
    "AdjointGradient",
    "CasadiCost",
    "CostTerms",
    "Rollout",
    "SquaredError",
    "StageCost",
    "TrainResult",
    "adjoint_gradient",
    "train",
]
