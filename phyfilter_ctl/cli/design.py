"""``phyfilter-ctl design``: from poles, a family, a band or a file to a filter, its figures, a picture and a file."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from typing import TYPE_CHECKING, get_args

from .._choices import Family, Form, Method
from .._output import add_json, check_target, write_figure, write_json
from .frequencies import add_frequency, add_picture_units, complex_numbers, numbers
from .unused import refuse_units

if TYPE_CHECKING:
    from ..analysis.frequency import FilterResponse
    from ..design.optimal import LeastBound
    from ..filter import FilterBank, PhyFilter, SampledPhyFilter
    from ..filter.sampling import ChannelOptions

__all__ = ["add_arguments", "main"]

_DESCRIPTION = """Choose a filter F = N/D and see what it does: formula, poles, bandwidth, peaks, phase lag, noise gain.
Frequencies are in rad/s; options that end in -hz take Hz. Give poles, or a family, or a band, or what is bounded, or
a filter file."""

_EPILOG = """examples:
  phyfilter-ctl design --poles -20,-20                          two poles at -20 rad/s, N = a_0
  phyfilter-ctl design --poles -20+10j,-20-10j --type 2         follows ramps of the residual too
  phyfilter-ctl design --poles -20,-20,-20 --zeros-at 6         cancels a residual at 6 rad/s
  phyfilter-ctl design --family butterworth --order 2 --cutoff 20 --dt 0.002 --out filter.toml
  phyfilter-ctl design --family bessel --order 3 --cutoff-hz 3.2  the same in Hz
  phyfilter-ctl design --bandpass 4,9 --picture band.png --hz --db
  phyfilter-ctl design --slope 8 --noise 0.01 --order 4 --form general  least worst-case error, and its floor
  phyfilter-ctl design filter.toml --at 1,5,20 --json -         read a filter back, figures as JSON"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl design``."""
    parser.description, parser.epilog = _DESCRIPTION, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    source = parser.add_argument_group("the filter, one of")
    source.add_argument("file", nargs="?", metavar="FILTER.toml", help="a filter file")
    add_frequency(
        source,
        "--poles",
        complex_numbers,
        metavar="P,P,...",
        help="poles in rad/s, complex ones in pairs: -20+10j,-20-10j",
    )
    source.add_argument(
        "--family", choices=get_args(Family), help="low-pass family, with --order and --cutoff"
    )
    add_frequency(
        source,
        "--bandpass",
        numbers,
        metavar="LOW,HIGH",
        help="band edges in rad/s; --family and --order may be given",
    )
    source.add_argument(
        "--slope",
        type=float,
        metavar="D",
        help="bound of |gamma'|, gamma = f - f_theta: the least worst-case error; with --noise",
    )
    shape = parser.add_argument_group("its shape")
    shape.add_argument("--order", type=int, metavar="N", help="order of D")
    add_frequency(shape, "--cutoff", numbers, metavar="W", help="-3 dB frequency in rad/s")
    shape.add_argument("--type", type=int, metavar="K", help="zeros of 1 - F at s = 0 (default 1, N = a_0)")
    add_frequency(
        shape,
        "--zeros-at",
        numbers,
        metavar="W,W,...",
        help="further zeros of 1 - F, in rad/s; with --poles",
    )
    shape.add_argument("--noise", type=float, metavar="S", help="bound of the noise of x; with --slope")
    shape.add_argument(
        "--form", choices=get_args(Form), help="of N; with --slope, whose --order is the largest (default 2)"
    )
    sampling = parser.add_argument_group("sampled")
    sampling.add_argument("--dt", type=float, metavar="S", help="sampling interval in s")
    sampling.add_argument(
        "--method",
        choices=get_args(Method),
        help="discretisation (default matched where that keeps more than exact)",
    )
    output = parser.add_argument_group("output")
    add_frequency(
        output,
        "--at",
        numbers,
        metavar="W,W,...",
        help="also |F|, |1 - F| and phase lag at these, in rad/s",
    )
    output.add_argument("--picture", metavar="FILE", help="frequency response as png, pdf or svg")
    add_json(output)
    add_picture_units(output)
    output.add_argument("--out", metavar="FILTER.toml", help="write the filter")


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl design``; return the exit status.

    Raises
    ------
    ValueError, OSError
        If the options are wrong or a file cannot be read or written.
    """
    picture = None if options.picture == "none" else options.picture
    check_target(options.out, suffixes=(".toml",))
    check_target(picture, suffixes=(".png", ".pdf", ".svg"))
    refuse_units(options)
    source = _source(options)
    from .. import filterfile
    from ..filter import SampledPhyFilter, Sampling
    from .channels import by_channel, figures_below, responses, text_of

    promise = _promise(options)
    system, noted = _system(source, options, promise)
    about = system.sampling if isinstance(system, SampledPhyFilter) else Sampling(1.0, **noted)
    channels = by_channel(system, about.names)
    found = responses(channels)
    figures = {each.name: _figures(each.system, each, options.at or []) for each in found}
    if promise is not None:
        for each in figures.values():
            each["least_bound"] = {
                "bound": promise.bound.bound,
                "floor": promise.floor,
                "ratio": promise.ratio,
                "message": promise.message,
            }
    if options.json != "-":
        print(text_of({each.name: _text(each, figures[each.name]) for each in found}))
        if promise is not None:
            above = f"{promise.bound.bound:.4g}, {promise.ratio:.4g} times the floor {promise.floor:.4g}"
            print(f"{'worst error':<12}{above}\n{promise.message}")
    if options.json is not None:
        write_json(options.json, figures_below(figures))
    if options.out is not None:
        filterfile.save(options.out, system, **noted)  # pyright: ignore[reportArgumentType]  # names: no file has a number
    if picture is not None:
        import matplotlib

        matplotlib.use("Agg")  # a file is all that is wanted; there may be no display
        write_figure(picture, found.plot(dB=options.db, Hz=options.hz).figure)
    return 0


# -- options to filter ------------------------------------------------------------------------------------------


def _promise(options: argparse.Namespace) -> LeastBound | None:
    """The filter of least worst-case error, where that is asked for."""
    if options.slope is None:
        return None
    from ..design.optimal import least_bound

    return least_bound(
        2 if options.order is None else options.order,
        residual={1: options.slope},
        noise=options.noise,
        form=options.form or "lowpass",
        type=1 if options.type is None else options.type,
    )


def _system(
    source: str, options: argparse.Namespace, promise: LeastBound | None
) -> tuple[PhyFilter | FilterBank | SampledPhyFilter, ChannelOptions]:
    """The filter, and what its file notes of its channels where it is not sampled."""
    from ..filter import SampledPhyFilter, Sampling

    system, noted = _chosen(source, options, promise)
    if options.dt is None:
        return system, noted
    if isinstance(system, SampledPhyFilter):
        usual = SampledPhyFilter(system.filters, options.dt).sampling.method
        sampling = replace(system.sampling, dt=options.dt, method=options.method or usual)
        return replace(system, sampling=sampling), noted
    sampled = SampledPhyFilter(
        system, options.dt if options.method is None else Sampling(options.dt, options.method)
    )
    return replace(sampled, sampling=sampled.sampling.told(**noted)), {}


def _source(options: argparse.Namespace) -> str:
    """Which of the options the filter comes from, once they go together."""
    if options.bandpass is None and options.family is not None:
        source = "--family"
        given = [source, *_given(options, ("file", "--poles", "--slope"))]
    else:
        given = _given(options, ("file", "--poles", "--bandpass", "--slope"))
        source = given[0] if given else ""
    if len(given) != 1:
        raise ValueError(
            "expected one of FILTER.toml, --poles, --family, --bandpass and --slope, got "
            + (" and ".join(given) if given else "none of them; try: phyfilter-ctl design --poles -20,-20")
        )
    allowed = {
        "file": (),
        "--poles": ("--type", "--zeros-at"),
        "--family": ("--order", "--cutoff", "--type"),
        "--bandpass": ("--order", "--family"),
        "--slope": ("--order", "--type", "--noise", "--form"),
    }[source]
    shape = ["--order", "--cutoff", "--type", "--zeros-at", "--noise", "--form"]
    shape += ["--family"] if source != "--family" else []
    if excess := [name for name in _given(options, tuple(shape)) if name not in allowed]:
        raise ValueError(f"{excess[0]} does not go with {'a filter file' if source == 'file' else source}")
    if source == "--slope" and options.noise is None:
        raise ValueError("--slope needs --noise, the bound of the noise of x")
    if source == "--bandpass" and (count := len(options.bandpass or [])) != 2:
        raise ValueError(f"--bandpass: expected LOW,HIGH, got {count} numbers")
    if source == "--family":
        for name in ("--order", "--cutoff"):
            if not _given(options, (name,)):
                raise ValueError(f"--family {options.family} needs {name}")
        if len(options.cutoff) != 1:
            raise ValueError(f"--cutoff: expected one frequency, got {len(options.cutoff)}")
    if options.method is not None and options.dt is None:
        raise ValueError("--method needs --dt, the sampling interval in s")
    return source


def _chosen(
    source: str, options: argparse.Namespace, promise: LeastBound | None
) -> tuple[PhyFilter | FilterBank | SampledPhyFilter, ChannelOptions]:
    """The filter before sampling, and what its file notes."""
    if source == "file":
        from ..filterfile.document import read_noted

        return read_noted(options.file)
    return _made(source, options, promise), {}


def _made(source: str, options: argparse.Namespace, promise: LeastBound | None) -> PhyFilter:
    if promise is not None:
        return promise.filter
    from ..design import bandpass, lowpass, place_poles

    kind = 1 if options.type is None else options.type
    if source == "--poles":
        return place_poles(options.poles, type=kind, zeros_at=options.zeros_at or [])
    if source == "--bandpass":
        low, high = options.bandpass
        order = 2 if options.order is None else options.order
        return bandpass(order, low, high, family=options.family or "butterworth")
    return lowpass(options.order, options.cutoff[0], family=options.family, type=kind)


def _given(options: argparse.Namespace, names: tuple[str, ...]) -> list[str]:
    return [name for name in names if getattr(options, name.removeprefix("--").replace("-", "_")) is not None]


# -- filter to figures ------------------------------------------------------------------------------------------


def _figures(
    system: PhyFilter | SampledPhyFilter, response: FilterResponse, at: list[float]
) -> dict[str, object]:
    """What the JSON holds; infinite ones are words, undefined ones null."""
    from ..filter import PhyFilter, SampledPhyFilter

    filter = system if isinstance(system, PhyFilter) else system.filter
    if at:
        from ..analysis.frequency import frequency_response

        there = frequency_response(system, at)
        values = zip(there.omega, abs(there.F), abs(there.error), there.phase_lag(), strict=True)
        table = [
            dict(zip(("omega", "F", "error", "phase_lag"), map(float, row), strict=True)) for row in values
        ]
    else:
        table = []
    figures: dict[str, object] = {
        "a": filter.a,
        "b": filter.b,
        "poles": filter.poles,
        "order": filter.order,
        "type": filter.type,
        "dc_gain": filter.dc_gain,
        "bandwidth": response.bandwidth,
        "band_edges": response.band_edges,
        "peak": response.peak,
        "error_peak": response.error_peak,
        "noise_gain": response.noise_gain,
        "at": table,
    }
    if isinstance(system, SampledPhyFilter):
        figures["sampled"] = {"dt": system.dt, "method": system.sampling.method}
    return figures


def _text(response: FilterResponse, figures: dict[str, object]) -> str:
    from .._signals import in_both
    from ..design import hz
    from ..filter import PhyFilter, SampledPhyFilter

    system = response.system
    filter = system if isinstance(system, PhyFilter) else system.filter
    low, high = response.band_edges
    lines = {"bandwidth": f"{in_both(low)} to {in_both(high)}" if low > 0.0 else in_both(high)}
    lines["peak |F|"] = f"{response.peak.value:.4g} at {in_both(response.peak.omega)}"
    lines["peak |1-F|"] = f"{response.error_peak.value:.4g} at {in_both(response.error_peak.omega)}"
    sampled = isinstance(system, SampledPhyFilter)
    unit = (
        "1/s (f_hat per white noise on x, both standard deviations)"
        if sampled
        else "(white noise of unit density)"
    )
    lines["noise gain"] = f"{response.noise_gain:.4g} {unit}"
    if isinstance(system, SampledPhyFilter):
        lines["sampled"] = f"every {system.dt:g} s, {system.sampling.method}"
    text = [filter.describe(), *(f"{name:<12}{value}" for name, value in lines.items())]
    table = figures["at"]
    if isinstance(table, list) and table:
        text.append(f"{'rad/s':>12}{'Hz':>12}{'|F|':>12}{'|1-F|':>12}{'lag [deg]':>12}")
        for row in table:
            lag = math.degrees(row["phase_lag"])
            cells = (row["omega"], row["omega"] / hz(1.0), row["F"], row["error"], lag)
            text.append("".join(f"{cell:>12.4g}" for cell in cells))
    return "\n".join(text)
