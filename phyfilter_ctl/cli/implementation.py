"""``--implementation``: what a sampled filter meets as it runs, from the command line."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..values import Implementation

__all__ = ["read_implementation"]


def read_implementation(entries: list[str]) -> Implementation | None:
    """What ``--implementation NAME[.K]=D ...`` says; None where it is not given.

    Raises
    ------
    ValueError
        For a name that does not count or a value that is no number.
    """
    from ..values import Implementation

    signals: dict[str, dict[int, float]] = {"g": {}, "f_theta": {}, "x": {}, "inertia": {}}
    others = {"jitter": 0.0, "delay_error": 0.0, "x_step": 0.0, "g_step": 0.0, "rounding": 0.0, "f": math.nan}
    for entry in entries:
        name, _, value = entry.partition("=")
        name, dot, order = name.partition(".")
        try:
            if dot:
                signals[name][int(order)] = float(value)
            else:
                others[name], _ = float(value), others[name]
        except (KeyError, ValueError) as error:
            raise ValueError(
                f"--implementation: expected one of {', '.join(others)}, or g.K, f_theta.K, x.K, inertia.K with a "
                f"number, such as jitter=1e-4 or g.1=48; got {entry!r}"
            ) from error
    if not entries:
        return None
    largest = others.pop("f")
    bounds: dict[str, Any] = {**signals, **others}
    try:
        return Implementation(**bounds, f=None if math.isnan(largest) else largest)
    except ValueError as error:
        raise ValueError(f"--implementation: {error}") from error
