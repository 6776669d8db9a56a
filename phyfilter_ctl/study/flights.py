"""Flights over seeds: their instants and noise, the signals that are kept of them, and how fast they are simulated."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ..simulation import SimulationResponse

__all__ = ["flight_signals", "flight_times", "realtime_factor", "unit_noise"]

FloatArray = NDArray[np.float64]


def flight_times(duration: float, dt: float) -> FloatArray:
    """The instants k dt of a flight, both ends among them, s.

    Parameters
    ----------
    duration, dt : float
        s.

    Examples
    --------
    >>> flight_times(0.1, 0.025).tolist()
    [0.0, 0.025, 0.05, 0.07500000000000001, 0.1]
    """
    return dt * np.arange(round(duration / dt) + 1, dtype=float)


def unit_noise(seeds: int | Sequence[int], rows: int, samples: int) -> FloatArray:
    """White noise of unit variance for the inputs of a diagram; that of a seed is the same for all methods.

    Parameters
    ----------
    seeds : int or sequence of int
        Of the flights, not negative.
    rows, samples : int
        Inputs, and instants.

    Returns
    -------
    (B, rows, samples) or, for one seed, (rows, samples) array

    Raises
    ------
    ValueError
        For a negative seed.

    Examples
    --------
    Noise that ``simulate(diagram, t, noise, interpolation="hold")`` takes:

    >>> t = flight_times(1.0, 0.002)
    >>> noise = unit_noise(7, 3, len(t))
    >>> noise.shape, bool((noise == unit_noise([7], 3, len(t))[0]).all())
    ((3, 501), True)

    >>> one, both = unit_noise([3], 2, 5), unit_noise([2, 3], 2, 5)
    >>> bool((one[0] == both[1]).all())
    True
    """
    given = [seeds] if isinstance(seeds, int | np.integer) else list(seeds)
    if any(seed < 0 for seed in given):
        raise ValueError(f"seeds: expected whole numbers from 0 on, got {given}")
    noise = [np.random.default_rng([seed, 1]).standard_normal((rows, samples)) for seed in given]
    return noise[0] if isinstance(seeds, int | np.integer) else np.array(noise)


def flight_signals(
    runs: Sequence[SimulationResponse], seeds: Sequence[int], keep: Sequence[str]
) -> tuple[dict[str, FloatArray], str]:
    """Signals of a batch of flights by name, and what failed.

    Parameters
    ----------
    runs : sequence of SimulationResponse
        What ``simulate_batch`` returned.
    seeds : sequence of int
        Of the flights, for the message.
    keep : sequence of str
        Outputs of the diagram, without index: ``r`` stands for r[0], r[1], ...

    Returns
    -------
    signals : dict of str to (B, N, k) array
        A flight that failed is NaN from there on.
    message : str
        "" if none did.
    """
    names = [label.split("[")[0] for label in runs[0].output_labels or []]
    rows = {name: [i for i, other in enumerate(names) if other == name] for name in keep}
    signals = {name: np.array([run.outputs[at].T for run in runs]) for name, at in rows.items()}
    failed = [f"seed {seed}: {run.message}" for seed, run in zip(seeds, runs, strict=True) if not run.success]
    return signals, "; ".join(failed)


def realtime_factor(fly: Callable[[], object], duration: float, *, repeats: int = 1) -> float:
    """Simulated over elapsed time, once everything is compiled.

    Parameters
    ----------
    fly : function ()
        Simulates; called once more than measured.
    duration : float
        s that it simulates.
    repeats : int
        The fastest of so many counts.
    """
    fly()
    elapsed = []
    for _ in range(repeats):
        begin = time.perf_counter()
        fly()
        elapsed.append(time.perf_counter() - begin)
    return duration / min(elapsed)
