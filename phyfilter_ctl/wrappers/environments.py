"""Gymnasium environments whose actions carry what the filter finds (extra ``gymnasium``)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _signals
from .feedforward import FeedForward

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.utils import RecordConstructorArgs
    from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
except ImportError:
    raise ImportError("this module needs Gymnasium: pip install 'phyfilter-ctl[gymnasium]'") from None

__all__ = ["FeedForwardEnv", "FeedForwardVectorEnv"]

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]
Observed = FeedForward[Array]


class FeedForwardEnv(gymnasium.Wrapper[Array, Array, Array, Array], RecordConstructorArgs):
    """An environment to which every action goes with the compensation of f_hat added, within the model's limits.

    Parameters
    ----------
    env : gymnasium.Env
        With arrays as observations and actions.
    feedforward : FeedForward
        Its model takes observations and actions of this environment.
    dt : float
        Seconds of one ``env.step``.
    observe : bool
        Append f_hat to the observations, for a policy that is to know it. ``info["f_hat"]`` has it, at the observation
        returned, anyway. A reset forgets the residual.

    Raises
    ------
    ValueError, TypeError
        For an interval other than the filter's; if f_hat is to be appended to what is no row of numbers.
    """

    def __init__(
        self, env: gymnasium.Env[Array, Array], feedforward: Observed, *, dt: float, observe: bool = False
    ) -> None:
        given = {"feedforward": feedforward, "dt": dt, "observe": observe}
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, **given)
        super().__init__(env)
        _check_interval(feedforward, dt)
        self.feedforward = feedforward
        self.dt: float = dt
        self.observe: bool = observe
        self._time = 0.0
        if observe:
            self.observation_space: gymnasium.Space[Array] = _extended(
                env.observation_space, len(feedforward.live.f_hat)
            )

    def _seen(self, y: Array, info: dict[str, Any]) -> tuple[Array, dict[str, Any]]:
        f_hat = self.feedforward.estimate(self._time, np.array(y, dtype=float))
        return (np.concatenate([y, f_hat], dtype=y.dtype) if self.observe else y), info | {"f_hat": f_hat}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode; seed and options go to the environment."""
        self._time = 0.0
        self.feedforward.reset()
        return self._seen(*self.env.reset(seed=seed, options=options))

    def step(self, action: Array) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """One step of the environment with the compensated action."""
        sent = self.feedforward.command(action).astype(np.asarray(action).dtype)
        y, reward, terminated, truncated, info = self.env.step(sent)
        self._time += self.dt
        y, info = self._seen(y, info)
        return y, reward, terminated, truncated, info


class FeedForwardVectorEnv(VectorWrapper[Array, Array, Array, Array, Array]):
    """The same for environments side by side, a filter for each; all three ways of Gymnasium to reset them.

    Some 20 us per environment and step; for thousands of robots ``SampledPhyFilter.step`` takes leading axes.

    Parameters
    ----------
    env : gymnasium.vector.VectorEnv
    make : callable
        () -> FeedForward, called once per environment.
    dt : float
        Seconds of one step.
    """

    def __init__(
        self, env: VectorEnv[Array, Array, Array], make: Callable[[], Observed], *, dt: float
    ) -> None:
        super().__init__(env)
        self.each: list[Observed] = [make() for _ in range(env.num_envs)]
        for one in self.each:
            _check_interval(one, dt)
        self.dt: float = dt
        self._times = np.zeros(env.num_envs)
        self._ended = np.zeros(env.num_envs, dtype=bool)
        self._mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)

    def _seen(self, y: Array, info: dict[str, Any], new: Mask, moved: Mask) -> tuple[Array, dict[str, Any]]:
        """Estimates at observations, of which some begin an episode and some have been seen."""
        for i in np.flatnonzero(moved):
            if new[i]:
                self.each[i].reset()
                self._times[i] = 0.0
            self.each[i].estimate(float(self._times[i]), np.array(y[i], dtype=float))
        return y, info | {"f_hat": np.array([one.live.f_hat for one in self.each])}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start episodes: all, or those of ``options["reset_mask"]``, which the environment takes out."""
        new = np.array((options or {}).get("reset_mask", np.ones(self.num_envs)), dtype=bool)
        y, info = self.env.reset(seed=seed, options=options)
        self._ended &= ~new
        return self._seen(y, info, new, new)

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """One step of all of them."""
        rows = [one.command(action) for one, action in zip(self.each, actions, strict=True)]
        sent = np.array(rows, dtype=np.asarray(actions).dtype)
        y, reward, terminated, truncated, info = self.env.step(sent)
        self._times += self.dt
        ended = np.logical_or(terminated, truncated)
        new = ended if self._mode == AutoresetMode.SAME_STEP else self._ended
        y, info = self._seen(y, info, new, np.ones(self.num_envs, dtype=bool))
        self._ended = ended & (self._mode == AutoresetMode.NEXT_STEP)
        return y, reward, terminated, truncated, info


def _check_interval(feedforward: Observed, dt: float) -> None:
    mine = feedforward.live.recursion.sampling.dt
    if abs(_signals.number("dt", dt, "s", above=0.0) - mine) > 1e-9 * mine:
        raise ValueError(
            f"dt: a step of the environment is {dt:g} s, the filter is sampled at {mine:g} s; sample it anew"
        )


def _extended(space: gymnasium.Space[Any], n_f: int) -> gymnasium.Space[Array]:
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise TypeError(f"observe: expected observations of one row of numbers (a Box), got {space}")
    edge = np.full(n_f, np.inf, space.dtype)
    return spaces.Box(np.r_[space.low, -edge], np.r_[space.high, edge], dtype=space.dtype.type)
