"""A filter on one page, as HTML that needs nothing else or as PDF: what it promises in words, figures and pictures."""

from __future__ import annotations

import html
import io
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import NDArray

from ._style import COLOURS, SMALL
from .frequency import FrequencyCurve, FrequencyLimit, frequency_plot
from .poles import PoleSet, pole_plot

__all__ = ["ReportPage", "report_html", "report_pdf"]

_A4 = (8.27, 11.69)  # inches
_LINE = 0.0155  # of the page's height
_WIDE = 104  # letters of a line
_LEVELS = {"good": "#1b6e3c", "warn": "#8a4b00", "bad": "#a32020"}
_STYLE = """
body { max-width: 60rem; margin: 2rem auto; padding: 0 1rem; font: 15px/1.45 system-ui, sans-serif; color: #17202b; }
h1 { font-size: 1.5rem; margin: 0; } h2 { font-size: 1.05rem; margin: 1.4rem 0 0.3rem; }
.verdict { font-size: 1.1rem; font-weight: 600; } .good { color: #1b6e3c; }
.warn { color: #8a4b00; } .bad { color: #a32020; }
table { border-collapse: collapse; width: 100%; }
th, td { padding: 2px 14px 2px 0; text-align: left; vertical-align: top; }
th { font-weight: 400; } td.value { white-space: nowrap; font-weight: 600; } td.note { color: #57636f; }
code { white-space: pre-wrap; } svg { max-width: 100%; height: auto; } footer { margin-top: 1rem; color: #57636f; }
@media print { body { margin: 0; max-width: none; font-size: 11px; } section { break-inside: avoid; } }
"""


@dataclass(frozen=True)
class ReportPage:
    """What a report says of one filter.

    Attributes
    ----------
    title : str
    verdict : sequence of (text, level)
        Sentences, the most important first; level "good", "warn" or "bad".
    figures : sequence of (name, value, note)
        As text, with units.
    filter : sequence of str
        The filter's numbers, a line each.
    assumptions : sequence of (name, value)
    curve : FrequencyCurve
    step : (3, N) array
        Times in s, and the answers of F and 1 - F to a unit step.
    poles : PoleSet
    limits : sequence of FrequencyLimit
    version : str
        Of what made it.
    """

    title: str
    verdict: Sequence[tuple[str, str]]
    figures: Sequence[tuple[str, str, str]]
    filter: Sequence[str]
    assumptions: Sequence[tuple[str, str]]
    curve: FrequencyCurve
    step: NDArray[np.float64]
    poles: PoleSet
    limits: Sequence[FrequencyLimit] = ()
    version: str = ""

    @property
    def footer(self) -> str:
        """Who made it."""
        return f"phyfilter-ctl {self.version}".strip()


def report_html(pages: Sequence[ReportPage]) -> str:
    """The pages as one HTML file, its pictures in it as SVG.

    Parameters
    ----------
    pages : sequence of ReportPage

    Returns
    -------
    str
    """
    title = html.escape(pages[0].title)
    head = f'<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<title>{title}</title>\n'
    return f"{head}<style>{_STYLE}</style>\n" + "\n".join(_section(page) for page in pages) + "\n</html>\n"


def report_pdf(pages: Sequence[ReportPage]) -> bytes:
    """The pages as PDF, A4, one for each filter.

    Parameters
    ----------
    pages : sequence of ReportPage

    Returns
    -------
    bytes
    """
    held = io.BytesIO()
    with PdfPages(held, metadata={"Title": pages[0].title, "CreationDate": None}) as file:
        for page in pages:
            file.savefig(_sheet(page))
    return held.getvalue()


def _section(page: ReportPage) -> str:
    def table(rows: Sequence[Sequence[str]]) -> str:
        classes = ("name", "value", "note")
        lines = [
            f'<tr><th scope="row">{html.escape(row[0])}</th>'
            + "".join(
                f'<td class="{kind}">{html.escape(cell)}</td>'
                for kind, cell in zip(classes[1:], row[1:], strict=False)
            )
            + "</tr>"
            for row in rows
        ]
        return f"<table>{''.join(lines)}</table>"

    figure = Figure(figsize=(9.0, 6.2), layout="constrained")
    _pictures(page, figure)
    held = io.StringIO()
    figure.savefig(held, format="svg", metadata={"Date": None, "Creator": None})
    drawing = held.getvalue()
    drawing = drawing[drawing.index("<svg") :]
    words = " ".join(f'<span class="{level}">{html.escape(text)}</span>' for text, level in page.verdict)
    numbers = "\n".join(map(html.escape, page.filter))
    label = "Magnitude and phase of F and 1 - F, step response, poles and zeros"
    return f"""<section>
<h1>{html.escape(page.title)}</h1>
<p class="verdict">{words}</p>
<div role="img" aria-label="{label}">{drawing}</div>
<h2>Figures</h2>
{table(page.figures)}
<h2>Filter</h2>
<p><code>{numbers}</code></p>
<h2>Assumptions</h2>
{table(page.assumptions)}
<footer>{html.escape(page.footer)}</footer>
</section>"""


def _sheet(page: ReportPage) -> Figure:
    """One A4 page: pictures above, words below."""
    figure = Figure(figsize=_A4, layout=ConstrainedLayoutEngine(rect=(0.05, 0.0, 0.9, 1.0)))
    lines = _words(page)
    room = min(0.62, _LINE * (len(lines) + 2))
    parts = np.asarray(figure.subfigures(3, 1, height_ratios=[0.1, 0.9 - room, room]), dtype=object)
    top, middle, below = parts.ravel()
    top.text(0.0, 0.85, page.title, fontsize=15, fontweight="bold", va="top")
    verdict = textwrap.fill(" ".join(text for text, _ in page.verdict), 92)
    worst = min((level for _, level in page.verdict), key=("bad", "warn", "good").index, default="good")
    top.text(0.0, 0.5, verdict, fontsize=9.5, color=_LEVELS[worst], va="top", fontweight="bold")
    _pictures(page, middle)
    pitch = 1.0 / (len(lines) + 1)
    for k, (text, heading) in enumerate(lines):
        below.text(
            0.0,
            1.0 - pitch * (k + 0.6),
            text,
            fontsize=7.6,
            va="top",
            fontweight="bold" if heading else "normal",
        )
    below.text(1.0, 0.004, page.footer, fontsize=7, color="0.4", ha="right")
    return figure


def _words(page: ReportPage) -> list[tuple[str, bool]]:
    """Lines of text, and whether each is a heading."""
    lines = [("Figures", True)]
    for name, value, note in page.figures:
        said = f"{name}: {value}" + (f"   ({note})" if note else "")
        lines += [(part, False) for part in textwrap.wrap(said, _WIDE, subsequent_indent="      ")]
    lines.append(("Filter", True))
    lines += [(part, False) for line in page.filter for part in textwrap.wrap(line, _WIDE)]
    lines.append(("Assumptions", True))
    together = ", ".join(f"{name} {value}" for name, value in page.assumptions)
    return [*lines, *((part, False) for part in textwrap.wrap(together, _WIDE))]


def _pictures(page: ReportPage, figure: Figure | SubFigure) -> None:
    """Bode on the left, step response and poles on the right."""
    left, right = np.asarray(figure.subfigures(1, 2, width_ratios=[1.15, 1.0]), dtype=object).ravel()
    magnitude, phase = left.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    frequency_plot([page.curve], limits=page.limits, ax=(magnitude, phase), dB=True)
    step, plane = right.subplots(2, 1)
    t, F, error = page.step
    step.plot(t, F, color=COLOURS[0], label="estimate")
    step.plot(t, error, color=COLOURS[1], linestyle="--", label="error")
    step.set_xlabel("Time after a unit step of the residual [s]", fontsize=SMALL)
    step.tick_params(labelsize=SMALL)
    step.grid(True, color="0.9", linewidth=0.6)
    step.legend(fontsize="x-small", frameon=False)
    pole_plot([page.poles], ax=plane)
