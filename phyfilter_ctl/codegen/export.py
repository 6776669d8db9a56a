"""One way to C for diagrams and filters alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import control as ct
from numpy.typing import ArrayLike

from .._renamed import takes_signals
from ..diagram import FlatModel, flatten
from ..filter import FilterBank, PhyFilter, SampledPhyFilter
from .diagram_folder import export_diagram
from .filter_folder import export_filter

__all__ = ["export_c"]


@takes_signals
def export_c(
    system: ct.InputOutputSystem | FlatModel | SampledPhyFilter,
    folder: str | Path,
    *,
    real: Literal["double", "float", "q31"] | None = None,
    ranges: Mapping[str, float] | None = None,
    name: str | None = None,
    channels: int | None = None,
    inertia: ArrayLike | Literal["scalar", "diagonal", "full"] | None = None,
    tunable: bool = True,
    variable: bool = True,
    step: float | None = None,
    substeps: int = 1,
    operating_points: Sequence[Mapping[str, ArrayLike]] = (),
) -> Path:
    """Write a sampled filter, a plant or a diagram as C99.

    Parameters
    ----------
    system : control.InputOutputSystem, FlatModel or SampledPhyFilter
    folder : str or Path
        Written whole or not at all; files that no export wrote are not touched.
    real : {"double", "float", "q31"}, optional
        Numbers of the C code; by default double, for a filter those it computes in. "q31", of a filter: 32-bit integers
        for cores without floating point, coefficients and step fixed.
    ranges : mapping of str to float, optional
        Of "q31": largest |x|, |g| and |f_theta| in their units. Beyond them inputs saturate; within them nothing
        overflows, and the error has the bound that :func:`fixed_point` tells.
    name : str, optional
        Prefix of all symbols, a C identifier.
    channels, inertia
        Of a filter: number of channels of x; constant inertia or the kind that is an input. What is not given comes
        from the filter's ``sampling``, as names and units do; without an inertia there M_hat = I.
        With ``g="hold"``, ``step``, ``live.step`` and C take the g that acted since the last sample; ``run``, blocks
        and FMUs take the g that acts from this sample on. With ``g="average"`` all take g at this sample.
    tunable : bool
        Whether coefficients may be set at run time. Without, the code is smaller.
    variable : bool
        Of a filter: whether a step may have another length than dt. Without either, code and memory are least.

    step : float, optional
        Of a diagram: seconds between two calls of ``<name>_step``. None: the longest that meets every instant of the
        sampled blocks, 1 ms where there are none.
    substeps : int
        Of a diagram: Runge-Kutta steps in one call. A step at which a stable mode would grow is refused.
    operating_points : sequence of mapping
        Of a diagram: states and inputs by name, where that is checked besides the start.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    TypeError
        If the system is of another kind; a continuous filter needs ``sampled(dt)``.
    ValueError
        If a name is not one of C, a step does not fit the system, or the system has what C cannot hold; it says which.
    FileExistsError
        If the folder holds files that no export wrote.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as parent:
    ...     written = export_c(PhyFilter([20.0]).sampled(0.002), Path(parent, "wing"), channels=3, name="wing")
    ...     (written / "wing.h").is_file()
    True
    """
    if isinstance(system, PhyFilter | FilterBank):
        raise TypeError("a continuous filter has no steps: expected a sampled one, filter.sampled(dt)")
    if isinstance(system, SampledPhyFilter):
        known = system.sampling.channels_or(channels) or (
            system.E.shape[0] if system.E is not None else len(system.filters)
        )
        if step is not None or substeps != 1 or operating_points:
            raise ValueError(
                "step, substeps and operating_points are those of a diagram; a filter has its dt"
            )
        return export_filter(
            system,
            folder,
            known,
            real=real,
            ranges=ranges,
            inertia=inertia,
            name=name or "phyfilter",
            variable=variable,
            tunable=tunable,
        )
    if channels is not None or inertia is not None:
        raise ValueError("channels and inertia are those of a filter; a diagram brings its own")
    if real == "q31" or ranges is not None:
        raise ValueError(
            "real='q31' and ranges are those of a filter; a diagram is exported as float or double"
        )
    flat = system if isinstance(system, FlatModel) else flatten(system)
    return export_diagram(
        flat,
        folder,
        name=name,
        real=real or "double",
        step=step,
        substeps=substeps,
        operating_points=operating_points,
        tunable=tunable,
    )
