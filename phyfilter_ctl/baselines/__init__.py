"""What one would use where there is no PhyFilter: causal differentiators of sampled velocity, and observers.

``BASELINES`` names the differentiators; ``tune`` sets the parameters of one on flights whose acceleration is known;
``compare`` tunes all of them and the observers on recordings, and scores them against the filter.
The observers are special cases of the filter, and run by it.
"""

from .._renamed import attached

# The comparison is with estimates from recordings, which themselves use a differentiator.
__getattr__, __dir__, __all__ = attached(__name__, __file__)
