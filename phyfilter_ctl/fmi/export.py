"""Self-contained FMUs of filters, plants and diagrams."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._renamed import takes_former, takes_signals
from ..blocks.functions import dependencies
from ..codegen.compiler import CompilerError
from ..codegen.diagram_source import diagram_model
from ..codegen.filter_cmodel import filter_model
from ..codegen.identifiers import checked_identifier
from ..codegen.model import CModel
from ..diagram import FlatModel, flatten
from ..diagram.fixed_step import largest_stable_step, refuse_unstable_step
from ..filter import PhyFilter, SampledPhyFilter, Sampling
from .archive_write import write_archive
from .build import build_binaries, platform_names
from .calibration import calibration_entries
from .channels import room_for, with_channels
from .description import Fmi, FmuExperiment, FmuInterface, FmuSolver, fmu_interface
from .description_xml import build_description, model_description, terminals_and_icons
from .documentation import documentation_page, icon_png, icon_svg, terminal_png
from .glue import fmu_sources
from .ports import FmuPorts

__all__ = ["export_fmu"]

# RK4 is stable up to |p h| = 2.78 and exact to 1e-6 at a tenth of this.
_STEPS_PER_POLE = 20.0
# Of the longest stable step: an error of a few per cent in the fastest mode, which has died out by then.
_OF_STABLE = 0.25


@takes_signals
@takes_former
def export_fmu(
    system: ct.InputOutputSystem | FlatModel | CModel | PhyFilter | SampledPhyFilter | Sequence[PhyFilter],
    path: str | Path,
    *,
    fmi: Fmi = "3.0",
    kinds: Sequence[Literal["cs", "me"]] = ("cs", "me"),
    platforms: Sequence[str] | Literal["all"] = ("native",),
    name: str | None = None,
    rate: Literal["communication", "fixed"] = "communication",
    ports: FmuPorts | None = None,
    experiment: FmuExperiment | None = None,
    compiler: str | Path | Sequence[str] | None = None,
) -> Path:
    """Write a filter, a plant or a diagram as an FMU that needs nothing but itself to run.

    Parameters
    ----------
    system : control.InputOutputSystem, PhyFilter, SampledPhyFilter or sequence of PhyFilter
        A diagram or block of python-control, or a filter (a sequence: one continuous filter per channel). What
        :func:`flatten` or ``diagram_model`` made of it is accepted too.
    path : str or Path
        The file; replaced if it exists, and only once the FMU is complete.
    fmi : {"3.0", "2.0"}
    kinds : sequence of {"cs", "me"}
        Co-simulation, model exchange.
    platforms : sequence of str or "all"
        "native" is this machine with the system's compiler; "x86_64-linux", "aarch64-linux", "x86_64-windows",
        "x86_64-darwin", "aarch64-darwin" or "all" need the extra ``cross``. () makes an FMU of sources only.
    name : str, optional
        Model identifier, a C identifier. By default the diagram's name or "phyfilter".
    rate : {"communication", "fixed"}
        A sampled filter takes one sample per communication step, over the time that has passed; or every dt seconds.
    ports : FmuPorts, optional
        Channels, inertia and units of a continuous filter (a sampled one has its own); arrays or scalars, signals
        inside, clocks, a number of channels that importers choose, addresses for calibration.
    experiment : FmuExperiment, optional
        Start, stop, step and tolerance that importers take by default; solver, author and description. A solver's step
        at which a mode that decays at the start would grow is refused.
    compiler : str, Path or sequence of str, optional
        For "native"; by default $CC, cc, gcc, clang or ziglang's.

    Returns
    -------
    Path
        ``path``.

    Raises
    ------
    ValueError
        If a block cannot be traced or a name is not legal in FMI (the message names it); for options that contradict
        each other.
    CompilerError
        If the compiler fails, or one for other platforms is missing.
    TypeError
        If ``system`` is none of the above.

    Warns
    -----
    UserWarning
        If this machine has no compiler: the FMU then holds sources only, and its documentation says so.

    Notes
    -----
    The archive is the same to the byte for the same system, tool chain and SOURCE_DATE_EPOCH.

    Co-simulation: inputs are constant over a communication step (FMI 2: or of given slope). Outputs are evaluated when
    asked for, so they follow inputs that are set at the same point. A step on an input that is not finite is discarded.

    A sampled filter takes its samples at the start and at the end of each communication step, on the inputs set before
    that step. With ``g="hold"``, ``run``, blocks and FMUs take the g that acts from this sample on; ``step``,
    ``live.step`` and C take the g that acted since the last sample. With ``g="average"`` all take g at this sample. A
    master that sets the inputs of the step's beginning, as FMPy does, gets f_hat a communication step late, and the
    first sample counts twice. Nothing is late where the inputs of the step's end are set, in model exchange, or with
    ``rate="fixed"`` in Event Mode of FMI 3.

    References
    ----------
    .. [1] Functional Mock-up Interface Specification, versions 2.0.5 and 3.0.2, and FMI Layered Standard for XCP,
       version 1.0.0, Modelica Association.

    Examples
    --------
    >>> import tempfile
    >>> from phyfilter_ctl import PhyFilter
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     export_fmu(PhyFilter([400.0, 40.0]).sampled(0.002, channels=3), Path(folder, "wing.fmu")).name
    'wing.fmu'
    """
    chosen, recorded = platform_names(platforms), 0
    ports, experiment = ports or FmuPorts(), experiment or FmuExperiment()
    channels, inertia, units = ports.channels, ports.inertia, ports.units
    if isinstance(system, ct.InputOutputSystem) and not isinstance(system, PhyFilter):
        external, system = system.noutputs, flatten(system, record=ports.record)
        recorded = len(system.outputs) - int(external or 0)
    elif ports.record:
        raise ValueError("record belongs to diagrams and blocks of python-control, whose signals have names")
    if isinstance(system, SampledPhyFilter):
        told = system.sampling.told(channels=channels, inertia=inertia, units=units)
        inertia, units = None, None
        labels, channels, M = told.names, told.n_x, told.inertia
        # Importers choose how many of the channels that it has room for are in use.
        system = replace(
            system, sampling=told if ports.max_channels is None else replace(told, channels=None)
        )
    else:
        given = Sampling(1.0, channels=channels, units=units)
        labels, channels, M = given.names, given.n_x, inertia
    room = channels
    if ports.max_channels is not None:
        room, channels = room_for(
            system, channels, ports.max_channels, M, named=bool(labels), grouped=ports.arrays and fmi == "3.0"
        )
    model, filters = _c_model(system, name, room, inertia, rate, labels, units)
    solver = experiment.solver
    if solver is None and isinstance(system, FlatModel):
        solver = FmuSolver(step=min(1e-3, _OF_STABLE * largest_stable_step(system).seconds))
    elif solver is not None and isinstance(system, FlatModel) and solver.method == "rk4" and "cs" in kinds:
        refuse_unstable_step(
            system, solver.step or 0.0, "give FmuSolver(step={step}) or FmuSolver('adaptive')"
        )
    interface = fmu_interface(
        model,
        fmi=fmi,
        kinds=kinds,
        experiment=replace(experiment, solver=_solver(solver, filters if model.states else ())),
        arrays=ports.arrays,
        clocks=ports.clocks,
        recorded=recorded,
        on_time=_on_time(system) if isinstance(system, FlatModel) else None,
    )
    if ports.max_channels is not None:
        interface = with_channels(interface, channels or 1)
    tolerant = isinstance(system, SampledPhyFilter) and system.sampling.nonfinite == "hold"
    token, sources = sealed(interface, accept_bad_inputs=tolerant, xcp=ports.xcp)
    binaries: dict[str, bytes] = {}
    try:
        if chosen:
            binaries = build_binaries(sources, name=model.name, fmi=fmi, platforms=chosen, compiler=compiler)
    except CompilerError as error:
        if compiler is not None or chosen != ("native",) or not str(error).startswith("no C compiler"):
            raise
        warnings.warn(
            f"{Path(path).name} holds sources only, it runs nowhere as it is: {error}", stacklevel=2
        )
    notes = [system.describe()] if isinstance(system, PhyFilter) else []
    page = documentation_page(interface, filters=filters, notes=notes, sources_only=not binaries)
    extra = calibration_entries(interface, token, binaries) if ports.xcp else {}
    return write_archive(path, fmu_entries(interface, token, sources, page) | binaries | extra)


def _c_model(
    system: FlatModel | CModel | PhyFilter | SampledPhyFilter | Sequence[PhyFilter],
    name: str | None,
    channels: int | None,
    inertia: ArrayLike | Literal["scalar", "diagonal", "full"] | None,
    rate: Literal["communication", "fixed"],
    labels: tuple[str, ...],
    units: Mapping[str, str] | None,
) -> tuple[CModel, tuple[PhyFilter, ...]]:
    """The C sources, and the filters to draw."""
    if isinstance(system, (PhyFilter, SampledPhyFilter)) or (
        isinstance(system, (list, tuple)) and system and all(isinstance(part, PhyFilter) for part in system)
    ):
        filters = system.filters if isinstance(system, SampledPhyFilter) else system
        parts = (filters,) if isinstance(filters, PhyFilter) else tuple(filters)
        count = channels if channels is not None else _channels(system, parts)
        return (
            filter_model(
                system, count, inertia=inertia, names=labels, units=units, name=name or "phyfilter", rate=rate
            ),
            parts,
        )
    for option, value in (("channels", channels), ("inertia", inertia), ("units", units)):
        if value is not None:
            raise ValueError(f"{option} belongs to filters; a diagram has its own")
    if rate != "communication":
        raise ValueError(
            f"rate={rate!r} belongs to filters; the sampled blocks of a diagram run on their own grids"
        )
    if isinstance(system, CModel):
        return (system if name is None else replace(system, name=checked_identifier(name))), ()
    if not isinstance(system, FlatModel):
        raise TypeError(
            f"export_fmu: expected a filter or a python-control system, got {type(system).__name__}; wrap equations "
            "with phyfilter_ctl.plant or function_block"
        )
    return diagram_model(system, name=name), ()


def _on_time(flat: FlatModel) -> NDArray[np.bool_]:
    """Which derivative and output depends on time itself."""
    if flat.dt > 0.0:  # all of it happens at instants
        return np.zeros(len(flat.outputs), dtype=bool)
    parts = ((flat.dynamics, flat.states), (flat.output, flat.outputs))
    return np.concatenate(
        [dependencies(part, 0)[:, 0] if rows else np.zeros(0, bool) for part, rows in parts]
    )


def _channels(
    system: PhyFilter | SampledPhyFilter | Sequence[PhyFilter], parts: tuple[PhyFilter, ...]
) -> int:
    if isinstance(system, SampledPhyFilter) and system.E is not None:
        return len(system.E)
    return len(parts)


def _solver(solver: FmuSolver | None, filters: tuple[PhyFilter, ...]) -> FmuSolver:
    if solver is not None or not filters:
        return solver or FmuSolver()
    fastest = max(float(abs(part.poles).max()) for part in filters)
    return FmuSolver(step=min(1e-3, 1.0 / (_STEPS_PER_POLE * fastest)))


def sealed(
    interface: FmuInterface, *, accept_bad_inputs: bool = False, xcp: bool = False
) -> tuple[str, dict[str, str]]:
    """Token from the content, and the sources with it inside.

    Parameters
    ----------
    interface : FmuInterface
    accept_bad_inputs : bool
        Leave inputs that are not finite to the model.
    xcp : bool
        With a page for calibration tools.
    """
    open_sources = fmu_sources(interface, "", accept_bad_inputs=accept_bad_inputs, xcp=xcp)
    digest = hashlib.sha256()
    for text in (
        model_description(interface, "", ()),
        *(part for item in open_sources.items() for part in item),
    ):
        digest.update(text.encode("utf-8") + b"\0")
    code = digest.hexdigest()
    token = "-".join((code[:8], code[8:12], code[12:16], code[16:20], code[20:32]))
    return token, fmu_sources(interface, token, accept_bad_inputs=accept_bad_inputs, xcp=xcp)


def fmu_entries(
    interface: FmuInterface, token: str, sources: dict[str, str], page: str
) -> dict[str, bytes | str]:
    """Everything of an FMU's archive but the binaries.

    Parameters
    ----------
    interface : FmuInterface
    token : str
    sources : dict of str to str
        Of the folder sources; none: there is no such folder.
    page : str
        documentation/index.html.
    """
    files = [name for name in sources if name.endswith(".c")]
    entries: dict[str, bytes | str] = {f"sources/{name}": text for name, text in sources.items()}
    entries["modelDescription.xml"] = model_description(interface, token, files)
    entries["documentation/index.html"] = page
    if interface.fmi == "2.0":
        entries["model.png"] = icon_png()
        return entries
    if files:
        entries["sources/buildDescription.xml"] = build_description(interface, files)
    entries["terminalsAndIcons/terminalsAndIcons.xml"] = terminals_and_icons(interface)
    entries["terminalsAndIcons/icon.png"] = icon_png()
    entries["terminalsAndIcons/icon.svg"] = icon_svg()
    entries["terminalsAndIcons/terminal.png"] = terminal_png()
    return entries
