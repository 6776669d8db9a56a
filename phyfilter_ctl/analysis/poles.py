"""Where the poles and zeros of filters are, in the s-plane or, sampled, in the z-plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import control as ct
import numpy as np
from matplotlib.axes import Axes

from .._sections import ComplexArray
from ..filter import PhyFilter, SampledPhyFilter
from ..plots.poles import PoleSet, pole_plot
from .channels import Filter

__all__ = ["PoleZeroMap", "PolesAndZeros", "poles_of"]


@dataclass(frozen=True, eq=False)
class PolesAndZeros:
    """Poles and zeros of one filter; ``pole_zero_map`` of a response.

    Attributes
    ----------
    system : PhyFilter or SampledPhyFilter
    poles : (n,) complex array
        In rad/s; of a sampled filter in the z-plane.
    zeros : complex array
        Of F. Sampled: of F_d(z) from u_k, the residual averaged over a step, to f_hat_k - f_theta_k.
    error_zeros : complex array
        Of 1 - F: the complex frequencies of residuals that are followed without error. Empty for a sampled filter.
    label : str
        Order, band and step in words, as the legend has them.
    """

    system: Filter
    poles: ComplexArray
    zeros: ComplexArray
    error_zeros: ComplexArray
    label: str


class PoleZeroMap(tuple[PolesAndZeros, ...]):
    """Poles and zeros of several filters; a tuple that can draw itself."""

    def plot(self, ax: Axes | None = None, *, labels: Sequence[str] | None = None) -> ct.ControlPlot:
        """Draw all of them over lines of equal damping and natural frequency.

        Parameters
        ----------
        ax : Axes, optional
            Where to draw; None makes a new figure.
        labels : sequence of str, optional
            One entry of the legend each instead of the filters' own.

        Returns
        -------
        control.ControlPlot

        Raises
        ------
        ValueError
            If there are more or fewer labels than filters, or continuous and sampled filters are mixed.
        """
        if labels is not None and len(labels) != len(self):
            raise ValueError(f"labels: expected one for each of the {len(self)} filters, got {len(labels)}")
        names = [entry.label for entry in self] if labels is None else labels
        sets = [
            PoleSet(name, each.poles, each.zeros, each.error_zeros, _step(each.system))
            for name, each in zip(names, self, strict=True)
        ]
        return pole_plot(sets, ax=ax)


def poles_of(system: Filter, label: str) -> PolesAndZeros:
    """Poles and zeros of a filter.

    Parameters
    ----------
    system : PhyFilter or SampledPhyFilter
    label : str
        In a legend.

    Returns
    -------
    PolesAndZeros

    Notes
    -----
    A pole p becomes e^{ph} (exact), 1 + ph (Euler) or (1 + ph/2)/(1 - ph/2) (Tustin). u_k is the average over the
    step that ends at k, so every F_d has a zero at z = 0. Euler's others are 1 + hs of the zeros s of F, Tustin's
    (1 + hs/2)/(1 - hs/2), and for n - m > 1 more at z = -1. The exact method's n - 1 others have no such form: they
    are those of the sampled system, eigenvalues of dA - B C dA / (C B). A known delay of x adds poles at z = 0 that
    are left out.

    Examples
    --------
    >>> from phyfilter_ctl import frequency_response
    >>> filter = PhyFilter([400.0, 40.0], [400.0, 40.0])
    >>> both = frequency_response([filter, PhyFilter([25.0, 6.0])]).pole_zero_map
    >>> both[0].zeros.real.tolist(), both[0].error_zeros.real.tolist()
    ([-10.0], [0.0, 0.0])
    >>> both[1].poles.tolist()
    [(-3+4j), (-3-4j)]
    >>> frequency_response(filter.sampled(0.01, "euler")).pole_zero_map[0].zeros.real.round(12).tolist()
    [0.0, 0.9]
    """
    return _sampled(system, label) if isinstance(system, SampledPhyFilter) else _continuous(system, label)


def _step(system: Filter) -> float | None:
    return system.dt if isinstance(system, SampledPhyFilter) else None


def _continuous(filter: PhyFilter, label: str) -> PolesAndZeros:
    # The zeros at s = 0 are exact in the coefficients; the roots of the rest are found apart from them.
    rest = filter.error_numerator[filter.type :]
    error_zeros = np.concatenate([np.zeros(filter.type), np.roots(rest[::-1])]).astype(np.complex128)
    return PolesAndZeros(filter, filter.poles, filter.zeros, error_zeros, label)


def _sampled(system: SampledPhyFilter, label: str) -> PolesAndZeros:
    filter, h = system.filter, system.dt
    none, at_zero = np.zeros(0, dtype=np.complex128), np.zeros(1, dtype=np.complex128)
    if system.sampling.method == "euler":
        poles, zeros = 1.0 + filter.poles * h, 1.0 + filter.zeros * h
    elif system.sampling.method == "tustin":
        poles, zeros = _tustin(filter.poles * h), _tustin(filter.zeros[filter.zeros != 2.0 / h] * h)
        zeros = np.concatenate([zeros, -np.ones(filter.order - len(filter.zeros) - 1)])
    else:
        poles = np.exp(filter.poles * h)
        zeros = _zeros_of_exact(system) if filter.order > 1 else none
    every = np.concatenate([at_zero, zeros]).astype(np.complex128)
    return PolesAndZeros(system, poles, every, none, label)


def _tustin(values: ComplexArray) -> ComplexArray:
    return (1.0 + 0.5 * values) / (1.0 - 0.5 * values)


def _zeros_of_exact(system: SampledPhyFilter) -> ComplexArray:
    """z at which C (zI - I - dA)^{-1} B = 0: the dynamics that hold the output at zero, less the output itself."""
    dA, equilibrium, C = system.transition
    B = -dA @ equilibrium
    held = np.linalg.eigvals(dA - np.outer(B, C @ dA) / (C @ B))
    return 1.0 + np.delete(held, np.argmin(np.abs(held))).astype(np.complex128)
