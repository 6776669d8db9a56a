"""The former name of :mod:`phyfilter_ctl._signals`, for modules that are being rewritten."""

from ._signals import LARGEST, interval, refuse_ticks, seconds, unmasked, unusable, usable

__all__ = ["LARGEST", "interval", "refuse_ticks", "seconds", "unmasked", "unusable", "usable"]
