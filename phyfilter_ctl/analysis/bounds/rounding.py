"""Forward error of the recursion in floating point, the compensated one of float32 included.

Every operation returns its result times 1 + e, |e| <= u, u the unit roundoff (2^-24, 2^-53). Followed through one step
(``filter/recursion.py``; the C code does the same in the same order): x, g, f_theta and M_hat are rounded on their way
in, u = M' dx / h - g - f_theta, the increment dA (w + carry - equilibrium u), the sum, the output. The compensated sum
of state and increment loses nothing (Knuth's two-sum). What a step adds to the states goes on as e^(A t) says.
"""

from __future__ import annotations

import numpy as np

from ..options import InputGains
from .sampled_kernels import SampledKernels

__all__ = ["AXES", "rounding_error"]

# Products of a full inertia, and of E^+, with up to so many axes, in the 2-norm: n u sqrt(n).
AXES = 6
# For the products of two roundings, which are left out of the sums.
_SECOND_ORDER = 1.01


def rounding_error(
    kernels: SampledKernels,
    sizes: tuple[float, float, float, float],
    inputs: InputGains,
    of_u: float,
    of_x: float,
) -> float:
    """Bound of what rounding changes in f_hat.

    Parameters
    ----------
    kernels : SampledKernels
    sizes : (4,) floats
        Bounds of |x|, |x'|, |g| and |f_theta|.
    inputs : InputGains
        What M_hat and E make of x and g.
    of_u, of_x : float
        Gains from u and from M x to f_hat.
    """
    X, V, G, T = sizes
    sampling = kernels.sampled.sampling
    u = 0.5 * float(np.finfo(sampling.precision).eps)
    dA, equilibrium, C = (np.abs(part) for part in kernels.sampled.transition)
    n, h = len(C), kernels.sampled.dt
    slope = inputs.inertia * (V + 2.0 * u * X / h)
    # dx 1, M 2 (in, mean), product, rate 2; g 2 (in, mean), subtraction; E^+ in, product; f_theta 2, subtraction.
    product = AXES * np.sqrt(AXES)
    of_forces = (5.0 + product) * slope + 2.0 * G + (slope + G)
    if kernels.sampled.E is not None:
        of_forces += (product + np.sqrt(AXES)) * (slope + G)
    force = inputs.g * (slope + G)
    of_input = u * (inputs.g * of_forces + 2.0 * T + (force + T))
    U = force + T + of_input
    gains = kernels.state_gains()
    w = gains.of_u * U
    distance = w + equilibrium * U
    into = u * (2.0 * w + 3.0 * equilibrium * U)  # product, subtraction, carry
    change = dA @ distance
    compensated = sampling.precision == "float32"
    local = (n + 1) * u * change + dA @ into + u * change + (2.0 * u * u if compensated else u) * w
    size = float(C @ w)
    output = u * float(C @ w) + (n + 1) * u * size + u * (size + 2.0 * T)
    return _SECOND_ORDER * (
        of_x * inputs.x * u * X + of_u * of_input + float(gains.to_output @ local) + output
    )
