"""A log in words."""

from __future__ import annotations

import numpy as np

from .checks import inertia_varies, is_jump
from .recorded import Recorded

__all__ = ["description"]

# A step longer than this many medians misses a sample at least.
_GAP = 1.5


def description(log: Recorded) -> str:
    """See :meth:`Recording.describe`."""
    name = f" {log.name!r}" if log.name else ""
    first, last = log.times[0], log.times[-1]
    lines = [f"Recording{name}: {log.n} samples, {log.duration:.6g} s, from {first:.6g} s to {last:.6g} s"]
    lines += [f"  {key:<8}  {text}" for key, text in _timing(log).items()]
    lines += ["  channels"]
    unit = f" {log.unit}" if log.unit else ""
    width = max(6, *(len(channel) for channel in log.channels))
    for channel, values in zip(log.channels, log.x.T, strict=True):
        values = values[np.isfinite(values)]
        if not len(values):
            lines.append(f"    {channel:<{width}}  nothing but gaps")
            continue
        low, high, mean = values.min(), values.max(), values.mean()
        lines.append(f"    {channel:<{width}}  {low:.4g} to {high:.4g}{unit}, mean {mean:.4g}")
    return "\n".join([*lines, f"  signals   {_signals_held(log)}"])


def _timing(log: Recorded) -> dict[str, str]:
    steps = np.diff(log.times)
    median = float(np.median(steps))
    jumps = is_jump(steps, median)
    long = (steps > _GAP * median) & ~jumps
    off = steps[~long & ~jumps] - median  # never empty: no more than half of the steps exceed the median
    found = {
        "rate": f"{1.0 / median:.6g} Hz (median step {median:.6g} s), "
        + ("uniform" if log.is_uniform else "steps differ"),
        "jitter": f"at most {np.max(np.abs(off)):.3g} s, rms {np.sqrt(np.mean(off**2)):.3g} s",
        "gaps": "none",
    }
    if long.any():
        missing = int(np.sum(np.rint(steps[long] / median) - 1))
        worst = int(np.argmax(np.where(long, steps, 0.0)))
        found["gaps"] = (
            f"{int(long.sum())}, {missing} sample{'s' if missing > 1 else ''} missing; the longest "
            f"{steps[worst]:.6g} s, after {log.times[worst]:.6g} s"
        )
    if jumps.any():
        k = int(np.argmax(jumps))
        found["jumps"] = (
            f"{int(jumps.sum())} of the clock, the first ahead by {steps[k]:.6g} s after {log.times[k]:.6g} s"
        )
    return found


def _signals_held(log: Recorded) -> str:
    held = [key for key in ("g", "f_theta", "label") if getattr(log, key) is not None]
    if log.inertia is not None:
        held.append(f"inertia ({'one a sample' if inertia_varies(log.inertia, log.n) else 'constant'})")
    if log.features is not None:
        held.append(f"features ({log.features.shape[1]})")
    gaps = int(log.missing.sum())
    return (", ".join(held) or "x alone") + (f"; {gaps} rows with gaps" if gaps else "")
