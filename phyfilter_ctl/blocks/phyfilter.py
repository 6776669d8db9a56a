"""The filter as python-control blocks, to be wired with ``control.interconnect`` like any other system."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray, continuous_matrices
from ..filter import PhyFilter, SampledPhyFilter
from ..filter.matrices import (
    channel_counts,
    checked_learned,
    constant_inertia,
    refuse_nonlinear,
    sampled_matrices,
    signal_labels,
    state_labels,
)

__all__ = ["PhyFilterBlock", "phyfilter_block"]


class PhyFilterBlock(ct.StateSpace):
    """A PhyFilter as a python-control state-space system; made by :func:`phyfilter_block`.

    It behaves as any ``control.StateSpace``; beyond that it knows the state of a bumpless start.

    Parameters
    ----------
    matrices : tuple of arrays
        A, B, C and D.
    rest : (states, inputs) array
        Maps the first inputs to the state of rest.
    dt : float
        0 for a continuous block, else the sampling interval in seconds.
    **names
        ``inputs``, ``outputs``, ``states`` and ``name`` as for ``control.ss``.
    """

    updfcn: Callable[..., FloatArray]
    outfcn: Callable[..., FloatArray]

    def __init__(self, matrices: tuple[FloatArray, ...], rest: FloatArray, dt: float, **names: Any) -> None:
        super().__init__(*matrices, dt, remove_useless_states=False, **names)
        self._rest = rest
        # Instead of python-control's lambdas, which neither pickle nor follow a copy.
        self.updfcn, self.outfcn = self._update, self._put_out

    def _update(self, t: float, x: ArrayLike, u: ArrayLike, params: Any = None) -> FloatArray:
        return self.dynamics(t, x, u)

    def _put_out(self, t: float, x: ArrayLike, u: ArrayLike, params: Any = None) -> FloatArray:
        return self.output(t, x, u)

    @property
    def optional_inputs(self) -> tuple[str, ...]:
        """Labels of inputs that a diagram may leave at 0: those of the learned model."""
        return tuple(label for label in self.input_labels if label.startswith("f_theta["))

    def rest_state(
        self, x0: ArrayLike, g0: ArrayLike | None = None, f_theta0: ArrayLike | None = None
    ) -> FloatArray:
        """Initial state for ``control.input_output_response`` with which f_hat starts at f_theta.

        Parameters
        ----------
        x0, g0 : (n_x,) arrays
            Measurement and known part at the first sample; None means 0.
        f_theta0 : (n_f,) array, optional
            Learned model at the first sample; none for a block without f_theta.

        Returns
        -------
        (states,) array

        Raises
        ------
        ValueError
            For wrong shapes.

        Examples
        --------
        >>> block = phyfilter_block(PhyFilter([20.0]), 1)
        >>> block.rest_state([3.0]).tolist()
        [-60.0]
        """
        counts = [sum(label.startswith(signal + "[") for label in self.input_labels) for signal in _INPUTS]
        first = []
        for signal, count, value in zip(_INPUTS, counts, (x0, g0, f_theta0), strict=True):
            given = np.zeros(count) if value is None else np.atleast_1d(_signals.real(f"{signal}0", value))
            first.append(_signals.array(f"{signal}0", given, (count,)))
        return self._rest @ np.concatenate(first)


_INPUTS = ("x", "g", "f_theta")


def phyfilter_block(
    filter: PhyFilter | SampledPhyFilter | Sequence[PhyFilter],
    channels: int | None = None,
    *,
    name: str = "phyfilter",
    inertia: ArrayLike | None = None,
    f_theta: bool = True,
) -> PhyFilterBlock:
    """A filter as a python-control system with named signals.

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter or sequence of PhyFilter
        A continuous filter gives a continuous block, a sampled one a discrete block at its rate; a sequence one
        filter per channel.
    channels : int, optional
        Number n_x of channels of x; needed where neither the filter's ``sampling``, E nor one filter per channel tells
        it.
    name : str
        Name of the block.
    inertia : float, (n_x,) or (n_x, n_x) array, optional
        Constant inertia M_hat; None takes that of a sampled filter's ``sampling``, else I.
    f_theta : bool
        Whether the block has inputs for a learned model. They may be left open in a diagram; f_theta is then 0.

    Returns
    -------
    PhyFilterBlock
        Inputs x[0] ..., g[0] ..., f_theta[0] ...; outputs f_hat[0] ...

    Raises
    ------
    TypeError
        For an ``f_theta`` that is no bool.
    ValueError
        For a missing or contradictory number of channels, a wrong inertia, or a sampled filter with an option that no
        linear block has (limit, g_limit, nonfinite="hold").

    Notes
    -----
    Continuous: z = w - B M x takes the place of the section states w, so x is not differentiated. Sampled: the n
    states of a channel are what the samples up to now add to the next one; a delayed measurement adds a shift
    register of g and f_theta. With ``g="hold"``, ``run``, blocks and FMUs take the g that acts from this sample on (the
    block keeps it and uses it at the next one); ``step``, ``live.step`` and C take the g that acted since the last
    sample. With ``g="average"`` all take g at this sample.

    Examples
    --------
    A mass pushed by an unknown constant 3 N, without a learned model; the filter finds the force.

    >>> import control as ct
    >>> plant = ct.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], inputs="f[0]", outputs="x[0]", name="mass")
    >>> loop = ct.interconnect([plant, phyfilter_block(PhyFilter([20.0]), 1, f_theta=False)],
    ...                        inputs=["f[0]", "g[0]"], outputs=["f_hat[0]"])
    >>> response = ct.forced_response(loop, [0.0, 1.0], [[3.0, 3.0], [0.0, 0.0]])
    >>> float(response.outputs[0, -1].round(6))
    3.0
    """
    checked_learned(f_theta)
    if isinstance(filter, SampledPhyFilter):
        refuse_nonlinear(filter.recursion)
        filters, direction = filter.filters, filter.E
        channels, inertia = filter.sampling.channels_or(channels), filter.sampling.inertia_or(inertia)
    else:
        filters = (filter,) if isinstance(filter, PhyFilter) else tuple(filter)
        direction = None
    n_x, n_f = channel_counts(len(filters), direction, channels)
    filters = filters * n_f if len(filters) == 1 else filters
    E_left = filter.recursion.E_left if isinstance(filter, SampledPhyFilter) else None
    E_left = np.eye(n_x) if E_left is None else E_left
    momentum = E_left @ constant_inertia(inertia, n_x)
    if isinstance(filter, SampledPhyFilter):
        matrices, rest = sampled_matrices(filter.recursion, momentum, E_left, f_theta)
        dt = filter.dt
    else:
        matrices, rest = continuous_matrices([entry.sections for entry in filters], momentum, E_left, f_theta)
        dt = 0.0
    inputs, outputs = signal_labels(n_x, n_f, f_theta)
    return PhyFilterBlock(
        matrices,
        rest,
        dt,
        inputs=inputs,
        outputs=outputs,
        states=state_labels([entry.order for entry in filters], len(matrices[0])),
        name=name,
    )
