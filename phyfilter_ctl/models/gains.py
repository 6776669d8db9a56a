"""Tuned gains of a model's methods: a TOML file, one table a method."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["command_jitter", "gains_text", "read_gains"]


def gains_text(header: Sequence[str], found: Mapping[str, Mapping[str, float | str]]) -> str:
    """Gains as TOML.

    Parameters
    ----------
    header : sequence of str
        Comment lines.
    found : mapping of str to mapping
        By method and name; a text is taken as it is, for numbers of so many digits.

    Examples
    --------
    >>> print(gains_text(["Found by hand."], {"pd": {"bandwidth": 2.5, "mae": f"{0.012345:.4f}"}}), end="")
    # Found by hand.
    <BLANKLINE>
    [pd]
    bandwidth = 2.5
    mae = 0.0123
    """
    lines = [f"# {line}" for line in header]
    for name, values in found.items():
        lines += ["", f"[{name}]", *(f"{key} = {value}" for key, value in values.items())]
    return "\n".join(lines) + "\n"


def read_gains(path: Path, methods: Sequence[str], *, command: str) -> dict[str, dict[str, float]]:
    """Read gains.

    Parameters
    ----------
    path : Path
    methods : sequence of str
        Those that must be there.
    command : str
        What makes the file, for the message.

    Returns
    -------
    dict of str to dict of str to float

    Raises
    ------
    ValueError
        If a method is missing.
    """
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    missing = [name for name in methods if name not in data]
    if missing:
        raise ValueError(f"{path.name}: no entry for {', '.join(missing)}; {command} makes them")
    return {name: data[name] for name in methods}


def command_jitter(commands: ArrayLike, scale: float) -> float:
    """Noise of sampled commands over a scale: rms of their change from sample to sample, over sqrt 2.

    Parameters
    ----------
    commands : (B, N, n) array
        Flights, samples, actuators.
    scale : float
        In the unit of the commands.

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(0.0, 0.1, (1, 100_000, 1))
    >>> round(command_jitter(5.0 + noise, 1.0), 3)
    0.1
    """
    change = np.diff(np.asarray(commands, dtype=float), axis=1)
    return float(np.sqrt(0.5 * np.mean(change**2)) / scale)
