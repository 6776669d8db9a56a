"""Learning a filter from flights whose true f is known.

``learn_filter`` is the front, ``answer`` what is made of the search (``verdict``: in words), ``result`` what it
returns; ``search`` goes from order to order and start to start, ``levenberg`` descends, ``sensitivity`` gives exact
derivatives in the ``parametrisation`` that is always Hurwitz, or in ``coordinates`` within limits; ``shape`` is
what F keeps by construction, ``shrinkage`` the pull towards a lower order, ``options`` are those that most calls leave
alone. Flights come in by ``reading`` as
``residuals``, in memory or ``stored`` where they are, whole (``samples``) or reduced to correlations (``correlation``,
``sources``, ``offsets`` of labels); ``label_check`` doubts their labels. ``folds``, ``validation`` and ``intervals``
say how far the answer holds, ``wiener`` is the floor: a result asks them by its ``evidence``. ``axes`` chooses among
one filter for all axes, one each and a matrix. ``constraints`` are what F must keep in a loop, ``constrained`` the
search among filters that keep them, ``in_loop`` its answer.
"""

from functools import partial
from typing import TYPE_CHECKING

from ..._renamed import former
from .axes import AxesResult, AxesScore
from .constraints import LoopGoal, LoopPrice, MarginsLike
from .intervals import Intervals
from .learn_filter import learn
from .options import LearnEvent, Reading, Search
from .result import LearnResult
from .sensitivity import Form
from .shape import Shape
from .validation import FlightScore, OrderScore
from .wiener import WienerFloor

__all__ = [
    "AxesResult",
    "AxesScore",
    "FlightScore",
    "Form",
    "Intervals",
    "LearnEvent",
    "LearnResult",
    "LoopGoal",
    "LoopPrice",
    "MarginsLike",
    "OrderScore",
    "Reading",
    "Search",
    "Shape",
    "WienerFloor",
    "learn",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
