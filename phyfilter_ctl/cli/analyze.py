"""``phyfilter-ctl analyze``: what a filter promises, on one page."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import control as ct
import numpy as np

from .. import filterfile
from .._output import add_json, check_target, write_figure, write_json
from ..filter import PhyFilter, SampledPhyFilter
from ..recording import Recording
from .frequencies import add_picture_units
from .implementation import read_implementation

if TYPE_CHECKING:
    from .._sections import FloatArray
    from ..analysis import (
        BoundResult,
        FilterResponse,
        InertiaCertificate,
        LoopMargin,
        PriorMargin,
        SaturationMargin,
        TrackingTube,
    )
    from ..design.optimal import ResidualStatistics

__all__ = ["add_arguments", "main"]

_DESCRIPTION = """What a filter promises, on one page: its response, how large the error can become and how much
of it is noise, how wrong the inertia may be, what margins are left once f_hat is fed back."""

_EPILOG = """examples:
  phyfilter-ctl analyze filter.toml                                 response and margins of the inner loop
  phyfilter-ctl analyze filter.toml --slope 3 --noise 0.01          with |gamma'| <= 3 and noise of x
  phyfilter-ctl analyze filter.toml --slope 3 --rate 2 --implementation g.1=48 jitter=1e-4 x_step=0.001
  phyfilter-ctl analyze filter.toml --lag 0.1 --delay 0.02 --kp 10 --kd 6 --picture report.png
  phyfilter-ctl analyze filter.toml --log flight.csv --x vx,vy,vz   noise and bounds estimated from a flight
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
    data.add_argument(
        "--noise", type=float, default=0.0, metavar="S", help="bound, and deviation, of the noise of x"
    )
    data.add_argument("--inertia-error", type=float, default=0.0, metavar="D", help="bound of |M - M_hat|")
    data.add_argument("--rate", type=float, default=0.0, metavar="R", help="bound of |x'|")
    data.add_argument(
        "--inertia",
        type=float,
        default=1.0,
        metavar="M",
        help="|M_hat|, by which noise of x counts (default 1)",
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
        "--log", nargs="+", default=[], metavar="CSV", help="estimate slope and noise from flights"
    )
    data.add_argument("--x", default="vx,vy,vz", metavar="C,C,...", help="columns of x (default vx,vy,vz)")
    data.add_argument("--f-theta", metavar="C,C,...", help="columns of f_theta (default: none)")
    loop = parser.add_argument_group("the loop")
    loop.add_argument("--lag", type=float, metavar="S", help="first-order lag of the actuator in s")
    loop.add_argument("--delay", type=float, default=0.0, metavar="S", help="delay of the command in s")
    loop.add_argument("--kp", type=float, metavar="K", help="outer gain on position per unit inertia, 1/s^2")
    loop.add_argument("--kd", type=float, metavar="K", help="outer gain on velocity per unit inertia, 1/s")
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
    from ..design.optimal import residual_statistics
    from .channels import by_channel, figures_below, responses, text_of

    check_target(options.picture, suffixes=(".png", ".pdf", ".svg"))
    check_target(options.report, suffixes=(".html", ".pdf"))
    channels = by_channel(filterfile.load(options.file), filterfile.load_signals(options.file).channels)
    statistics = residual_statistics([_log(path, options) for path in options.log]) if options.log else None
    residual, noise = _bounds(options, statistics)
    pages = {each.name: _page(each, residual, noise, options) for each in responses(channels)}
    if options.json is not None:
        figures = figures_below({name: page.figures(statistics) for name, page in pages.items()})
        write_json(options.json, figures)
    if options.json != "-":
        print(text_of({name: _text(page, statistics) for name, page in pages.items()}))
    if options.picture is not None:
        _draw(list(pages.values()), options)
    if options.report is not None:
        from .analyze_report import write_report

        told = {
            name: (page.response, page.inner, page.bound, _text(page, None)) for name, page in pages.items()
        }
        write_report(told, residual, noise, options)
    return 0


@dataclass(frozen=True)
class _Page:
    """What one filter promises."""

    response: FilterResponse
    bound: BoundResult | None
    deviation: float | None
    inner: PriorMargin
    outer: LoopMargin | None
    saturated: dict[str, SaturationMargin]
    tube: TrackingTube | None
    inertia: dict[str, InertiaCertificate]

    def figures(self, statistics: ResidualStatistics | None) -> dict[str, object]:
        """What the JSON holds."""
        system = self.response.system
        return {
            "filter": system if isinstance(system, PhyFilter) else system.filter,
            "bandwidth": self.response.bandwidth,
            "error_peak": self.response.error_peak.value,
            "noise_gain": self.response.noise_gain,
            "statistics": statistics,
            "bound": self.bound,
            "noise_deviation": self.deviation,
            "inner_loop": self.inner,
            "complete_loop": self.outer,
            "saturated_loop": self.saturated or None,
            "tracking": self.tube,
            "moving_inertia": self.inertia or None,
        }


def _page(
    response: FilterResponse, residual: dict[int, float], noise: float, options: argparse.Namespace
) -> _Page:
    from ..analysis import (
        error_variance,
        loop_margin,
        moving_inertia,
        prior_margin,
        saturation_margin,
        tracking_tube,
        ultimate_bound,
    )

    system = response.system
    bound = None
    if residual:
        bound = ultimate_bound(
            system,
            residual=residual,
            noise=noise,
            inertia_error=options.inertia_error,
            rate=options.rate,
            inertia=options.inertia,
            implementation=read_implementation(options.implementation),
        )
    deviation = None
    if noise and isinstance(system, SampledPhyFilter):
        deviation = math.sqrt(error_variance(system, noise=noise).noise)
    actuator = None if options.lag is None else ct.tf([1.0], [options.lag, 1.0])
    inner = prior_margin(system, actuator=actuator, delay=options.delay)
    inertia = {}
    if options.inertia_ratio is not None:
        loop = {"ratios": options.inertia_ratio, "actuator": actuator, "delay": options.delay}
        inertia = {
            "constant M": moving_inertia(system, **loop, rate=0.0),
            "M of any speed": moving_inertia(system, **loop),
        }
    outer, saturated, tube = None, {}, None
    if options.kp is not None or options.kd is not None:
        kp, kd, delay = options.kp or 0.0, options.kd or 0.0, options.delay
        outer = loop_margin(system, kp=kp, kd=kd, actuator=actuator, delay=delay)
        saturated = {
            g: saturation_margin(system, kp=kp, kd=kd, actuator=actuator, delay=delay, g=g)
            for g in ("saturated", "commanded")
        }
        told = {k: size for k, size in residual.items() if k <= 1}
        if told and outer.is_stable and _has_tube(system, kp):
            tube = tracking_tube(
                system,
                kp=kp,
                kd=kd,
                actuator=actuator,
                delay=delay,
                residual=told,
                noise=noise,
                inertia=options.inertia,
            )
    return _Page(response, bound, deviation, inner, outer, saturated, tube, inertia)


def _has_tube(system: PhyFilter | SampledPhyFilter, kp: float) -> bool:
    """Whether there is a tube of the position: for a sampled filter that is told a held command."""
    sampled = isinstance(system, SampledPhyFilter)
    return kp > 0.0 and sampled and system.sampling.g == "hold" and not system.sampling.delay


def _draw(pages: list[_Page], options: argparse.Namespace) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from ..plots import analysis_plot, frequency_unit

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
    loops = {"inner loop": [page.inner.sensitivity(omega) for page in pages]}
    if outer := [page.outer.sensitivity(omega) for page in pages if page.outer is not None]:
        loops["complete loop"] = outer
    curves = [page.response.curve(page.response.label_in(*unit)) for page in pages]
    plot = analysis_plot(curves, omega, loops, growths, dB=options.db, Hz=options.hz)
    write_figure(options.picture, plot.figure)


def _log(path: str, options: argparse.Namespace) -> Recording:
    return Recording.from_csv(
        path,
        x=options.x.split(","),
        f_theta=None if options.f_theta is None else options.f_theta.split(","),
        label=None,
        g=None,
        features=None,
        inertia=None,
    )


def _bounds(
    options: argparse.Namespace, statistics: ResidualStatistics | None
) -> tuple[dict[int, float], float]:
    residual: dict[int, float] = {}
    for entry in options.residual:
        order, _, value = entry.partition("=")
        try:
            residual[int(order)] = float(value)
        except ValueError as error:
            raise ValueError(f"--residual: expected K=D such as 1=12, got {entry!r}") from error
    if options.slope is not None:
        residual[1] = options.slope
    if statistics is None:
        return residual, options.noise
    return residual or {1: statistics.slope.value}, options.noise or statistics.noise.value


# -- figures and text -------------------------------------------------------------------------------------------


def _text(page: _Page, statistics: ResidualStatistics | None) -> str:
    system, bound = page.response.system, page.bound
    lines = [_verdict(page), "", (system if isinstance(system, PhyFilter) else system.filter).describe()]
    if isinstance(system, SampledPhyFilter):
        lines.append(f"{'sampled':<12}every {system.dt:g} s, {system.sampling.method}")
    if statistics is not None:
        share = 100.0 * statistics.slope.share
        lines += [
            "",
            f"from the flights ({100.0 * statistics.confidence:g} % confidence)",
            _line(
                "noise of x",
                f"{statistics.noise.value:.4g}  ({statistics.noise.low:.4g} to {statistics.noise.high:.4g})",
            ),
            _line(
                "residual",
                f"deviation {statistics.deviation.value:.4g}, time constant {statistics.time_constant.value:.4g} s",
            ),
            _line(
                "largest |gamma'|",
                f"{statistics.slope.value:.4g}; {share:.3g} % of {statistics.block:.3g} s stay below",
            ),
        ]
    if bound is not None:
        lines += ["", "largest error f - f_hat"]
        lines += ["  " + line for line in bound.describe().splitlines()]
    if page.deviation is not None:
        lines.append(_line("noise of f_hat", f"{page.deviation:.4g} (standard deviation)"))
    lines += ["", "inner loop: f_hat fed back", *("  " + line for line in page.inner.describe().splitlines())]
    for name, found in page.inertia.items():
        low, high = found.ratios
        lines.append(_line(name, f"{found.status} for M_hat/M from {low:.4g} to {high:.4g}; {found.message}"))
    if page.outer is not None:
        lines += [
            "",
            "complete loop: with the outer gains",
            *("  " + line for line in page.outer.describe().splitlines()),
        ]
        excess = {g: f"{found.command_excess:.4g}" for g, found in page.saturated.items() if found.is_stable}
        if excess:
            told = f"{excess['saturated']} times its limit if told what acts, {excess['commanded']} if the command"
            lines.append(_line("command up to", f"{told}: stable"))
    if page.tube is not None:
        lines.append(
            _line("position error", f"{page.tube.radius:.4g} at most, while |f| is bounded as gamma is")
        )
    return "\n".join(lines)


def _verdict(page: _Page) -> str:
    """What it amounts to, of the complete loop's stability too where there is one."""
    from ..analysis.verdict import on_error, on_loop

    sentences = on_loop(page.inner, page.inner.delay_margin)
    if page.bound is not None and page.inner.is_stable:
        sentences.append(on_error(page.bound.bound, ""))
    text = " ".join(sentence.text for sentence in sentences)
    if page.outer is not None and not page.outer.is_stable:
        return f"Unstable with the outer gains. Without them: {text}"
    return text


def _line(name: str, text: str) -> str:
    return f"  {name:<18}{text}"
