"""The page inside an FMU that says what it is, and its icon."""

from __future__ import annotations

import io
import itertools
import re
import struct
import zlib
from collections.abc import Sequence
from functools import cache, lru_cache
from html import escape
from math import prod

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from .._sections import FloatArray
from ..filter import PhyFilter
from .description import FmuInterface, InterfaceVariable

__all__ = ["bode_picture", "documentation_page", "icon_png", "icon_svg", "terminal_png"]

_STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:52em;margin:2em auto;padding:0 1em}table{border-collapse:collapse}"
    "td,th{border-bottom:1px solid #ccc;padding:.2em .8em .2em 0;text-align:left;vertical-align:top}"
    "pre{background:#f4f4f4;padding:.6em}svg{max-width:100%;height:auto}"
)
_POINTS = 200
_DECADES = 2.0  # of frequency shown beyond the slowest and the fastest pole
_SIZE = 100  # pixels of the icon
_LOWEST_GAIN = 1e-6  # -120 dB: nothing is drawn below


def documentation_page(
    interface: FmuInterface,
    *,
    filters: Sequence[PhyFilter] = (),
    notes: Sequence[str] = (),
    sources_only: bool = False,
) -> str:
    """documentation/index.html: formula, Bode picture, how it runs, and every variable.

    Parameters
    ----------
    interface : FmuInterface
    filters : sequence of PhyFilter
        What to draw the Bode picture of.
    notes : sequence of str
        Texts to show as they are.
    sources_only : bool
        Whether the FMU has no binary.
    """
    model = interface.model
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        f"<title>{escape(model.name)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{escape(model.name)}</h1>",
    ]
    if interface.description:
        parts.append(f"<p>{escape(interface.description)}</p>")
    if sources_only:
        parts.append(
            "<p><strong>This FMU has no binary: no C compiler was found when it was made.</strong> Its folder "
            "<code>sources</code> has all that is needed to build one, for example with "
            "<code>fmpy.build.build_platform_binary</code>.</p>"
        )
    if model.formula:
        parts.append(f"<pre>{escape(model.formula)}</pre>")
    if filters:
        parts.append(bode_picture(filters))
    parts += [f"<pre>{escape(note)}</pre>" for note in notes]
    parts += [f"<p>{escape(sentence)}</p>" for sentence in _how_it_runs(interface)]
    for kind, title in (
        ("input", "Inputs"), ("output", "Outputs"), ("parameter", "Parameters, tunable while running"),
        ("fixed", "Parameters of the start"), ("state", "Continuous states"), ("sampled", "States of sampled blocks"),
        ("local", "Signals inside"), ("clock", "Clocks of sampled blocks"),
        ("structure", "Sizes, chosen in Configuration Mode"),
        ("condition", "Conditions of events, which are event indicators in model exchange"),
    ):  # fmt: skip
        chosen = [variable for variable in interface.variables if variable.kind == kind]
        if chosen:
            parts.append(f"<h2>{title}</h2>{_table(chosen)}")
    parts.append("</body></html>")
    return "\n".join(parts) + "\n"


def _how_it_runs(interface: FmuInterface) -> list[str]:
    model, solver = interface.model, interface.solver
    sentences = []
    if interface.simulation and model.communication:
        sentences.append(
            "Co-simulation: one sample per communication step, over the time that has passed, on the inputs set before "
            f"the step; nominally {model.communication:g} s. Set the inputs of the step's end: with those of its "
            "beginning f_hat is a communication step late, and the first sample counts twice."
        )
    if model.tasks:
        listed = ", ".join(f"{name} every {period:g} s" for name, period in model.tasks)
        sentences.append(
            f"Sampled blocks: {listed}, first at the start. An instant at the end of a communication step belongs to "
            "that step; in Event Mode of FMI 3 it sees the inputs set there."
        )
    if interface.simulation and model.states:
        method = "classical Runge-Kutta" if solver.method == "rk4" else "Dormand-Prince 5(4), adaptive"
        bound = f", steps of at most {solver.step:g} s (parameter solver.step)" if solver.step else ""
        sentences.append(f"Co-simulation: {method}{bound}; communication steps may have any length.")
    if interface.exchange and model.communication:
        sentences.append(f"Model exchange: a time event every {model.communication:g} s takes a sample.")
    if model.parameters:
        sentences.append(
            "Parameters that are set while running are checked together and come into force at the next communication "
            "step or at the end of Event Mode; if they are refused, the old ones stay and the log says why."
        )
    return sentences


def _table(variables: Sequence[InterfaceVariable]) -> str:
    rows = []
    for variable in variables:
        size = "" if not variable.shape else " &times; ".join(str(n) for n in variable.shape)
        start = "" if variable.start is None else _starts(variable.start)
        cells = (escape(variable.name), size, escape(variable.unit), start, escape(variable.description))
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    head = "<tr><th>name</th><th>size</th><th>unit</th><th>start</th><th></th></tr>"
    return f"<table>{head}{''.join(rows)}</table>"


def _starts(values: Sequence[float]) -> str:
    return f"{values[0]:.10g}" if len(set(values)) == 1 else ", ".join(f"{value:.10g}" for value in values)


def bode_picture(filters: Sequence[PhyFilter]) -> str:
    """Magnitude and phase of F and magnitude of 1 - F as SVG; the same text every time.

    Parameters
    ----------
    filters : sequence of PhyFilter

    Examples
    --------
    >>> bode_picture([PhyFilter([400.0, 40.0])]).startswith("<svg")
    True
    """
    return _bode_picture(tuple(filters))


@lru_cache(maxsize=8)  # one filter is exported more than once: for FMI 2 and 3, for each part of a package
def _bode_picture(filters: tuple[PhyFilter, ...]) -> str:
    omega = _frequencies(filters)
    # Plain rcParams of matplotlib, whatever the user has set, and no identifiers from the clock.
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update({"svg.hashsalt": "phyfilter", "svg.fonttype": "none", "font.size": 9})
        figure = Figure(figsize=(6.5, 4.2))
        canvas = FigureCanvasSVG(figure)
        gain, phase = figure.subplots(2, 1, sharex=True)
        figure.subplots_adjust(0.11, 0.11, 0.98, 0.98, hspace=0.08)
        for i, one in enumerate(filters):
            index = "" if len(filters) == 1 else f"{i}"
            colour = f"C{i}"
            F = np.asarray(one(1j * omega))
            gain.loglog(omega, np.maximum(np.abs(F), _LOWEST_GAIN), color=colour, label=f"|F{index}|")
            error = np.maximum(np.abs(np.asarray(one.error(1j * omega))), _LOWEST_GAIN)
            gain.loglog(omega, error, "--", color=colour, label=f"|1 - F{index}|")
            phase.semilogx(omega, np.degrees(np.unwrap(np.angle(F))), color=colour)
        gain.set_ylabel("magnitude")
        gain.legend()
        phase.set_ylabel("phase of F (deg)")
        phase.set_xlabel("frequency (rad/s)")
        for axis in (gain, phase):
            axis.grid(True, alpha=0.3)
        stream = io.StringIO()
        canvas.print_svg(stream, metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    return _lean(text[text.index("<svg") :].strip())


def _lean(svg: str) -> str:
    """A drawing without what no viewer needs: it is half of an FMU's texts otherwise."""
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    referred = set(re.findall(r"#([\w.]+)", svg))
    svg = re.sub(r' id="([^"]*)"', lambda found: found[0] if found[1] in referred else "", svg)
    return re.sub(r"\d+\.\d{3,}", lambda found: f"{float(found[0]):.2f}", svg)  # hundredths of a point


def _frequencies(filters: Sequence[PhyFilter]) -> FloatArray:
    sizes = np.abs(np.concatenate([one.poles for one in filters]))
    ends = np.log10([sizes.min(), sizes.max()]) + np.array([-_DECADES, _DECADES])
    return np.logspace(np.floor(ends[0]), np.ceil(ends[1]), _POINTS)


# ---- icon ----

_CURVE = ((18, 42), (48, 42), (60, 48), (86, 76))  # a low-pass from the left, in pixels


def icon_svg() -> str:
    """terminalsAndIcons/icon.svg."""
    points = " ".join(f"{x},{y}" for x, y in _CURVE)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_SIZE} {_SIZE}">'
        '<rect x="4" y="4" width="92" height="92" fill="#fff" stroke="#222" stroke-width="4"/>'
        '<path d="M18 18V82H86" fill="none" stroke="#999" stroke-width="2"/>'
        f'<polyline points="{points}" fill="none" stroke="#1f77b4" stroke-width="5"/></svg>\n'
    )


@cache
def icon_png() -> bytes:
    """terminalsAndIcons/icon.png, and model.png of FMI 2: the same picture as :func:`icon_svg`."""
    y, x = np.mgrid[0:_SIZE, 0:_SIZE] + 0.5
    image = np.full((_SIZE, _SIZE, 3), 255, dtype=np.uint8)
    inside = (np.abs(x - 50) < 48) & (np.abs(y - 50) < 48)
    image[inside & ((np.abs(x - 50) > 44) | (np.abs(y - 50) > 44))] = (0x22, 0x22, 0x22)
    image[_near(x, y, ((18, 18), (18, 82), (86, 82))) < 1.0] = (0x99, 0x99, 0x99)
    image[_near(x, y, _CURVE) < 2.5] = (0x1F, 0x77, 0xB4)
    return _png(image)


@cache
def terminal_png() -> bytes:
    """terminalsAndIcons/terminal.png: a black square."""
    return _png(np.zeros((16, 16, 3), dtype=np.uint8))


def _near(x: FloatArray, y: FloatArray, points: Sequence[tuple[int, int]]) -> FloatArray:
    """Distance from each pixel to a line of straight pieces."""
    distance = np.full(x.shape, np.inf)
    for (x0, y0), (x1, y1) in itertools.pairwise(points):
        dx, dy = x1 - x0, y1 - y0
        along = np.clip(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
        distance = np.minimum(distance, np.hypot(x - x0 - along * dx, y - y0 - along * dy))
    return distance


def _png(image: np.ndarray) -> bytes:
    height, width = image.shape[:2]
    rows = np.zeros(
        (height, 1 + prod(image.shape[1:])), dtype=np.uint8
    )  # each row begins with its filter, 0: none
    rows[:, 1:] = image.reshape(height, -1)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows.tobytes(), 9))
        + chunk(b"IEND", b"")
    )
