"""What the figures of a design amount to, in a line of words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal, cast

from ..analysis.verdict import Sentence, on_error, on_limit, on_loop
from ..filter import SampledPhyFilter
from .designs import Design
from .loops import AssumedLoop

__all__ = ["verdict"]

_LIMITS: tuple[Literal["error", "estimate"], ...] = ("error", "estimate")


def verdict(
    design: Design,
    sampled: SampledPhyFilter | None,
    loop: AssumedLoop,
    bounds: Sequence[float | None],
) -> list[dict[str, str]]:
    """Sentences, the most important first: the loop, the error, each limit that is drawn.

    Parameters
    ----------
    design : Design
    sampled : SampledPhyFilter or None
        None where forward Euler diverges.
    loop : AssumedLoop
    bounds : sequence of float or None
        Certified bounds of the error, continuous and sampled; None or nan where there is none. The last that there is
        counts: that of the filter as it runs.

    Returns
    -------
    list of {"text", "level"}
        level "good", "warn" or "bad".
    """
    if sampled is None:
        text = f"Unstable: forward Euler diverges at a step of {1e3 * design.dt:.4g} ms."
        found = [Sentence(text, "bad")]
    elif loop.margin is None or loop.delay is None:
        text = "Whether the loop is stable could not be computed: its time scales are too far apart."
        found = [Sentence(text, "warn")]
    else:
        found = on_loop(loop.margin, loop.delay)
    if all(sentence.level != "bad" for sentence in found):
        assume = design.assume
        known = [value for value in bounds if value is not None and math.isfinite(value)]
        why = (
            "F(0) is not 1, so the error grows with a residual that grows" if design.filter.type == 0 else ""
        )
        found.append(on_error(known[-1] if known else None, assume.unit, assume.slope, why))
    for kind in _LIMITS:
        limit = _limit(design.limits, kind)
        if limit is not None:
            found.append(on_limit(design.filter, kind, *limit))
    return [sentence._asdict() for sentence in found]


def _limit(limits: Mapping[str, object] | None, kind: str) -> tuple[float, float] | None:
    """Frequency and level of a limit, where it has the form that the designer draws."""
    entry = None if limits is None else limits.get(kind)
    if not isinstance(entry, Mapping):
        return None
    values = [cast(Mapping[str, object], entry).get(name) for name in ("omega", "level")]
    omega, level = (value if isinstance(value, float) else 0.0 for value in values)
    return (omega, level) if 1e-6 <= omega <= 1e8 and level > 0.0 else None
