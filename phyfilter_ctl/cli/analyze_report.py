"""The page of ``phyfilter-ctl analyze --report``: verdict, figures and pictures of each filter."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .._output import replacing
from ..analysis import BoundResult, FilterResponse, PriorMargin
from ..analysis.verdict import on_error, on_loop
from ..app.steps import settling_time, step_response
from ..filter import PhyFilter
from ..plots import PoleSet, ReportPage, report_html, report_pdf

__all__ = ["write_report"]

Told = tuple[FilterResponse, PriorMargin, BoundResult | None, str]


def write_report(
    told: Mapping[str, Told], residual: dict[int, float], noise: float, options: argparse.Namespace
) -> None:
    """Write the page of each filter, as the designer's report is drawn, where ``--report`` says.

    Parameters
    ----------
    told : mapping
        For each channel its response, its margins with f_hat fed back, its bound, and the text that is printed.
    residual, noise
        The bounds that were asked for.
    options : argparse.Namespace
    """
    pages = [_page(name, each, residual, noise, options) for name, each in told.items()]
    data = report_pdf(pages) if options.report.lower().endswith(".pdf") else report_html(pages).encode()
    with replacing(options.report) as file:
        file.write(data)


def _page(
    name: str, told: Told, residual: dict[int, float], noise: float, options: argparse.Namespace
) -> ReportPage:
    from .. import __version__  # at the call: the root imports the rooms

    response, margin, bound, text = told
    filter = response.system if isinstance(response.system, PhyFilter) else response.system.filter
    said = on_loop(margin, margin.delay_margin if margin.is_stable else 0.0)
    if bound is not None and margin.is_stable:
        said.append(on_error(bound.bound, "", residual.get(1, 0.0), ""))
    described = filter.describe().splitlines()
    lines = [line.strip() for line in text.splitlines()[len(described) :] if line.strip()]
    figures = [re.split(r"\s{2,}", line, maxsplit=1) for line in lines]
    called = Path(options.file).name
    return ReportPage(
        title=f"{called}: {name}" if name else called,
        verdict=[(each.text, each.level) for each in said],
        figures=[(label, value[0] if value else "", "") for label, *value in figures],
        filter=described,
        assumptions=[
            *((f"|gamma^({k})| up to", f"{size:g}") for k, size in residual.items()),
            ("noise of x", f"{noise:g}"),
            ("actuator lag", f"{options.lag or 0.0:g} s"),
            ("delay", f"{options.delay:g} s"),
        ],
        curve=response.curve("this filter"),
        step=np.array(step_response(filter, settling_time(filter))),
        poles=PoleSet("this filter", filter.poles, filter.zeros),
        version=__version__,
    )
