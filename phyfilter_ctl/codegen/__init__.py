"""C for microcontrollers, simulations and FMUs."""

from .model import CModel

__all__ = ["CModel"]
