"""What an FMU has of a model for its importer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from ..filter import Sampling

__all__ = ["FmuPorts"]


@dataclass(frozen=True)
class FmuPorts:
    """Which variables an FMU has, where they are not those of the filter or the diagram as it is.

    Parameters
    ----------
    channels : int or sequence of str, optional
        Of a filter: number n_x of channels of x, or their names. None: those of its ``sampling``, E or the limit, else
        1.
    inertia : float, (n_x,) or (n_x, n_x) array, {"scalar", "diagonal", "full"} or None
        Of a filter: constant inertia; or, where it is sampled, the kind that is an input. None: that of its
        ``sampling``, else I.
    units : mapping of str to str, optional
        Of a filter: units of "x", of "g" and of "f", besides those in its ``sampling``.
    max_channels : int, optional
        Of a filter, FMI 3: importers choose the number of channels up to this one, by the structural parameter
        ``channels`` in Configuration Mode; arrays have its length. The memory and the time of a step are those of
        ``max_channels``.
    arrays : bool
        FMI 3: x[0], x[1], ... as one array x. False for importers without arrays, of which ecos reads zeros without a
        word.
    record : sequence of str
        Of a diagram: signals inside that importers can read as local variables, ``block.signal``; patterns such as
        ``plant.*`` as of :func:`phyfilter_ctl.diagram.flatten`. They are evaluated with the outputs. A state of the
        same name becomes ``state.<name>``.
    clocks : bool
        FMI 3: each sampled block with instants of its own gets a periodic clock, which the importer ticks in event mode
        (``fmi3SetClock``) from one period after the start on; the first sample belongs to initialization. To an
        importer that sets none the instants stay time events.
    xcp : bool
        For calibration tools: parameters and signals of the first instance at fixed addresses, described in A2L files
        as the layered standard FMI-LS-XCP says. The FMU has no XCP service of its own, the importer's reads and
        writes the memory. Not with ``max_channels``.

    Raises
    ------
    TypeError
        For patterns that are no sequence of text, and units that are no text.
    ValueError
        For numbers of channels below 1, an inertia of another size, units of other signals, a flag that is none; for
        ``xcp`` with ``max_channels``.

    Examples
    --------
    >>> FmuPorts(channels=["vx", "vy"], units={"x": "m/s"}).channels
    ('vx', 'vy')
    """

    channels: int | Sequence[str] | None = None
    inertia: ArrayLike | Literal["scalar", "diagonal", "full"] | None = None
    units: Mapping[str, str] | None = field(default=None, hash=False)
    max_channels: int | None = None
    arrays: bool = True
    record: Sequence[str] = ()
    clocks: bool = False
    xcp: bool = False

    def __post_init__(self) -> None:
        given = Sampling(1.0, channels=self.channels, inertia=self.inertia, units=self.units)
        M = given.inertia
        object.__setattr__(self, "channels", given.channels)
        object.__setattr__(self, "inertia", _as_tuple(M.tolist()) if isinstance(M, np.ndarray) else M)
        object.__setattr__(self, "units", dict(given.units) or None)
        if self.max_channels is not None:
            _signals.count("max_channels", self.max_channels)
        if isinstance(self.record, str) or not all(isinstance(entry, str) for entry in self.record):
            raise TypeError(f"record: expected a list of patterns such as 'plant.*', got {self.record!r}")
        object.__setattr__(self, "record", tuple(self.record))
        for name in ("arrays", "clocks", "xcp"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(f"{name}: expected True or False, got {getattr(self, name)!r}")
        if self.xcp and self.max_channels is not None:
            raise ValueError(
                "xcp gives every signal one address: expected a fixed number of channels, give channels"
            )


def _as_tuple(values: float | list[float] | list[list[float]]) -> object:
    """Lists as tuples, which compare and hash."""
    return tuple(map(_as_tuple, values)) if isinstance(values, list) else values
