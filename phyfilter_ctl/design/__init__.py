"""Design: a problem in, a filter out."""

from .._renamed import attached

# Placement needs neither CasADi nor the learned models.
__getattr__, __dir__, __all__ = attached(__name__, __file__)
