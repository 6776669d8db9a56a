"""Design: a problem in, a filter out."""

from .adjoint import (
    Adam,
    AdjointGradient,
    CasadiCost,
    CostTerms,
    Rollout,
    SquaredError,
    StageCost,
    TrainResult,
    adjoint_gradient,
    train,
)
from .joint import JointGradient, JointResult, joint_gradient, learn_jointly
from .learning import LearnEvent, LearnResult, WienerFloor, learn
from .placement import Family, bandpass, lowpass, numerator_of_type, place_poles
from .refinement import (
    Knowledge,
    ModelScore,
    OnlineFlight,
    OnlineRefiner,
    OnlineState,
    RefineResult,
    last_layer,
    refine,
    score_model,
)

__all__ = [
    "Adam",
    "AdjointGradient",
    "CasadiCost",
    "CostTerms",
    "Family",
    "JointGradient",
    "JointResult",
    "Knowledge",
    "LearnEvent",
    "LearnResult",
    "ModelScore",
    "OnlineFlight",
    "OnlineRefiner",
    "OnlineState",
    "RefineResult",
    "Rollout",
    "SquaredError",
    "StageCost",
    "TrainResult",
    "WienerFloor",
    "adjoint_gradient",
    "bandpass",
    "joint_gradient",
    "last_layer",
    "learn",
    "learn_jointly",
    "lowpass",
    "numerator_of_type",
    "place_poles",
    "refine",
    "score_model",
    "train",
]
