"""What is wrong with a drawn figure, found by looking at where everything stands."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import combinations

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox

# Where pictures are read: a column of 736 pixels, letters of at least 8 (6 points of a page 8.4 inches wide).
COLUMN, LEAST = 736.0, 8.0
# Boxes of letters have some air; two that share no more than this many pixels of a 100 dpi drawing do not touch.
AIR = 1.5


def faults(figure: Figure) -> list[str]:
    """Texts that overlap, leave the figure or are too small; repeated styles; letters out of order; bars without foot.

    Parameters
    ----------
    figure : Figure
    """
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    axes = [each for each in figure.axes if each.get_visible()]
    legends = [found for found in (each.get_legend() for each in axes) if found is not None]
    legends += list(figure.legends)
    wrong = [*_small(figure), *_placed(figure, canvas, axes, legends), *_letters(figure, axes)]
    for legend in legends:
        wrong += _repeated(legend)
    for each in axes:
        wrong += _footless(each)
        shown = [(name, axis) for name, axis in (("x", each.xaxis), ("y", each.yaxis)) if axis.get_visible()]
        for name, axis in shown:
            if (
                each.axison
                and each.name == "rectilinear"
                and not axis.get_label_text()
                and _is_named_by_numbers(each, name)
            ):
                wrong.append(f"{_name(each)}: no label on {name}")
    return wrong


def _name(axes: Axes) -> str:
    return repr(axes.get_title(loc="left") or axes.get_ylabel())


def _texts(figure: Figure) -> Iterator[Text]:
    for text in figure.findobj(Text):
        if isinstance(text, Text) and text.get_visible() and text.get_text().strip():
            yield text


def _small(figure: Figure) -> Iterator[str]:
    scale = min(COLUMN / figure.get_size_inches()[0], 150.0) / 72.0
    for text in _texts(figure):
        if (size := text.get_fontsize() * scale) < LEAST:
            yield f"{text.get_text()!r}: {size:.1f} pixels high in a column of {COLUMN:g}, expected {LEAST:g}"


def _is_named_by_numbers(axes: Axes, name: str) -> bool:
    """Whether the ticks that are shown are numbers, which say nothing without a label."""
    axis = axes.xaxis if name == "x" else axes.yaxis
    words = [label.get_text() for label in axis.get_ticklabels() if label.get_visible() and label.get_text()]
    return bool(words) and all(_is_number(word) for word in words)


def _is_number(word: str) -> bool:
    return not any(letter.isalpha() for letter in word.replace("mathdefault", "").replace("times", ""))


def _placed(
    figure: Figure, canvas: FigureCanvasAgg, axes: list[Axes], legends: list[Legend]
) -> Iterator[str]:
    renderer, page = canvas.get_renderer(), figure.bbox
    boxes: list[tuple[str, Bbox]] = []
    for each in axes:
        if not each.get_visible():
            continue
        labels = [each.xaxis.label, each.yaxis.label, each.title, each._left_title]  # pyright: ignore
        labels += each.texts if each.name != "3d" else ()  # there their place is known while they are drawn
        for axis in (each.xaxis, each.yaxis):
            low, high = sorted(axis.get_view_interval())
            ticks = [tick for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
            labels += [tick.label1 for tick in ticks] if each.axison else []
        boxes += [
            (text.get_text(), text.get_window_extent(renderer))
            for text in labels
            if text.get_visible()
            and text.get_text().strip()
            and (not text.get_clip_on() or _inside(text, each, renderer))
        ]
    for legend in legends:
        boxes += [
            (text.get_text(), text.get_window_extent(renderer))
            for text in legend.get_texts()
            if text.get_text().strip()
        ]
    if figure._suptitle is not None:  # pyright: ignore
        boxes.append((figure._suptitle.get_text(), figure._suptitle.get_window_extent(renderer)))
    for name, box in boxes:
        if box.x0 < page.x0 - 1 or box.x1 > page.x1 + 1 or box.y0 < page.y0 - 1 or box.y1 > page.y1 + 1:
            yield f"{name!r} leaves the figure"
    for (name, box), (other, there) in combinations(boxes, 2):
        shared = Bbox.intersection(box, there)
        if shared is not None and min(shared.width, shared.height) > AIR * figure.dpi / 100.0:
            yield f"{name!r} covers {other!r}"


def _inside(text: Text, axes: Axes, renderer: object) -> bool:
    box, frame = text.get_window_extent(renderer), axes.bbox  # pyright: ignore
    return bool(box.x1 > frame.x0 and box.x0 < frame.x1 and box.y1 > frame.y0 and box.y0 < frame.y1)


def _letters(figure: Figure, axes: list[Axes]) -> Iterator[str]:
    """Of panels with letters: a, b, c, ... row after row."""
    titles = {each: each.get_title(loc="left") for each in axes}
    lettered = [each for each, title in titles.items() if title[1:3] == "  "]
    if lettered and len(lettered) != len([title for title in titles.values() if title]):
        yield f"panels with and without a letter: {list(titles.values())}"
    rows: dict[int, list[Axes]] = {}
    for each in sorted(lettered, key=lambda each: titles[each][0]):
        rows.setdefault(round(20.0 * each.get_position(original=True).y1), []).append(each)
    if sorted(titles[each][0] for each in lettered) != list("abcdefghijklmnopqrstuvwxyz")[: len(lettered)]:
        yield f"letters: {[titles[each] for each in lettered]}"
    for row in rows.values():
        if (
            len(row) > 1
            and [e.bbox.x0 for e in row] != sorted(e.bbox.x0 for e in row)
            and len({e.figure for e in row}) == 1
        ):
            yield f"letters do not run from left to right: {[titles[each] for each in row]}"


def _repeated(legend: Legend) -> Iterator[str]:
    """Entries of a legend that look alike."""
    looks = Counter[tuple[object, ...]]()
    for handle in legend.legend_handles:
        if isinstance(handle, Line2D) and handle.get_linestyle() + str(handle.get_marker()) != "NoneNone":
            looks[
                to_hex(handle.get_color()),
                str(handle._dash_pattern) if handle.get_linestyle() not in ("None", "") else "",  # pyright: ignore
                str(handle.get_marker()),
                to_hex(handle.get_markeredgecolor()),
                handle.get_fillstyle(),
                str(handle.get_markerfacecolor()),
                handle.get_markersize(),
            ] += 1
    for look, count in looks.items():
        if count > 1:
            names = [text.get_text() for text in legend.get_texts()]
            yield f"{count} entries of a legend look alike, {look}: {names}"


def _footless(axes: Axes) -> Iterator[str]:
    bars = [each for each in axes.containers if isinstance(each, BarContainer)]
    upright = [each for each in bars if each.orientation == "vertical"]
    if (upright and axes.get_yscale() == "log") or (len(bars) > len(upright) and axes.get_xscale() == "log"):
        yield f"{_name(axes)}: bars on a logarithmic axis"
    if any(isinstance(each, PolyCollection) and each.get_hatch() == "bars" for each in axes.collections):
        yield f"{_name(axes)}: hatched bars"
