"""The page of ``phyfilter-ctl analyze --report``: verdict, figures and pictures of each filter."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .._output import replacing
from ..analysis import Analysis
from ..app.steps import settling_time, step_response
from ..plots.poles import PoleSet
from ..plots.report_pages import ReportPage, report_html, report_pdf

__all__ = ["write_report"]


def write_report(
    analyses: Mapping[str, Analysis], residual: dict[int, float], options: argparse.Namespace
) -> None:
    """Write the page of each filter, as the designer's report is drawn, where ``--report`` says.

    Parameters
    ----------
    analyses : mapping
        What each channel promises.
    residual
        The bounds that were asked for.
    options : argparse.Namespace
    """
    pages = [_page(name, each, residual, options) for name, each in analyses.items()]
    data = report_pdf(pages) if options.report.lower().endswith(".pdf") else report_html(pages).encode()
    with replacing(options.report) as file:
        file.write(data)


def _page(name: str, found: Analysis, residual: dict[int, float], options: argparse.Namespace) -> ReportPage:
    from .. import __version__  # at the call: the root imports the rooms

    filter = found.filter
    lines = [line.strip() for line in found.details() if line.strip()]
    figures = [re.split(r"\s{2,}", line, maxsplit=1) for line in lines]
    called = Path(options.file).name
    return ReportPage(
        title=f"{called}: {name}" if name else called,
        verdict=[(each.text, each.level) for each in found.verdict],
        figures=[(label, value[0] if value else "", "") for label, *value in figures],
        filter=filter.describe().splitlines(),
        assumptions=[
            *((f"|gamma^({k})| up to", f"{size:g}") for k, size in residual.items()),
            ("noise of x", f"{options.noise:g} at most"),
            ("actuator lag", f"{options.lag or 0.0:g} s"),
            ("delay", f"{options.delay:g} s"),
            ("filter is told", "the command" if options.g == "commanded" else "what acts"),
        ],
        curve=found.response.curve("this filter"),
        step=np.array(step_response(filter, settling_time(filter))),
        poles=PoleSet("this filter", filter.poles, filter.zeros),
        version=__version__,
    )
