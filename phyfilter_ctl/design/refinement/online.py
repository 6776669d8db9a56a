"""Refinement in flight: least squares with forgetting between the filtered residual and the filtered model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from ... import _signals
from ..._sections import FloatArray
from ...filter import FilterState, SampledPhyFilter
from ...learned import LearnedModel
from ...recording import Recording
from . import regression
from .regression import Tuned

__all__ = ["Knowledge", "OnlineFlight", "OnlineRefiner", "OnlineState"]

M = TypeVar("M", bound=LearnedModel)

# Numbers in one batch of information matrices: 16 MB.
_BATCH = 2_000_000


class Knowledge(NamedTuple):
    """What the flight so far says of the p moving parameters; handed on from flight to flight."""

    information: FloatArray  # (p, p) faded sum of Phi' Phi
    moment: FloatArray  # (p,) faded sum of Phi' y


class OnlineState(NamedTuple):
    """All that :class:`OnlineRefiner` remembers of one sample. Immutable."""

    target: FilterState  # filter behind the model as it was at first
    regressors: FilterState  # one filter for every derivative of f_theta
    knowledge: Knowledge
    change: FloatArray  # (p,) change of the moving parameters in use
    samples: int  # samples since the start


@dataclass(frozen=True)
class OnlineFlight:
    """What a model refined in flight and the filter behind it gave.

    Attributes
    ----------
    f_theta, f_hat : (N, n_x) arrays
        Row k: with the parameters of the samples before k.
    parameters : (K + 1, p) array
        Moving parameters at the start and after each update.
    updates : (K + 1,) array
        Sample after which each row came to be.
    knowledge : Knowledge
        For the next flight.
    """

    f_theta: FloatArray
    f_hat: FloatArray
    parameters: FloatArray
    updates: NDArray[np.intp]
    knowledge: Knowledge


@dataclass(frozen=True, eq=False)
class OnlineRefiner(Generic[M]):
    """Recursive least squares with forgetting on a model linear in its moving parameters.

        min_d  sum_i w_i |y_i - Phi_i d|^2 + d' P_0 d,    w_i = (1 - q) q^(k - i),    q = exp(-dt / forgetting)

    y = F (M x' - g - f_theta0), Phi = F (d f_theta / d theta): both filtered alike, so nothing is late. P_0, from
    ``trust`` and ``memory``, does not fade, so that directions which the flight does not excite return to the model
    given instead of winding up. The estimate is f_hat = f_theta + y - Phi d, what the filter would give had the
    present parameters always been there: of an update only what the filter would not have followed moves it, (1 - F)
    of the change along the flight, where f_theta passed to a running filter moves it by the whole change.

    Parameters
    ----------
    model : LearnedModel
        A fitted model.
    filter : SampledPhyFilter
        The filter behind it.
    trainable : slice or array_like of int, optional
        Parameters that move, in which the model must be linear; None for all.
    memory : array_like, shape (N_m, n_z), optional
        Features at which the model shall keep its predictions.
    keep : float
        Weight of that; the weights of the samples sum up to 1.
    trust : float
        Weight of |d|^2.
    forgetting : float
        Time constant in s over which samples fade.
    every : int
        Samples between updates.

    Attributes
    ----------
    tuned : Tuned
        The model and the places of its moving parameters.

    Raises
    ------
    ValueError, TypeError
        As for :func:`refine`.

    Notes
    -----
    L. Ljung, "System Identification", 2nd ed., 1999, section 11.2, in information form. Only a step that
    updates costs more than the filters: one p x p solution.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> from phyfilter_ctl.design.refinement.refine_model import last_layer
    >>> from phyfilter_ctl.learned import Network
    >>> z = np.linspace(-1.0, 1.0, 200)[:, None]
    >>> model = Network((5,), seed=1).fit(z, z).model
    >>> refiner = OnlineRefiner(model, PhyFilter([5.0]).sampled(0.01), trainable=last_layer(model))
    >>> state = refiner.start([0.0])
    >>> state, f_theta, f_hat = refiner.step(state, [0.0], [0.0], z=[0.0])
    >>> bool(abs(f_theta[0]) < 0.01), state.samples
    (True, 1)
    """

    model: M
    filter: SampledPhyFilter
    _: KW_ONLY
    trainable: slice | ArrayLike | None = None
    memory: ArrayLike | None = None
    keep: float = 1.0
    trust: float = 1e-3
    forgetting: float = 30.0
    every: int = 10
    tuned: Tuned[M] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("trust", "forgetting"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name}: expected a finite number > 0, got {value!r}")
        if not (np.isfinite(self.keep) and self.keep >= 0.0):
            raise ValueError(f"keep: expected a finite number >= 0, got {self.keep!r}")
        if isinstance(self.every, bool) or not isinstance(self.every, int) or self.every < 1:
            raise ValueError(f"every: expected a whole number of samples >= 1, got {self.every!r}")
        object.__setattr__(self, "filter", regression.checked_filter(self.filter))
        if self.memory is not None:
            kept = _signals.real("memory", self.memory)
            if kept.ndim != 2 or 0 in kept.shape or not np.isfinite(kept).all():
                raise ValueError(f"memory: expected finite features of shape (N_m, n_z), got {kept.shape}")
            object.__setattr__(self, "memory", kept)
        object.__setattr__(self, "tuned", Tuned.of(self.model, self.trainable))

    @property
    def kept(self) -> FloatArray | None:
        """``memory`` as an array (N_m, n_z)."""
        return None if self.memory is None else np.asarray(self.memory, dtype=float)

    @cached_property
    def _prior(self) -> FloatArray:
        prior = self.trust * np.eye(self.tuned.count)
        if (kept := self.kept) is not None:
            rows = self.tuned.regressors(kept).reshape(-1, self.tuned.count)
            prior += self.keep / len(kept) * (rows.T @ rows)
        return prior

    @property
    def _fading(self) -> float:
        return float(np.exp(-self.filter.dt / self.forgetting))

    def change(self, knowledge: Knowledge | None) -> FloatArray:
        """Best change (p,) of the moving parameters.

        Parameters
        ----------
        knowledge : Knowledge or None
            None means before any flight: no change.
        """
        if knowledge is None:
            return np.zeros(self.tuned.count)
        return np.asarray(np.linalg.solve(knowledge.information + self._prior, knowledge.moment), dtype=float)

    def refined(self, knowledge: Knowledge | None) -> M:
        """The model with that change.

        Parameters
        ----------
        knowledge : Knowledge or None
            As for :meth:`change`.
        """
        return self.tuned.moved(self.change(knowledge))

    # -- sample by sample -----------------------------------------------------------------------------------------

    def start(self, x0: ArrayLike, *, knowledge: Knowledge | None = None) -> OnlineState:
        """State at the first sample.

        Parameters
        ----------
        x0 : array_like, shape (n_x,)
            First measurement.
        knowledge : Knowledge, optional
            Of the flights before.
        """
        target = self.filter.start(x0)
        channels, p = len(target.f_theta), self.tuned.count
        bank = self._bank(channels)
        known = Knowledge(np.zeros((p, p)), np.zeros(p)) if knowledge is None else knowledge
        return OnlineState(target, bank.start(np.zeros(channels * p)), known, self.change(knowledge), 0)

    def step(
        self,
        state: OnlineState,
        x: ArrayLike,
        g: ArrayLike | None = None,
        *,
        z: ArrayLike,
        inertia: ArrayLike | None = None,
    ) -> tuple[OnlineState, FloatArray, FloatArray]:
        """Advance by one sample; pure. The first call, at the sample of ``start``, only sets the model's values.

        Parameters
        ----------
        state : OnlineState
        x, g, inertia
            As for :meth:`SampledPhyFilter.step`.
        z : array_like, shape (n_z,)
            Features now.

        Returns
        -------
        state : OnlineState
        f_theta, f_hat : (n_x,) arrays
            With the parameters of the samples before.

        Raises
        ------
        ValueError, TypeError
            As for :meth:`SampledPhyFilter.step` and for the model.
        """
        features = _signals.array("z", z, ("n_z",))
        f_first = self.model.predict(features[None])[0]
        columns = self.tuned.regressors_at(features)
        bank = self._bank(len(f_first))
        if state.samples == 0:
            target = self.filter.start(x, f_theta0=f_first, g0=g, inertia0=inertia)
            regressors = bank.start(np.zeros(columns.size), f_theta0=columns.ravel())
            f_theta = f_first + columns @ state.change
            return state._replace(target=target, regressors=regressors, samples=1), f_theta, f_theta.copy()
        target, f_hat_first = self.filter.step(state.target, x, g, f_first, inertia=inertia)
        still = np.zeros(columns.size)
        regressors, passed = bank.step(state.regressors, still, still, columns.ravel())
        left = np.asarray(passed, dtype=float).reshape(columns.shape)
        Phi, y = columns - left, f_hat_first - f_first
        q = self._fading
        known = Knowledge(
            q * state.knowledge.information + (1.0 - q) * (Phi.T @ Phi),
            q * state.knowledge.moment + (1.0 - q) * (Phi.T @ y),
        )
        change = self.change(known) if state.samples % self.every == 0 else state.change
        f_theta, f_hat = f_first + columns @ state.change, f_hat_first + left @ state.change
        return OnlineState(target, regressors, known, change, state.samples + 1), f_theta, f_hat

    def _bank(self, channels: int) -> SampledPhyFilter:
        """The filter on the derivatives: channel after channel, p of each."""
        filters = self.filter.filters
        if len(filters) == 1:
            return replace(self.filter, sampling=replace(self.filter.sampling, E=None))
        return replace(
            self.filter,
            sampling=replace(self.filter.sampling, E=None),
            filters=[entry for entry in filters for _ in range(self.tuned.count)],
        )

    # -- whole flights ------------------------------------------------------------------------------------------

    def run(self, log: Recording, *, knowledge: Knowledge | None = None) -> OnlineFlight:
        """What :meth:`step` gives over a flight, without a loop over its samples.

        Parameters
        ----------
        log : Recording
            With features, sampled at the filter's rate.
        knowledge : Knowledge, optional
            Of the flights before.

        Raises
        ------
        ValueError, TypeError
            As for :func:`refine`.
        """
        (log,) = regression.checked_logs("log", log, self.filter.dt)
        z = regression.features_of(log)
        if not self.tuned.is_linear(z):
            raise ValueError(
                "online refinement needs a model linear in its moving parameters: pass trainable=last_layer(network), "
                "or refine offline"
            )
        f_first = self.model.predict(z)
        y = regression.correction(self.filter, log, f_first)
        columns = self.tuned.regressors(z)
        Phi = regression.filtered(self.filter, columns)
        with threadpool_limits(1, user_api="blas"):  # many small products, slower on several threads
            changes, last = self._changes(Phi[1:], y[1:], knowledge)
        in_use = changes[np.maximum(np.arange(log.n) - 1, 0) // self.every]
        moved = np.einsum("kij,kj->ki", columns, in_use)
        return OnlineFlight(
            f_first + moved,
            f_first + y + moved - np.einsum("kij,kj->ki", Phi, in_use),
            self.model.parameters[self.tuned.index] + changes,
            np.arange(len(changes)) * self.every,
            last,
        )

    def run_all(self, logs: Sequence[Recording]) -> tuple[tuple[OnlineFlight, ...], M]:
        """Flight after flight, each starting from what the ones before taught; and the model in the end.

        Parameters
        ----------
        logs : sequence of Recording
            As for :meth:`run`.

        Raises
        ------
        ValueError, TypeError
            As for :func:`refine`.
        """
        flown: list[OnlineFlight] = []
        for log in logs:
            flown.append(self.run(log, knowledge=flown[-1].knowledge if flown else None))
        return tuple(flown), self.refined(flown[-1].knowledge if flown else None)

    def _changes(
        self, Phi: FloatArray, y: FloatArray, knowledge: Knowledge | None
    ) -> tuple[FloatArray, Knowledge]:
        """Change in use at first and after each update (K + 1, p), and what is known after the last sample."""
        m, _, p = Phi.shape
        blocks = m // self.every
        changes = np.empty((blocks + 1, p))
        changes[0] = self.change(knowledge)
        known = Knowledge(np.zeros((p, p)), np.zeros(p)) if knowledge is None else knowledge
        batch = max(1, _BATCH // (p * (p + 1)))
        fading = self._fading**self.every
        for first in range(0, blocks, batch):
            count = min(batch, blocks - first)
            rows = slice(first * self.every, (first + count) * self.every)
            gained = self._gained(Phi[rows], y[rows], count)
            before = np.hstack([known.information, known.moment[:, None]])
            summed, _ = lfilter([1.0], [1.0, -fading], gained, axis=0, zi=fading * before[None])
            changes[first + 1 : first + 1 + count] = np.linalg.solve(
                summed[..., :p] + self._prior, summed[..., p:]
            )[..., 0]
            known = Knowledge(summed[-1, :, :p], summed[-1, :, p])
        if rest := m - blocks * self.every:
            (gained,) = self._gained(Phi[-rest:], y[-rest:], 1)
            q = self._fading**rest
            known = Knowledge(q * known.information + gained[:, :p], q * known.moment + gained[:, p])
        return changes, known

    def _gained(self, Phi: FloatArray, y: FloatArray, blocks: int) -> FloatArray:
        """Faded sums of Phi' [Phi, y] within blocks of equal length, shape (blocks, p, p + 1)."""
        p, q = Phi.shape[2], self._fading
        length = len(Phi) // blocks
        weight = np.sqrt((1.0 - q) * q ** np.arange(length - 1, -1, -1.0))
        both = np.concatenate([Phi, y[..., None]], axis=2) * np.tile(weight, blocks)[:, None, None]
        both = both.reshape(blocks, -1, p + 1)
        return np.swapaxes(both[..., :p], 1, 2) @ both
