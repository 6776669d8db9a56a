"""``phyfilter-ctl export``: a filter or a model as an FMU, a system structure package, or C."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from .. import models
from .._output import add_json, check_target, write_json
from .unused import refuse_unused

if TYPE_CHECKING:
    import control as ct

    from ..filter import FilterBank, PhyFilter, SampledPhyFilter
    from ..filter.sampling import ChannelOptions

    System = ct.InputOutputSystem | PhyFilter | FilterBank | SampledPhyFilter

__all__ = ["add_arguments", "main"]

_DESCRIPTION = """Hand a filter or a model over: an FMU that needs no Python, a system structure package (SSP), or C99
without heap and library calls. Give one or more of --fmu, --ssp, --c and --target."""

_EPILOG = """examples:
  phyfilter-ctl export filter.toml --fmu filter.fmu --channels 3         FMI 3.0, this machine's platform
  phyfilter-ctl export filter.toml --fmu filter.fmu --fmi 2.0 --platform all
  phyfilter-ctl export filter.toml --c firmware/filter --channels 3 --real float
  phyfilter-ctl export filter.toml --target px4 px4_filter --channels 3
  phyfilter-ctl export acceleration --fmu acceleration.fmu               a model of phyfilter-ctl run
  phyfilter-ctl export acceleration --ssp acceleration.ssp"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl export``."""
    parser.description, parser.epilog = _DESCRIPTION, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "what", metavar="FILTER_OR_MODEL", help=f"a filter file, or a model: {', '.join(models.available())}"
    )
    targets = parser.add_argument_group("what to write")
    targets.add_argument("--fmu", metavar="FILE.fmu", help="a functional mock-up unit")
    targets.add_argument("--ssp", metavar="FILE.ssp", help="a model as FMUs with their wiring")
    targets.add_argument("--c", metavar="DIR", help="C99 sources with a program that checks itself")
    targets.add_argument(
        "--target",
        nargs=2,
        metavar=("NAME", "DIR"),
        help="a package that the target's own build takes: arduino (PlatformIO too), ardupilot, cmake, crazyflie, "
        "px4, ros2, rust, zephyr",
    )
    add_json(targets)
    filters = parser.add_argument_group("filters")
    filters.add_argument(
        "--channels", type=int, metavar="N", help="channels of x (default: as the file names them, or 1)"
    )
    filters.add_argument(
        "--inertia", choices=("scalar", "diagonal", "full"), help="make the inertia an input of that kind"
    )
    filters.add_argument(
        "--dt", type=float, metavar="S", help="sample a continuous filter at this interval in s"
    )
    filters.add_argument(
        "--rate",
        choices=("communication", "fixed"),
        help="FMU of a sampled filter: a sample per communication step, or every dt (default communication)",
    )
    fmu = parser.add_argument_group("FMU and SSP")
    fmu.add_argument("--fmi", choices=("2.0", "3.0"), help="version (default 3.0; 2.0 inside an SSP)")
    fmu.add_argument(
        "--kind", nargs="+", choices=("cs", "me"), help="co-simulation, model exchange (default both)"
    )
    fmu.add_argument(
        "--platform",
        nargs="+",
        metavar="NAME",
        help="native (default), all, none for sources only, or x86_64-linux, aarch64-linux, x86_64-windows, "
        "x86_64-darwin, aarch64-darwin",
    )
    fmu.add_argument(
        "--split",
        nargs="+",
        metavar="PART=BLOCK,BLOCK",
        help="SSP: blocks of each part (default: each a part)",
    )
    fmu.add_argument(
        "--record",
        nargs="+",
        metavar="BLOCK.SIGNAL",
        help="FMU of a model: signals inside as local variables, such as 'plant.*'",
    )
    fmu.add_argument("--name", help="model identifier, a C identifier")
    fmu.add_argument(
        "--clocks",
        action="store_true",
        help="FMI 3: a periodic clock for each sampled block, which the importer ticks in event mode (filters: --rate "
        "fixed)",
    )
    fmu.add_argument("--scalars", action="store_true", help="FMI 3: no arrays, for importers that know none")
    fmu.add_argument(
        "--max-channels",
        type=int,
        metavar="N",
        help="FMI 3, filters: importers choose up to N channels by the structural parameter channels",
    )
    fmu.add_argument(
        "--xcp",
        action="store_true",
        help="for calibration tools: A2L files of parameters and signals at fixed addresses (FMI-LS-XCP)",
    )
    c = parser.add_argument_group("C")
    c.add_argument("--fixed", action="store_true", help="coefficients and step fixed: least code and memory")
    c.add_argument(
        "--real",
        choices=("double", "float", "q31"),
        help="numbers (default: as the filter computes); q31: 32-bit integers, needs --ranges",
    )
    c.add_argument(
        "--ranges",
        nargs="+",
        metavar="SIGNAL=D",
        help="q31: largest |x|, |g| and |f_theta|, such as x=10 g=20 f_theta=20",
    )


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl export``; return the exit status.

    Raises
    ------
    ValueError, OSError
        If the options are wrong, a block cannot be exported, or a file cannot be read or written.
    """
    if not (options.fmu or options.ssp or options.c or options.target):
        raise ValueError("expected one of --fmu FILE, --ssp FILE, --c DIR and --target NAME DIR")
    check_target(options.fmu, suffixes=(".fmu",))
    check_target(options.ssp, suffixes=(".ssp",))
    fmu, packed, code = (
        (options.fmu, "--fmu"),
        (options.fmu or options.ssp, "--fmu or --ssp"),
        (options.c or options.target, "--c or --target"),
    )
    alone = ("rate", "kind", "record", "clocks", "scalars", "max_channels", "xcp")
    refuse_unused(
        options,
        dict.fromkeys(alone, fmu)
        | {"fmi": packed, "platform": packed, "split": (options.ssp, "--ssp")}
        | {"real": code, "ranges": code, "fixed": code},
    )
    system, noted = _read(options)
    if options.ssp:
        _as_diagram(system)  # refused before the first file is written
    written: dict[str, object] = {}
    if options.fmu:
        written["fmu"] = str(_fmu(options, system, noted))
    if options.ssp:
        written["ssp"] = str(_ssp(options, system))
    if options.c:
        written["c"] = str(_c(options, system))
    if options.target:
        written[options.target[0]] = str(_target(options, system))
    if options.json is not None:
        write_json(options.json, written)
    if options.json != "-":
        for kind, path in written.items():
            print(f"{kind:4} {path}")
    return 0


def _read(options: argparse.Namespace) -> tuple[System, ChannelOptions]:
    name: str = options.what
    if name in models.available() and not Path(name).is_file():
        for option in ("channels", "inertia", "dt"):
            if getattr(options, option) is not None:
                raise ValueError(f"--{option} is for filters; {name} is a model")
        return models.load(name).build(), {}
    if not Path(name).exists():
        raise ValueError(
            f"{name}: neither a filter file nor a model; models are {', '.join(models.available())}"
        )
    from ..filter import SampledPhyFilter
    from ..filterfile.document import load, read_noted

    system, noted = read_noted(name)
    if options.dt is None:
        return system, noted
    if isinstance(system, SampledPhyFilter):
        raise ValueError(f"{name} is sampled every {system.dt:g} s already: leave --dt out")
    return load(name, dt=options.dt), {}


def _platforms(options: argparse.Namespace) -> tuple[str, ...] | Literal["all"]:
    if options.platform == ["all"]:
        return "all"
    return () if options.platform == ["none"] else tuple(options.platform or ["native"])


def _fmu(options: argparse.Namespace, system: System, noted: ChannelOptions) -> Path:
    from ..fmi import FmuPorts, export_fmu

    return export_fmu(
        system,
        options.fmu,
        fmi=options.fmi or "3.0",
        kinds=tuple(options.kind or ("cs", "me")),
        platforms=_platforms(options),
        name=options.name,
        rate=options.rate or "communication",
        ports=FmuPorts(
            channels=noted.get("channels") if options.channels is None else options.channels,
            inertia=noted.get("inertia") if options.inertia is None else options.inertia,
            units=noted.get("units"),
            max_channels=options.max_channels,
            arrays=not options.scalars,
            record=options.record or (),
            clocks=options.clocks,
            xcp=options.xcp,
        ),
    )


def _as_diagram(system: System) -> ct.InterconnectedSystem:
    import control as ct

    if not isinstance(system, ct.InterconnectedSystem):
        raise ValueError(
            "--ssp: expected a model that is a diagram of several blocks; export a filter with --fmu"
        )
    return system


def _ssp(options: argparse.Namespace, system: System) -> Path:
    from ..fmi import export_ssp

    split: dict[str, list[str]] | None = None
    if options.split:
        split = {}
        for entry in options.split:
            part, _, blocks = entry.partition("=")
            if not part or not blocks:
                raise ValueError(f"--split: expected PART=BLOCK,BLOCK, got {entry!r}")
            split[part] = blocks.split(",")
    return export_ssp(
        _as_diagram(system),
        options.ssp,
        split=split,
        fmi=options.fmi or "2.0",
        platforms=_platforms(options),
        name=options.name,
    )


def _c(options: argparse.Namespace, system: System) -> Path:
    from ..codegen import export_c

    return export_c(
        _with_steps("--c", system),
        options.c,
        real=options.real,
        ranges=_ranges(options),
        name=options.name,
        channels=options.channels,
        inertia=options.inertia,
        tunable=not options.fixed,
        variable=not options.fixed,
    )


def _target(options: argparse.Namespace, system: System) -> Path:
    from ..codegen import export_target

    target, folder = options.target
    if options.fixed:
        raise ValueError(
            "--fixed is for --c: a target's package makes up for missing samples by longer steps"
        )
    return export_target(
        _with_steps("--target", system),
        target,
        folder,
        real=options.real,
        ranges=_ranges(options),
        name=options.name,
        channels=options.channels,
        inertia=options.inertia,
    )


def _ranges(options: argparse.Namespace) -> dict[str, float] | None:
    if options.ranges is None:
        return None
    found: dict[str, float] = {}
    for entry in options.ranges:
        name, _, value = entry.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise ValueError(f"--ranges: expected SIGNAL=D such as x=10, got {entry!r}") from None
    return found


def _with_steps(option: str, system: System) -> ct.InputOutputSystem | SampledPhyFilter:
    from ..filter import FilterBank, PhyFilter

    if isinstance(system, PhyFilter | FilterBank):
        raise ValueError(f"{option}: expected a sampled filter; give the sampling interval with --dt")
    return system
