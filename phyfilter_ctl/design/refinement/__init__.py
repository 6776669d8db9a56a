"""Refining a learned model by the filtered residual (the paper's first open problem).

``refine_model`` is the front; ``offline_problem`` refits after flights, ``online`` while flying, both on the
``regression`` that compares the model's answer and the label through one filter.
"""

from .online import Knowledge, OnlineFlight, OnlineRefiner, OnlineState
from .refine_model import ModelScore, RefineResult, last_layer, refine, score_model

__all__ = [
    "Knowledge",
    "ModelScore",
    "OnlineFlight",
    "OnlineRefiner",
    "OnlineState",
    "RefineResult",
    "last_layer",
    "refine",
    "score_model",
]
