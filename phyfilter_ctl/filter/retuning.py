"""Other coefficients for a filter that runs: its state as a state of the new filter.

Both filters are driven by one residual u, of which the old state w is all that is left. The new filter goes on from
about the state that it would most likely have by now, had it run all the time, where u is a random walk at any level
with white noise on it, as strong as the walk at the slowest pole of the new filter. With e the equilibria and P the
covariances of w - e u (:func:`covariance <phyfilter_ctl._sections.covariance>`),

    u_hat = e_old' P_old^-1 w / (e_old' P_old^-1 e_old)                            the level, by least squares
    m     = e_new u_hat + r P_new,old P_old^-1 (w - e_old u_hat)
    r     = (C_new P_new,old C_old')^2 / (C_new P_new C_new' C_old P_old C_old')   how alike the two outputs are
    w_new = m + P_new C_new' (C_old w - C_new m) / (C_new P_new C_new')            no jump of the output

At rest w = e_old u, and w_new = e_new u whatever the two filters are: rest stays rest. For the same filter P_new,old =
P_old and r = 1: nothing changes. The less the filters have in common, the nearer w_new is to rest at u_hat: how a fast
filter got where it is says nothing of a slow one. What the last line adds to the output dies away as C e^(A t) P C', an
autocovariance, so it is never larger than at first; that holds for F(0) = 0 too, where no multiple of e_new moves the
output.

Of another order, the new filter begins at w_rest + s (w_new - w_rest), where w_rest is a start at rest on the present
output: e_new C_old w / F_old(0). With Q the observability Gramian of the new filter, s in 0 to 1 makes the mean of
(w - w_all)' Q (w - w_all) least: the square, integrated over time, of how far f_hat is from where it would be, had the
new filter run all the time (w_all). So on such residuals f_hat is at least as calm as after a start at rest.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_continuous_lyapunov, solve_triangular

from .._sections import FloatArray, chain, covariance
from .loop import FilterState, check_state, checked_inertia
from .recursion import Chain, Recursion

# Below this part of its diagonal entry a pivot is rounding, amplified (order 20 and up): the state follows from others.
_DEPENDENT = 1e-8


def retune(recursion: Recursion, state: FilterState, new: Recursion) -> FilterState:
    """See :meth:`SampledPhyFilter.retune`."""
    check_state(recursion, state)
    n_f, others = state.w.shape[-2], new.channels(state.x.shape[-1])
    if others != n_f:
        raise ValueError(f"retune: the new filter has {others} channels of f, the state {n_f}")
    before = np.asarray(state.w, dtype=np.float64)
    if state.carry is not None:
        before = before + np.asarray(state.carry, dtype=np.float64)
    old_chains, new_chains = _chains(recursion), _chains(new)
    w = np.zeros((*before.shape[:-1], new.order))
    count = max(len(old_chains), len(new_chains))
    for i in range(count):
        rows = slice(i, i + 1) if count > 1 else slice(None)
        one, other = old_chains[i % len(old_chains)], new_chains[i % len(new_chains)]
        w[..., rows, : len(other.C)] = moved(one, other, before[..., rows, : len(one.C)])
    dtype = np.dtype(new.sampling.precision)
    kept = w.astype(dtype)
    carry = (w - kept).astype(dtype) if dtype == np.float32 else None
    cast = {
        name: value.astype(dtype)
        for name in ("x", "g", "f_theta", "inertia")
        if (value := getattr(state, name)) is not None
    }
    now, M = recursion.sampling, new.sampling.inertia
    if isinstance(M, np.ndarray) and not np.array_equal(M, now.inertia if now.inertia is not None else 1.0):
        cast["inertia"] = checked_inertia("inertia", M, state.x.astype(dtype))
    return state._replace(**cast, w=kept, carry=carry)


def moved(old: Chain, new: Chain, w: FloatArray) -> FloatArray:
    """States w (..., n_old) of the old filter as states (..., n_new) of the new one, with the same outputs."""
    noise = float(np.min(np.abs(new.poles))) ** -2
    P_new, P_old = (covariance(poles, poles, noise) for poles in (new.poles, old.poles))
    across = covariance(new.poles, old.poles, noise)
    direction = P_new @ new.C
    size = new.C @ direction
    sizes = size * (old.C @ P_old @ old.C)
    alike = (new.C @ across @ old.C) ** 2 / sizes if sizes > 0.0 else 0.0
    factors = _factors(P_old)
    weights = _solve(factors, chain(old.poles)[1])  # not as rounded: P knows those that are likely

    def kept(w: FloatArray, states: FloatArray) -> FloatArray:
        if not size > 0.0:  # F = 0
            return states
        return states + ((w @ old.C - states @ new.C) / size)[..., None] * direction

    def likely(w: FloatArray) -> FloatArray:
        level = w @ weights / (old.equilibrium @ weights)
        deviation = w - level[..., None] * old.equilibrium
        following = (across @ _solve(factors, deviation.reshape(-1, deviation.shape[-1]).T)).T
        states = level[..., None] * new.equilibrium + alike * following.reshape(*w.shape[:-1], -1)
        return kept(w, states)

    def rest(w: FloatArray) -> FloatArray:
        return kept(w, (w @ old.C / gain)[..., None] * new.equilibrium)

    gain = old.C @ old.equilibrium
    if len(old.C) == len(new.C) or gain == 0.0:
        return likely(w)
    at_rest, beyond = rest(np.eye(len(old.C))).T, (likely(np.eye(len(old.C))) - rest(np.eye(len(old.C)))).T
    seen = solve_continuous_lyapunov(new.A.T, -np.outer(new.C, new.C)) @ beyond
    strength = float(np.sum(seen * (beyond @ P_old)))
    if not 0.0 < strength < np.inf:  # both are one
        return likely(w)
    share = float(np.clip(np.sum(seen * (across - at_rest @ P_old)) / strength, 0.0, 1.0))
    return share * likely(w) + (1.0 - share) * rest(w)


def _chains(recursion: Recursion) -> list[Chain]:
    """Chains with equilibrium and C as rounded for the recursion."""
    return [
        chain._replace(equilibrium=equilibrium, C=C)
        for chain, (_, equilibrium, C) in zip(recursion.chains, recursion.transitions, strict=True)
    ]


def _factors(P: FloatArray) -> tuple[FloatArray, FloatArray]:
    """L with unit diagonal and the inverse of diagonal D, P = L D L'; 0 for the inverse of a zero."""
    n = len(P)
    L, LD, inverse = np.eye(n), np.zeros((n, n)), np.zeros(n)
    for k in range(n):
        LD[k:, k] = P[k:, k] - LD[k:, :k] @ L[k, :k]
        if LD[k, k] > _DEPENDENT * P[k, k]:
            inverse[k] = 1.0 / LD[k, k]
        L[k + 1 :, k] = LD[k + 1 :, k] * inverse[k]
    return L, inverse


def _solve(factors: tuple[FloatArray, FloatArray], right: FloatArray) -> FloatArray:
    L, inverse = factors
    half = solve_triangular(L, right, lower=True, unit_diagonal=True)
    return np.asarray(solve_triangular(L.T, (half.T * inverse).T, unit_diagonal=True))
