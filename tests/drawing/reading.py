"""What an SVG text really draws: straight lines with the signal of their group, closed shapes, texts with their widths.

Shares no code with the layout: the text is parsed, its style sheet is read, and widths are those of DejaVu Sans, which
is the widest of the fonts that a browser takes for a sans-serif one; its files come with matplotlib.
"""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import matplotlib
from fontTools.ttLib import TTFont

SVG = "{http://www.w3.org/2000/svg}"
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
# Parts of the size of a letter above and below its line.
ASCENT, DESCENT = 0.73, 0.21


class Box(NamedTuple):
    x0: float
    y0: float
    x1: float
    y1: float

    def grown(self, by: float) -> Box:
        return Box(self.x0 - by, self.y0 - by, self.x1 + by, self.y1 + by)

    def holds(self, other: Box) -> bool:
        return self.x0 <= other.x0 and self.y0 <= other.y0 and other.x1 <= self.x1 and other.y1 <= self.y1

    def overlaps(self, other: Box) -> bool:
        return min(self.x1, other.x1) > max(self.x0, other.x0) and min(self.y1, other.y1) > max(
            self.y0, other.y0
        )


@dataclass(frozen=True)
class Letters:
    """A text as drawn: baseline point, size, and how it is set."""

    text: str
    x: float
    y: float
    size: float
    anchor: str
    bold: bool
    italic: bool

    @cached_property
    def box(self) -> Box:
        return letters_box(self.text, self.x, self.y, self.size, self.anchor, self.bold, self.italic)


@dataclass(frozen=True)
class Drawn:
    """Of an SVG text: (signal, x0, y0, x1, y1) of each straight line in a net, boxes of closed shapes, texts, dots."""

    lines: tuple[tuple[str, float, float, float, float], ...]
    shapes: tuple[Box, ...]
    texts: tuple[Letters, ...]
    dots: tuple[tuple[float, float], ...]
    crooked: tuple[str, ...]


@cache
def _font(bold: bool, italic: bool) -> tuple[dict[int, str], dict[str, tuple[int, int]], int]:
    name = {
        (False, False): "",
        (True, False): "-Bold",
        (False, True): "-Oblique",
        (True, True): "-BoldOblique",
    }
    font = TTFont(Path(matplotlib.get_data_path(), "fonts", "ttf", f"DejaVuSans{name[bold, italic]}.ttf"))
    return font.getBestCmap(), font["hmtx"].metrics, font["head"].unitsPerEm


@cache
def width(text: str, size: float, bold: bool = False, italic: bool = False) -> float:
    """Width of a text; marks that combine, such as a hat, have none."""
    names, metrics, units = _font(bold, italic)
    letters = (letter for letter in text if not unicodedata.combining(letter))
    return sum(metrics[names.get(ord(letter), ".notdef")][0] for letter in letters) * size / units


def letters_box(text: str, x: float, y: float, size: float, anchor: str, bold: bool, italic: bool) -> Box:
    wide = width(text, size, bold, italic)
    left = x - {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor] * wide
    return Box(left, y - ASCENT * size, left + wide, y + DESCENT * size)


def read(svg: str) -> Drawn:
    """All that an SVG text draws; what it draws and this does not know is an error."""
    reader = _Reader()
    root = ElementTree.fromstring(svg)
    reader.sheet = [rule for style in root.iter(f"{SVG}style") for rule in _rules(style.text or "")]
    reader.visit(root, {}, "", (0.0, 0.0))
    return Drawn(
        tuple(reader.lines),
        tuple(reader.shapes),
        tuple(reader.texts),
        tuple(reader.dots),
        tuple(reader.crooked),
    )


def _rules(sheet: str) -> list[tuple[str, dict[str, str]]]:
    """(selector, properties) of the plain rules; those for media are colours."""
    plain = re.sub(r"@media[^{]*\{(?:[^{}]*\{[^{}]*\})*[^{}]*\}|/\*.*?\*/", "", sheet, flags=re.DOTALL)
    rules: list[tuple[str, dict[str, str]]] = []
    for selectors, body in re.findall(r"([^{}]+)\{([^{}]*)\}", plain):
        rules += [(selector.strip(), _properties(body)) for selector in selectors.split(",")]
    return rules


def _properties(body: str) -> dict[str, str]:
    pairs = (part.split(":", 1) for part in body.split(";") if ":" in part)
    found = {key.strip(): value.strip() for key, value in pairs}
    if "font" in found and (shorthand := re.search(rf"({_NUMBER})px", found["font"])):
        found["font-size"] = shorthand[1]
        found |= {"font-weight": "bold"} if "bold" in found["font"] else {}
        found |= {"font-style": "italic"} if "italic" in found["font"] else {}
    return found


class _Reader:
    def __init__(self) -> None:
        self.sheet: list[tuple[str, dict[str, str]]] = []
        self.lines: list[tuple[str, float, float, float, float]] = []
        self.shapes: list[Box] = []
        self.texts: list[Letters] = []
        self.dots: list[tuple[float, float]] = []
        self.crooked: list[str] = []

    def style(self, element: ElementTree.Element, above: dict[str, str]) -> dict[str, str]:
        """Properties of an element: inherited, its attributes, the sheet's, its own."""
        tag, classes = element.tag.removeprefix(SVG), set(element.get("class", "").split())
        found = above | {
            key: value for key, value in element.attrib.items() if key.startswith(("font", "text-"))
        }
        for selector, properties in self.sheet:
            last = selector.split()[-1]
            name, *wanted = last.split(".")
            if set(wanted) <= classes and name in ("", tag, "*") and not re.search(r"[:>\[#]", last):
                found = found | properties
        return found | _properties(element.get("style", ""))

    def visit(
        self, element: ElementTree.Element, above: dict[str, str], signal: str, at: tuple[float, float]
    ) -> None:
        tag = element.tag.removeprefix(SVG)
        if tag in ("title", "desc", "style", "defs", "marker", "metadata"):
            return
        style, at = self.style(element, above), _moved(element, at)
        signal = element.get("data-signal", signal)
        if tag == "text":
            self.text(element, style, at)
            return
        if tag in ("path", "polyline", "line", "polygon", "rect", "circle", "ellipse"):
            self.shape(tag, element, signal, at)
        elif tag not in ("svg", "g", "a"):
            raise ValueError(f"<{tag}>: the checker does not know how it is drawn")
        for child in element:
            self.visit(child, style, signal, at)

    def text(self, element: ElementTree.Element, style: dict[str, str], at: tuple[float, float]) -> None:
        """A text; parts in <tspan> of their own place are texts of their own."""
        if any(child.get("x") or child.get("dx") for child in element):
            raise ValueError("a <tspan> with a place of its own: every run is expected to be a text")
        size = float(re.sub("px$", "", style.get("font-size", "16")))
        bold = style.get("font-weight", "") in ("bold", "600", "700")
        self.texts.append(
            Letters(
                "".join(element.itertext()), float(element.get("x", 0)) + at[0], float(element.get("y", 0)) + at[1],
                size, style.get("text-anchor", "start"), bold, style.get("font-style") in ("italic", "oblique"),
            )
        )  # fmt: skip

    def shape(self, tag: str, element: ElementTree.Element, signal: str, at: tuple[float, float]) -> None:
        def number(key: str) -> float:
            return float(element.get(key, 0))

        if tag in ("circle", "ellipse"):
            x, y = number("cx") + at[0], number("cy") + at[1]
            rx, ry = (number("r"), number("r")) if tag == "circle" else (number("rx"), number("ry"))
            if signal:
                self.dots.append((x, y))
            else:
                self.shapes.append(Box(x - rx, y - ry, x + rx, y + ry))
            return
        if tag == "rect" and element.get("width") == "100%":
            return  # the paper
        if tag == "rect":
            x, y = number("x") + at[0], number("y") + at[1]
            self.shapes.append(Box(x, y, x + number("width"), y + number("height")))
            return
        for points, closed, straight in _strokes(tag, element):
            moved = [(x + at[0], y + at[1]) for x, y in points]
            if signal and straight and not closed:
                # A slanted stroke across a wire says that it is a vector.
                level = ((a, b) for a, b in pairwise(moved) if (a[0] == b[0]) != (a[1] == b[1]))
                self.lines += [(signal, *a, *b) for a, b in level]
            elif signal and not straight:
                self.crooked.append(signal)
            elif closed and not signal:
                xs, ys = [x for x, _ in moved], [y for _, y in moved]
                self.shapes.append(Box(min(xs), min(ys), max(xs), max(ys)))


def _moved(element: ElementTree.Element, at: tuple[float, float]) -> tuple[float, float]:
    transform = element.get("transform", "")
    if not transform:
        return at
    found = re.fullmatch(rf"translate\(\s*({_NUMBER})[ ,]+({_NUMBER})\s*\)", transform.strip())
    if found is None:
        raise ValueError(f"transform {transform!r}: only translate is expected")
    return at[0] + float(found[1]), at[1] + float(found[2])


def _strokes(tag: str, element: ElementTree.Element) -> list[tuple[list[tuple[float, float]], bool, bool]]:
    """(points, closed, straight) of each stroke; of a curve its end points."""
    if tag == "line":
        x0, y0, x1, y1 = (float(element.get(key, 0)) for key in ("x1", "y1", "x2", "y2"))
        return [([(x0, y0), (x1, y1)], False, True)]
    if tag in ("polyline", "polygon"):
        numbers = [float(number) for number in re.findall(_NUMBER, element.get("points", ""))]
        points = list(zip(numbers[::2], numbers[1::2], strict=True))
        return [(points, tag == "polygon", True)]
    strokes: list[tuple[list[tuple[float, float]], bool, bool]] = []
    x = y = 0.0
    for command, body in re.findall(
        r"([A-Za-z])([^A-Za-z]*)", re.sub(r"(?<=\d)[eE](?=[-+\d])", "E", element.get("d", ""))
    ):
        values = [float(number) for number in re.findall(_NUMBER, body)]
        kind, own = command.upper(), command.islower()
        if kind == "Z":
            points, _, straight = strokes.pop()
            strokes.append((points, True, straight))
            x, y = points[0]
            continue
        step = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7}[kind]
        for i in range(0, len(values), step):
            given = values[i : i + step]
            if kind == "H":
                x = given[0] + own * x
            elif kind == "V":
                y = given[0] + own * y
            else:
                x, y = given[-2] + own * x, given[-1] + own * y
            if kind == "M" and i == 0:
                strokes.append(([(x, y)], False, True))
            else:
                points, closed, straight = strokes.pop()
                strokes.append(([*points, (x, y)], closed, straight and kind in "MLHV"))
    return strokes
