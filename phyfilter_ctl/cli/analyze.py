"""``phyfilter-ctl analyze``: what a filter promises, on one page."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from .._output import add_json, check_target, write_figure, write_json
from .frequencies import add_picture_units
from .implementation import read_implementation
from .unused import refuse_units, refuse_unused

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .._sections import FloatArray
    from ..analysis import Analysis
    from ..design.optimal import ResidualStatistics
    from ..recording import Recording

__all__ = ["add_arguments", "main"]

_DESCRIPTION = """What a filter promises, on one page: its response, how large the error can become and how much
of it is noise, how wrong the inertia may be, what margins are left once f_hat is fed back."""

_EPILOG = """examples:
  phyfilter-ctl analyze filter.toml                                 response and margins of the inner loop
  phyfilter-ctl analyze filter.toml --slope 3 --noise 0.01          with |gamma'| <= 3 and noise of x
  phyfilter-ctl analyze filter.toml --slope 3 --rate 2 --implementation g.1=48 jitter=1e-4 x_step=0.001
  phyfilter-ctl analyze filter.toml --lag 0.1 --delay 0.02 --kp 10 --kd 6 --picture report.png
  phyfilter-ctl analyze filter.toml --log flight.csv --x vx,vy,vz   slope and noise estimated from a flight
  phyfilter-ctl analyze filter.toml --slope 3 --report report.html  verdict, figures and pictures on one page"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl analyze``."""
    parser.description, parser.epilog = _DESCRIPTION, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("file", metavar="FILTER.toml", help="a filter file")
    data = parser.add_argument_group("what is known of the data")
    data.add_argument("--slope", type=float, metavar="D", help="bound of |gamma'|, gamma = f - f_theta")
    data.add_argument(
        "--residual",
        nargs="+",
        default=[],
        metavar="K=D",
        help="bounds of derivatives of gamma by order: 0=4 1=12",
    )
    data.add_argument("--noise", type=float, default=0.0, metavar="B", help="bound of the noise of x")
    data.add_argument(
        "--noise-deviation",
        type=float,
        default=0.0,
        metavar="S",
        help="standard deviation of the noise of x, independent from sample to sample; part of no bound",
    )
    data.add_argument("--inertia-error", type=float, default=0.0, metavar="D", help="bound of |M - M_hat|")
    data.add_argument("--rate", type=float, metavar="R", help="bound of |x'|; --inertia-error needs it")
    data.add_argument(
        "--inertia",
        type=float,
        metavar="M",
        help="|M_hat|, by which noise of x counts (default: the file's, else 1)",
    )
    data.add_argument(
        "--implementation",
        nargs="+",
        default=[],
        metavar="NAME=D",
        help="what a sampled filter meets as it runs, bounds by derivative where there is one: g.1=48 (|g'|), "
        "f_theta.1, inertia.1 (|M_hat'|), x.2 (|x''|), jitter and delay_error in s, x_step, g_step; x.0, g.0 and "
        "f_theta.0 for the rounding, or rounding as fixed point has it, f for a limit of f_hat",
    )
    data.add_argument(
        "--log",
        nargs="+",
        default=[],
        metavar="CSV",
        help="estimate the slope and the deviation of the noise from flights",
    )
    data.add_argument("--time", metavar="COLUMN", help="times of --log in s (default t)")
    data.add_argument("--x", metavar="C,C,...", help="columns of x (default vx,vy,vz)")
    data.add_argument("--f-theta", metavar="C,C,...", help="columns of f_theta (default: none)")
    loop = parser.add_argument_group("the loop")
    loop.add_argument("--lag", type=float, metavar="S", help="first-order lag of the actuator in s")
    loop.add_argument("--delay", type=float, default=0.0, metavar="S", help="delay of the command in s")
    loop.add_argument("--kp", type=float, metavar="K", help="outer gain on position per unit inertia, 1/s^2")
    loop.add_argument("--kd", type=float, metavar="K", help="outer gain on velocity per unit inertia, 1/s")
    loop.add_argument(
        "--g",
        choices=("commanded", "applied"),
        default="commanded",
        help="what the filter is told: the command (default), or the force that acts, lag and delay and all",
    )
    loop.add_argument(
        "--inertia-ratio",
        nargs=2,
        type=float,
        metavar=("LOW", "HIGH"),
        help="whether M_hat/M may be anywhere in between, constant and moving at any speed",
    )
    output = parser.add_argument_group("output")
    add_json(output)
    output.add_argument("--picture", metavar="FILE", help="the page as png, pdf or svg")
    output.add_argument(
        "--report", metavar="FILE", help="one page a filter, verdict, figures, pictures: html or pdf"
    )
    add_picture_units(output)


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl analyze``; return the exit status.

    Raises
    ------
    ValueError, OSError
        If the options are wrong or a file cannot be read or written.
    """
    check_target(options.picture, suffixes=(".png", ".pdf", ".svg"))
    check_target(options.report, suffixes=(".html", ".pdf"))
    refuse_units(options)
    refuse_unused(options, dict.fromkeys(("time", "x", "f_theta"), (options.log, "--log")))
    known = options.log or options.residual or options.slope is not None
    refuse_unused(options, {"implementation": (known, "a bound: --slope, --residual or --log")})
    from ..analysis import analyze
    from ..design.optimal import residual_statistics
    from ..filter import SampledPhyFilter, Sampling
    from ..filterfile.document import read_noted
    from ..values import Bounded, Loop
    from .channels import by_channel, figures_below, text_of

    filter, noted = read_noted(options.file)
    # A sampled filter knows its channels, inertia and units itself.
    about = filter.sampling if isinstance(filter, SampledPhyFilter) else Sampling(1.0, **noted)
    channels = by_channel(filter, about.names)
    statistics = residual_statistics([_log(path, options) for path in options.log]) if options.log else None
    residual = _residual(options, statistics)
    deviation = options.noise_deviation
    if statistics is not None and not deviation:
        deviation = statistics.noise.value
    loop = Loop(options.kp or 0.0, options.kd or 0.0, options.lag, options.delay, g=options.g)
    bounds = Bounded(
        residual or {},
        noise=options.noise,
        inertia_error=options.inertia_error,
        rate=options.rate,
        implementation=read_implementation(options.implementation) if residual else None,
    )
    pages = {}
    for i, (name, system) in enumerate(channels.items()):
        sampled = isinstance(system, SampledPhyFilter)
        M_hat = None if sampled else _noted_inertia(about.inertia, i if name else None)
        page = analyze(
            system,
            loop,
            bounds,
            noise_deviation=deviation if sampled or options.noise_deviation else 0.0,
            inertia=M_hat if options.inertia is None else options.inertia,
            ratios=options.inertia_ratio,
        )
        pages[name] = page if sampled else replace(page, unit=about.units.get("f", ""))
    if options.json is not None:
        figures = {name: page.to_dict() | {"statistics": statistics} for name, page in pages.items()}
        write_json(options.json, figures_below(figures))
    told = [] if statistics is None else _from_flights(statistics)
    if options.json != "-":
        print(text_of({name: "\n".join([page.describe(), *told]) for name, page in pages.items()}))
    if options.picture is not None:
        _draw(pages, options)
    if options.report is not None:
        from .analyze_report import write_report

        write_report(pages, residual, options)
    return 0


def _noted_inertia(inertia: ArrayLike | None, channel: int | None) -> ArrayLike | None:
    """What the file of a continuous filter notes of M_hat, of one channel where each has a filter of its own."""
    import numpy as np

    if inertia is None or channel is None or not np.ndim(inertia):
        return inertia
    M = np.asarray(inertia)
    return M[channel] if M.ndim == 1 else M[channel, channel]


def _draw(named: Mapping[str, Analysis], options: argparse.Namespace) -> None:
    import matplotlib
    import numpy as np

    matplotlib.use("Agg")
    from ..filter import PhyFilter
    from ..plots._units import frequency_unit
    from ..plots.promises import analysis_plot

    pages = list(named.values())
    omega, unit = pages[0].response.omega, frequency_unit(options.hz)
    growths: list[tuple[FloatArray, FloatArray, float]] = []
    for page in pages:
        if (
            page.bound is not None
            and page.bound.certificate is not None
            and isinstance(page.bound.system, PhyFilter)
        ):
            times = np.linspace(0.0, 0.6 * page.bound.certificate.horizon, 500)
            growths.append((times, page.bound.envelope(times), page.bound.bound))
    loops = {"inner loop": [page.inner_loop.sensitivity(omega) for page in pages]}
    if outer := [page.complete_loop.sensitivity(omega) for page in pages if page.complete_loop is not None]:
        loops["complete loop"] = outer
    responses = [replace(page.response, name=name) for name, page in named.items()]
    curves = [response.curve(response.label_in(*unit)) for response in responses]
    plot = analysis_plot(curves, omega, loops, growths, dB=options.db, Hz=options.hz)
    write_figure(options.picture, plot.figure)


def _log(path: str, options: argparse.Namespace) -> Recording:
    from ..recording import Recording

    return Recording.read(
        path,
        time=options.time,
        x=(options.x or "vx,vy,vz").split(","),
        f_theta=None if options.f_theta is None else options.f_theta.split(","),
        label=None,
        g=None,
        features=None,
        inertia=None,
    )


def _residual(options: argparse.Namespace, statistics: ResidualStatistics | None) -> dict[int, float]:
    residual: dict[int, float] = {}
    for entry in options.residual:
        order, _, value = entry.partition("=")
        try:
            residual[int(order)] = float(value)
        except ValueError as error:
            raise ValueError(f"--residual: expected K=D such as 1=12, got {entry!r}") from error
    if options.slope is not None:
        if not options.slope >= 0.0:
            raise ValueError(f"--slope: expected a bound >= 0, got {options.slope:g}")
        if 1 in residual:
            raise ValueError(
                f"--slope is --residual 1=D: expected one of them, got {options.slope:g} and {residual[1]:g}"
            )
        residual[1] = options.slope
    return residual if residual or statistics is None else {1: statistics.slope.value}


def _from_flights(statistics: ResidualStatistics) -> list[str]:
    """What the flights say, as lines."""
    noise, slope, said = statistics.noise, statistics.slope, 100.0 * statistics.confidence
    lines = {
        "noise of x": f"deviation {noise.value:.4g}  ({noise.low:.4g} to {noise.high:.4g})",
        "residual": f"deviation {statistics.deviation.value:.4g}, time constant {statistics.time_constant.value:.4g} s",
        "largest |gamma'|": f"{slope.value:.4g}; {100.0 * slope.share:.3g} % of {statistics.block:.3g} s stay below",
    }
    return [
        "",
        f"from the flights ({said:g} % confidence)",
        *(f"  {k:<18}{text}" for k, text in lines.items()),
    ]
