"""Design: a problem in, a filter out."""

import lazy_loader

# Placement needs neither CasADi nor the learned models.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
