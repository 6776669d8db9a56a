"""Design: a problem in, a filter out."""

from .placement import Family, bandpass, lowpass, numerator_of_type, place_poles

__all__ = ["Family", "bandpass", "lowpass", "numerator_of_type", "place_poles"]
