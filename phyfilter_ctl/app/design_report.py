"""A design on one page: what the designer says of it, as HTML or PDF."""

from __future__ import annotations

import base64
from typing import Literal, cast

import numpy as np

from ..analysis import frequency_response
from ..plots.poles import PoleSet
from ..plots.report_pages import ReportPage, report_html, report_pdf
from . import answers, exports
from .designs import Design
from .meeting import drawn_limits
from .python_text import family_of, python_text

__all__ = ["report"]


def report(design: Design, format: Literal["html", "pdf"], name: str) -> dict[str, object]:
    """The reply to op "report".

    Parameters
    ----------
    design : Design
    format : {"html", "pdf"}
    name : str
        Asked for, of the file and the title; empty: after the design.

    Returns
    -------
    dict
        name, digest, mime, base64.
    """
    page = _page(design, name)
    data = report_html([page]).encode() if format == "html" else report_pdf([page])
    title, digest = exports.titled(design, name, repr(design.as_json()))
    mime = "text/html" if format == "html" else "application/pdf"
    return {
        "name": f"{title}-{digest}-report.{format}",
        "digest": digest,
        "mime": mime,
        "base64": base64.b64encode(data).decode("ascii"),
    }


def _page(design: Design, name: str) -> ReportPage:
    from .. import __version__  # at the call: the root imports the rooms

    answer = answers.answer(design)
    filter, assume = design.filter, design.assume
    verdict = cast("list[dict[str, str]]", answer["verdict"])
    numbers = cast("list[dict[str, object]]", answer["numbers"])
    step = cast("dict[str, list[float]]", answer["step"])
    unit = f" {assume.unit}" if assume.unit else ""
    named = family_of(filter)
    return ReportPage(
        title=name.strip()
        or (f"pf.{named.call}" if named else f"Filter of order {filter.order}, type {filter.type}"),
        verdict=[(each["text"], each["level"]) for each in verdict],
        figures=[(str(each["label"]), _value(each), str(each.get("note", ""))) for each in numbers],
        filter=[*filter.describe().splitlines(), *python_text(design).strip().splitlines()[2:]],
        assumptions=[
            ("slope of the residual up to", f"{assume.slope:g}{unit}/s"),
            ("noise of x", f"{assume.noise:g} (standard deviation)"),
            ("M_hat/M", f"{assume.ratio:g}"),
            ("actuator lag", f"{assume.lag:g} s"),
            ("delay", f"{assume.delay:g} s"),
            ("step", f"{design.dt:g} s"),
        ],
        curve=frequency_response(filter).curve("this filter"),
        step=np.array([step["t"], step["F"], step["E"]], dtype=float),
        poles=PoleSet("this filter", filter.poles, filter.zeros),
        limits=drawn_limits(design),
        version=__version__,
    )


def _value(figure: dict[str, object]) -> str:
    value = figure["value"]
    return f"{value:.4g} {figure['unit']}".strip() if isinstance(value, float) else "-"
