"""How many roots of a loop with delay lie in the right half plane, by the argument principle, with a certificate.

psi(s) = q(s) + mu p(s) e^(-s delay), q and p stable, q(inf) = 1, p(inf) = 0, has no poles in Re s >= 0, so the number
of its zeros there is minus its turns about 0 as s runs up the imaginary axis. The turn over a piece of the axis is
certain once a bound on |psi'| shows that psi cannot get round 0 within the piece; pieces are halved until it does.
"""

from __future__ import annotations

import numpy as np

from ..._sections import FloatArray
from ._factors import Factors

__all__ = ["zeros_on_the_right"]

# Pieces shorter than this share of their frequency that still cannot be certified have a zero on the axis, to rounding.
_SHORTEST = 1e-13
# Pieces times factors beyond which the count is refused: ten thousand turns of the delay for any order, and a slow
# passage of 0 at 1e-6 of the loop's size.
_MOST_WORK = 2**20
# Rounding of psi itself, relative to |q| + |mu p|.
_ROUNDING = 1e-13


def zeros_on_the_right(q: Factors, p: Factors, delay: float, ratio: complex, grid: FloatArray) -> int | None:
    """Number of zeros of psi in Re s > 0; None where one is on the imaginary axis to rounding.

    Parameters
    ----------
    q, p : Factors
    delay : float
        Seconds.
    ratio : complex
        mu. A real one makes the curve its own mirror image: half of it is enough.
    grid : (K,) array
        Positive frequencies in rad/s to start from.

    Raises
    ------
    ValueError
        If the curve turns so often, or passes 0 so often so closely, that the poles take too many pieces to count.
    """
    size = abs(ratio)
    last = 2.0 * float(np.max(np.abs(np.concatenate([q.poles, p.poles, q.zeros, p.zeros])), initial=1.0))
    while q.beyond(last)[1] + size * p.beyond(last)[0] >= 0.5:
        last *= 2.0
    half = np.concatenate([[0.0], grid[grid < last], [last]])
    mirrored = ratio.imag == 0.0
    nodes = half if mirrored else np.concatenate([-half[:0:-1], half])

    def curve(omega: FloatArray) -> np.ndarray:
        s = (1j * omega).astype(np.complex128)
        return q(s) + ratio * p(s) * np.exp(-s * delay)

    values = curve(nodes)
    turn = 0.0
    low, high, left, right = nodes[:-1], nodes[1:], values[:-1], values[1:]
    pieces = len(low)
    while len(low):
        q_size, q_slope = q.bounds(low, high)
        p_size, p_slope = p.bounds(low, high)
        reach = (q_slope + size * (p_slope + delay * p_size)) * (high - low)
        certain = reach + _ROUNDING * (q_size + size * p_size) < np.maximum(np.abs(left), np.abs(right))
        turn += float(np.sum(np.angle(right[certain] / left[certain])))
        low, high, left, right = (part[~certain] for part in (low, high, left, right))
        pieces += len(low)
        if np.any(high - low < _SHORTEST * np.maximum(np.abs(low) + np.abs(high), grid[0])):
            return None
        if pieces * (len(q.poles) + len(p.poles)) > _MOST_WORK:
            raise ValueError(
                f"the poles of this loop take more than {pieces} pieces of the frequency axis to count: its delay of "
                f"{delay:g} s is too long against {last:.3g} rad/s, where it ends, or it lies next to the limit of "
                "stability; shorten the delay, leave out dynamics that are that much faster, or change the ratio"
            )
        middle = 0.5 * (low + high)
        value = curve(middle)
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        left, right = np.concatenate([left, value]), np.concatenate([value, right])
    # Beyond the last node psi stays within 1/2 of 1.
    turn -= float(np.angle(values[-1]))
    turn = 2.0 * turn if mirrored else turn + float(np.angle(values[0]))
    return round(-turn / (2.0 * np.pi))
