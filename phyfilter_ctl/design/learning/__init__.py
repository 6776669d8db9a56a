"""Learning a filter from flights whose true f is known.

``learn_filter`` is the front and ``result`` what it returns; ``search`` goes from order to order and start to start,
``levenberg`` descends, ``sensitivity`` gives exact derivatives in the ``parametrisation`` that is always Hurwitz.
Flights come in as ``residuals``, whole (``samples``) or reduced to correlations (``correlation``, ``sources``);
``label_check`` doubts their labels; ``wiener`` is the floor.
"""

from .learn_filter import learn
from .result import LearnEvent, LearnResult
from .sensitivity import Form
from .wiener import WienerFloor

__all__ = ["Form", "LearnEvent", "LearnResult", "WienerFloor", "learn"]
