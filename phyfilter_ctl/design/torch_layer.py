"""The filter as a layer of PyTorch: forwards the sampled filter, backwards the same filter run back in time.

Both passes are one call into the block recursion of this package, not a loop of tensors. Needs the extra ``torch``.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

try:
    import torch
except ImportError as _error:
    raise ImportError(
        "phyfilter_ctl.design.torch_layer needs PyTorch: install it with pip install 'phyfilter-ctl[torch]'"
    ) from _error

from .._sections import FloatArray
from ..filter import PhyFilter, SampledPhyFilter
from ..filter.sampling import Method, Rule
from .adjoint.rollout import Form, Rollout
from .learning.parametrisation import chain_of

__all__ = ["PhyFilterLayer", "filter_signals"]


def filter_signals(
    x: torch.Tensor,
    g: torch.Tensor | None,
    f_theta: torch.Tensor | None,
    *,
    a: torch.Tensor,
    b: torch.Tensor | None = None,
    sampled: SampledPhyFilter,
) -> torch.Tensor:
    """f_hat of a record, differentiable in the coefficients and in the signals.

    Parameters
    ----------
    x : (N, n_x) or (batch, N, n_x) tensor
        Measured signal, equal steps; records of a batch each start at rest.
    g, f_theta : tensors of the shape of x, optional
        Known part of M x', and learned model of f; None means 0.
    a : (n,) tensor
        Ascending coefficients of D.
    b : (n,) tensor, optional
        Ascending coefficients of N; None means the low-pass form, where b_0 = a_0 moves with a.
    sampled : SampledPhyFilter
        How it is sampled; its own coefficients are not used.

    Returns
    -------
    tensor of the shape of x
        In its dtype; computed in double precision.

    Raises
    ------
    ValueError
        If shapes disagree, a value is not finite, or D is not Hurwitz; and as for :class:`Rollout`.

    Examples
    --------
    >>> import torch
    >>> a = torch.tensor([20.0], dtype=torch.float64, requires_grad=True)
    >>> x = torch.linspace(0.0, 1.0, 11, dtype=torch.float64)[:, None]
    >>> filter_signals(x, None, None, a=a, sampled=PhyFilter([20.0]).sampled(0.01)).sum().backward()
    >>> round(a.grad.item(), 6)
    1.543208
    """
    if x.ndim not in (2, 3):
        raise ValueError(f"x: expected shape (N, n_x) or (batch, N, n_x), got {tuple(x.shape)}")
    zero = torch.zeros_like(x)
    signals = [zero if part is None else part for part in (g, f_theta)]
    for name, part in zip(("g", "f_theta"), signals, strict=True):
        if part.shape != x.shape:
            raise ValueError(f"{name}: expected the shape {tuple(x.shape)} of x, got {tuple(part.shape)}")
    if sampled.E is not None:
        raise ValueError("sampled: a layer has one f a channel, got E; project the signals before it")
    return _Filter.apply(x, *signals, a, b, sampled)


class PhyFilterLayer(torch.nn.Module):
    """A filter with trainable coefficients between a model f_theta and what is done with f_hat.

    Parameters
    ----------
    filter : PhyFilter
        Where to start.
    dt : float
        Sampling interval in seconds.
    form : {"lowpass", "general"}, optional
        Whether b_0 = a_0 moves with a, or a and b are free; None takes the form of the filter.
    coordinates : {"hurwitz", "coefficients"}
        What is trained: the logarithms of Routh's ratios of D (parameter ``theta``), stable for all values, and b over
        its scale (``b_scaled``); or the coefficients ``a`` and ``b`` themselves, which may leave the stable region.
    method, g, f_theta
        As for :class:`SampledPhyFilter`.

    Raises
    ------
    ValueError
        For options out of range.

    Examples
    --------
    >>> import torch
    >>> layer = PhyFilterLayer(PhyFilter([400.0, 40.0]), 0.002)
    >>> layer(torch.zeros(8, 100, 3)).shape
    torch.Size([8, 100, 3])
    >>> layer.filter()
    PhyFilter(a=[400.0..., 40.0...])
    """

    scale: torch.Tensor  # of b beside logarithms
    theta: torch.nn.Parameter
    b_scaled: torch.nn.Parameter | None
    a: torch.nn.Parameter
    b: torch.nn.Parameter | None

    def __init__(
        self,
        filter: PhyFilter,
        dt: float,
        *,
        form: Form | None = None,
        coordinates: Literal["hurwitz", "coefficients"] = "hurwitz",
        method: Method = "exact",
        g: Rule = "hold",
        f_theta: Rule = "average",
    ) -> None:
        super().__init__()
        if coordinates not in ("hurwitz", "coefficients"):
            raise ValueError(f"coordinates: expected 'hurwitz' or 'coefficients', got {coordinates!r}")
        self.sampled: SampledPhyFilter = filter.sampled(dt, method=method, g=g, f_theta=f_theta)
        self.form = Rollout(self.sampled, form=form).form
        self.coordinates = coordinates
        n = filter.order
        scale = torch.from_numpy(filter.a[0] ** (np.arange(n, 0, -1) / n))
        general = self.form == "general"
        self.register_buffer("scale", scale, persistent=False)
        if coordinates == "hurwitz":
            self.theta = torch.nn.Parameter(torch.from_numpy(chain_of(filter.poles).theta.copy()))
            self.b_scaled = torch.nn.Parameter(torch.from_numpy(filter.b.copy()) / scale) if general else None
        else:
            self.a = torch.nn.Parameter(torch.from_numpy(filter.a.copy()))
            self.b = torch.nn.Parameter(torch.from_numpy(filter.b.copy())) if general else None

    def coefficients(self) -> tuple[torch.Tensor, torch.Tensor | None]:
        """a (n,) and b (n,), differentiable in the parameters; b is None in the low-pass form."""
        if self.coordinates == "coefficients":
            return self.a, self.b
        a = _routh(self.theta)
        return a, None if self.b_scaled is None else self.b_scaled * self.scale

    def filter(self) -> PhyFilter:
        """The filter at the present parameters."""
        with torch.no_grad():
            a, b = self.coefficients()
        return PhyFilter(_array(a), None if b is None else _array(b))

    def forward(
        self, x: torch.Tensor, g: torch.Tensor | None = None, f_theta: torch.Tensor | None = None
    ) -> torch.Tensor:
        """f_hat.

        Parameters
        ----------
        x, g, f_theta
            As for :func:`filter_signals`.
        """
        a, b = self.coefficients()
        return filter_signals(x, g, f_theta, a=a, b=b, sampled=self.sampled)


def _routh(theta: torch.Tensor) -> torch.Tensor:
    """Ascending a (n,) of D from log d, log k_1 ...: minors P_{j+1} = s P_j + k^2 P_{j-1}, the last with d as well."""
    n = len(theta)
    squares, d = torch.exp(2.0 * theta), torch.exp(theta[0])
    zero = theta.new_zeros(1)
    older, old = theta.new_zeros(n + 1), torch.nn.functional.pad(theta.new_ones(1), (0, n))
    for j in range(1, n + 1):
        new = torch.cat([zero, old[:-1]])
        if j > 1:
            new = new + squares[n - j + 1] * older
        if j == n:
            new = new + d * old
        older, old = old, new
    return old[:n]


class _Filter(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        x: torch.Tensor,
        g: torch.Tensor,
        f_theta: torch.Tensor,
        a: torch.Tensor,
        b: torch.Tensor | None,
        sampled: SampledPhyFilter,
    ) -> torch.Tensor:
        filter = PhyFilter(_array(a), None if b is None else _array(b))
        rollout = Rollout(sampled.with_filter(filter), form="lowpass" if b is None else "general")
        trace = rollout.forward(rollout.inputs(*(_side_by_side(part) for part in (x, g, f_theta))))
        ctx.rollout, ctx.trace, ctx.shape = rollout, trace, x.shape
        ctx.kinds = [(part.device, part.dtype) for part in (x, g, f_theta, a, a if b is None else b)]
        return _batched(trace.f_hat, x.shape).to(x)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]  # the decorator hides the name of ctx
        ctx: Any, *grad_outputs: torch.Tensor
    ) -> tuple[torch.Tensor | None, ...]:
        (cotangent,) = grad_outputs
        signals = any(ctx.needs_input_grad[:3])
        back = ctx.rollout.backward(ctx.trace, _side_by_side(cotangent), signals=signals)
        inward = [
            None if part is None else _batched(part, ctx.shape) for part in (back.x, back.g, back.f_theta)
        ]
        inward += [None if part is None else torch.from_numpy(part) for part in (back.a, back.b)]
        moved = [
            None if part is None else part.to(*kind) for part, kind in zip(inward, ctx.kinds, strict=True)
        ]
        return *moved, None


def _array(tensor: torch.Tensor) -> FloatArray:
    return tensor.detach().cpu().numpy().astype(float)


def _side_by_side(tensor: torch.Tensor) -> FloatArray:
    """(N, n_x), or (batch, N, n_x) with the records as further channels: (N, batch n_x)."""
    array = _array(tensor)
    return array if array.ndim == 2 else array.transpose(1, 0, 2).reshape(array.shape[1], -1)


def _batched(array: FloatArray, shape: torch.Size) -> torch.Tensor:
    if len(shape) == 3:
        array = array.reshape(shape[1], shape[0], shape[2]).transpose(1, 0, 2)
    return torch.from_numpy(np.ascontiguousarray(array))
