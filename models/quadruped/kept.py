"""Walks that were judged, kept in a folder: a long judgement that was stopped goes on, and repeats none of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .network import Network

__all__ = ["Cells", "keep"]

# Condition and arm to figure and (policies,) array.
Cells = dict[tuple[str, str], dict[str, NDArray[np.float64]]]


def keep(
    folder: Path | None, name: str, policies: Mapping[str, Network], asked: object, judge: Callable[[], Cells]
) -> Cells:
    """What was judged before, or else what is judged now, which is then kept.

    Parameters
    ----------
    folder : Path, optional
        Where; None: nothing is kept.
    name : str
        Beginning of the file's name.
    policies : mapping of Network
        That walk; other numbers are other walks.
    asked : object
        Everything else that the walks depend on and that is no code; what prints alike is the same.
    judge : callable
        Lets them walk.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    if folder is None:
        return judge()
    digest = hashlib.sha256(repr(asked).encode())
    for family, policy in policies.items():
        digest.update(family.encode())
        for weights, bias in policy.layers:
            digest.update(weights.tobytes() + bias.tobytes())
    path = folder / f"{name}-{digest.hexdigest()[:16]}.json"
    if path.is_file():
        return {
            (label, arm): {figure: np.array(each, dtype=float) for figure, each in values.items()}
            for label, arm, values in json.loads(path.read_text(encoding="utf-8"))
        }
    from phyfilter_ctl._output import write_text

    found = judge()
    rows = [
        (
            label,
            arm,
            {figure: [None if np.isnan(v) else float(v) for v in each] for figure, each in values.items()},
        )
        for (label, arm), values in found.items()
    ]
    folder.mkdir(parents=True, exist_ok=True)
    write_text(str(path), json.dumps(rows, allow_nan=False) + "\n")
    return found
