"""The paper's own realisation, Eq. (5) under forward Euler, with the derivatives that Algorithm 1 asks for.

    s_{k+1} = s_k + h (S s_k + c f_hat_k + P v_k),    f_hat_k = H s_k + J v_k,    v = (x, g, f_theta)

s stacks xi and its derivatives and the integrals of f_hat, f_theta, x (and g in the general form). H, J, c, P and the
start are affine in the coefficients, so their derivatives are exact differences. One step of a loop per sample: this
realisation loses its digits over long records and is rolled out over short ones only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..._sections import FloatArray
from ...filter import PhyFilter

_X, _G, _F = range(3)


class Matrices(NamedTuple):
    """What depends on the coefficients; states number s."""

    H: FloatArray  # (s,)
    J: FloatArray  # (3,)
    c: FloatArray  # (s,)
    P: FloatArray  # (s, 3)
    start: FloatArray  # (s,): state at x(0) = 1


@dataclass(frozen=True)
class PaperMap:
    """Matrices of the realisation and their derivatives (first axis) in a, then b in the general form."""

    dt: float
    shift: FloatArray  # S (s, s)
    now: Matrices
    slopes: Matrices

    @classmethod
    def build(cls, filter: PhyFilter, dt: float, *, lowpass: bool) -> PaperMap:
        """Of a filter with a step of dt seconds, in the low-pass form or the general one."""
        n = filter.order
        p = filter.a if lowpass else np.concatenate([filter.a, filter.b])
        origin = _assemble(np.zeros(len(p)), n, lowpass=lowpass)
        ends = [_assemble(unit, n, lowpass=lowpass) for unit in np.eye(len(p))]
        slopes = [np.stack([end[i] - origin[i] for end in ends]) for i in range(len(origin))]
        size = len(origin.H)
        shift = np.zeros((size, size))
        shift[np.arange(n - 1), np.arange(1, n)] = 1.0
        for first in range(n, size, max(n - 1, 1)):  # each chain of integrals
            rows = np.arange(first + 1, first + n - 1)
            shift[rows, rows - 1] = 1.0
        return cls(dt, shift, _assemble(p, n, lowpass=lowpass), Matrices(*slopes))

    def forward(self, v: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """f_hat (N, K) and the states of each sample, (s, K), for v (N, 3, K)."""
        now, h = self.now, self.dt
        f_hat, states = np.empty(v[:, _X].shape), [now.start[:, None] * v[0, _X]]
        for k in range(len(v)):
            f_hat[k] = now.H @ states[k] + now.J @ v[k]
            states.append(states[k] + h * (self.shift @ states[k] + now.c[:, None] * f_hat[k] + now.P @ v[k]))
        return f_hat, states[:-1]

    def backward(
        self, v: FloatArray, f_hat: FloatArray, states: list[FloatArray], r: FloatArray
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
        """Gradient of sum(r * f_hat) in the coefficients, and in x, g and f_theta."""
        now, slopes, h = self.now, self.slopes, self.dt
        N = len(r)
        costates = np.zeros((N + 1, *states[0].shape))
        q = np.empty(r.shape)  # cotangent of f_hat: as the output, and as what is fed back
        for k in range(N - 1, -1, -1):
            after = costates[k + 1]
            q[k] = r[k] + h * (now.c @ after)
            costates[k] = after + h * (self.shift.T @ after) + now.H[:, None] * q[k]
        s = np.stack(states)
        after = costates[1:]
        gradient = (
            np.einsum("ps,ks->p", slopes.H, np.einsum("ksc,kc->ks", s, q))
            + np.einsum("pi,ki->p", slopes.J, np.einsum("kic,kc->ki", v, q))
            + h * np.einsum("ps,ks->p", slopes.c, np.einsum("ksc,kc->ks", after, f_hat))
            + h * np.einsum("psi,si->p", slopes.P, np.einsum("ksc,kic->si", after, v))
            + slopes.start @ (costates[0] @ v[0, _X])
        )
        inward = now.J[None, :, None] * q[:, None] + h * np.einsum("si,ksc->kic", now.P, after)
        inward[0, _X] += now.start @ costates[0]
        return gradient, (inward[:, _X], inward[:, _G], inward[:, _F])


def _assemble(p: FloatArray, n: int, *, lowpass: bool) -> Matrices:
    """Matrices for coefficients p = a, or (a, b); affine in p."""
    a, b = p[:n], p[n:]
    chains = 3 if lowpass else 4  # integrals of f_hat, f_theta, x, and of g in the general form
    size = n + chains * (n - 1)
    first = [n + i * (n - 1) for i in range(chains)]
    H, J, c, P, start = np.zeros(size), np.zeros(3), np.zeros(size), np.zeros((size, 3)), np.zeros(size)
    J[_F] = 1.0
    H[first[0] : first[0] + n - 1] = -a[:0:-1]
    if lowpass:
        H[0] = a[0]
        H[first[1] : first[1] + n - 1] = a[:0:-1]
        c[n - 1], P[n - 1, _G], start[n - 1] = -1.0, -1.0, -1.0
    else:
        H[0] = 1.0
        H[first[1] : first[1] + n - 1] = (a - b)[:0:-1]
        H[first[3] : first[3] + n - 1] = -b[:0:-1]
        c[n - 1], P[n - 1, _G], P[n - 1, _F] = -a[0], -b[0], a[0] - b[0]
        start[:n] = -b[::-1]
    # The j-th integral of x enters with b_{n-1-j}: the 0-th, x itself, through J.
    weights = np.append(np.zeros(n - 1), a[0]) if lowpass else b[::-1]
    J[_X] = weights[0]
    H[first[2] : first[2] + n - 1] = weights[1:]
    if n > 1:
        c[first[0]], P[first[1], _F], P[first[2], _X] = 1.0, 1.0, 1.0
        if not lowpass:
            P[first[3], _G] = 1.0
    return Matrices(H, J, c, P, start)
