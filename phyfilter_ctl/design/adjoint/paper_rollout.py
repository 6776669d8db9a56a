"""The paper's own realisation, Eq. (5) under forward Euler, with the derivatives that Algorithm 1 asks for.

    s_{k+1} = s_k + h (S s_k + c f_hat_k + P v_k),    f_hat_k = H s_k + J v_k,    v = (x, g, f_theta)

s stacks xi and its derivatives and the integrals of f_hat, f_theta, x (and g in the general form). H, J, c, P and the
start are affine in the coefficients, so their derivatives are exact differences. One step of a loop per sample: this
realisation loses its digits over long records and is rolled out over short ones only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..._sections import FloatArray
from ...filter import PaperFilter
from ...filter.paper_form import PaperMatrices, paper_matrices

_X, _G, _F = range(3)


@dataclass(frozen=True)
class PaperMap:
    """The realisation with the derivatives of its matrices (first axis) in a, then b in the general form."""

    paper: PaperFilter
    slopes: PaperMatrices

    @classmethod
    def build(cls, paper: PaperFilter, *, lowpass: bool) -> PaperMap:
        """Of a filter in the low-pass form or the general one."""
        n, count = paper.order, paper.order if lowpass else 2 * paper.order
        origin = paper_matrices(np.zeros(count), n, lowpass=lowpass)
        ends = [paper_matrices(unit, n, lowpass=lowpass) for unit in np.eye(count)]
        slopes = [np.stack([end[i] - origin[i] for end in ends]) for i in range(len(origin))]
        return cls(replace(paper, general=not lowpass), PaperMatrices(*slopes))

    def forward(self, v: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """f_hat (N, K) and the states of each sample, (s, K), for v (N, 3, K)."""
        state = self.paper.start(v[0, _X], f_theta0=v[0, _F])
        f_hat, states = v[:, _F].copy(), [np.asarray(state.s, dtype=float)]
        for k in range(1, len(v)):
            state, f_hat[k] = self.paper.step(state, v[k, _X], v[k - 1, _G], v[k, _F])
            states.append(np.asarray(state.s, dtype=float))
        return f_hat, states

    def backward(
        self, v: FloatArray, f_hat: FloatArray, states: list[FloatArray], r: FloatArray
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
        """Gradient of sum(r * f_hat) in the coefficients, and in x, g and f_theta."""
        now, slopes, h = self.paper.matrices, self.slopes, self.paper.dt
        N = len(r)
        costates = np.zeros((N + 1, *states[0].shape))
        q = np.empty(r.shape)  # cotangent of f_hat: as the output, and as what is fed back
        for k in range(N - 1, -1, -1):
            after = costates[k + 1]
            q[k] = r[k] + h * (now.c @ after)
            costates[k] = after + h * (self.paper.shift.T @ after) + now.H[:, None] * q[k]
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
