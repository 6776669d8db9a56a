"""Learned models of files, as ``save`` writes them, by kind."""

from __future__ import annotations

import os
from collections.abc import Mapping

from . import _files
from .chebyshev import Chebyshev
from .koopman import Koopman
from .model import LearnedModel
from .network import Network
from .neural_ode import NeuralOde
from .onnx import OnnxNetwork

__all__ = ["KINDS", "saved_model"]

KINDS: Mapping[str, type[LearnedModel]] = {
    "chebyshev": Chebyshev,
    "koopman": Koopman,
    "network": Network,
    "neural_ode": NeuralOde,
    "onnx": OnnxNetwork,
}


def saved_model(
    path: str | os.PathLike[str], kinds: Mapping[str, type[LearnedModel]] = KINDS
) -> LearnedModel:
    """The model that ``save`` wrote to ``path``; nothing in the file is executed.

    Parameters
    ----------
    path : path-like
    kinds : mapping of str to type
        Those that it may be of.

    Raises
    ------
    ValueError
        If it is of none of them, or the file is damaged.
    """
    kind = _files.kind_of(path)
    if kind not in kinds:
        raise ValueError(f"{path}: expected a kind of learned model out of {sorted(kinds)}, got {kind!r}")
    return kinds[kind].load(path)
