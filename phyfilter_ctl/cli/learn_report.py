"""What ``phyfilter-ctl learn`` reports: the choice among the learned filters, the table, and the figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..results import Status, plain
from .flights import Flights

if TYPE_CHECKING:
    from ..design.learning import Form, LearnResult, WienerFloor

__all__ = ["Row", "best_of", "figures_of", "form_name", "table_of", "worse_than_none"]

# A filter of more coefficients is chosen where it lowers the RMSE by more than this share, and by more than a standard
# error where only the flights learned from are there to score on.
_WORTHWHILE = 1e-3


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    order: int
    form: Form
    result: LearnResult

    @property
    def score(self) -> float | None:
        """RMSE on what was not learned from; None where there was nothing."""
        if self.result.held_out_rmse is not None:
            return self.result.held_out_rmse
        if self.result.loop is not None:  # the folds know nothing of the loop
            return self.result.rmse if math.isfinite(self.result.rmse) else math.inf
        return None if self.result.wiener is None else self.result.wiener.filter_rmse

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return self.result.order_used * (2 if self.form == "general" else 1)


def best_of(rows: Sequence[Row]) -> Row:
    """Of the filters that score as well as any, the one of fewest coefficients; F identified, where any is."""
    rows = [row for row in rows if row.result.is_identified] or rows
    scores = {id(row): row.score for row in rows}
    if all(score is None for score in scores.values()):  # stopped before the first was scored
        scores = {id(row): row.result.rmse for row in rows}
    scored = [(row, score) for row in rows if (score := scores[id(row)]) is not None]
    top, least = min(scored, key=lambda entry: entry[1])
    good = [
        (row, score)
        for row, score in scored
        if score <= (1.0 + _WORTHWHILE) * least or _as_good(row.result, top.result)
    ]
    return min(good, key=lambda entry: (entry[0].size, entry[1]))[0]


def _as_good(one: LearnResult, best: LearnResult) -> bool:
    """Whether a filter is as good as the best on the folds that both were learned without."""
    from ..design.learning.validation import against

    floors = (one.wiener, best.wiener)
    if one.loop is not None or floors[0] is None or floors[1] is None or best.held_out_rmse is not None:
        return False
    return against(floors[0].filter_errors, floors[1].filter_errors, floors[1].are_flights)[2]


def _reason(rows: Sequence[Row], best: Row) -> str:
    """Why this one is the best."""
    if len(rows) < 2 or best.score is None:
        return ""
    if best.result.held_out_rmse is not None:
        return "fewest coefficients within 0.1 % of the least RMSE on the flights held out"
    if best.result.loop is not None:
        return (
            "fewest coefficients within 0.1 % of the least RMSE among those that keep the margin in the loop"
        )
    floor = best.result.wiener
    assert floor is not None  # it has a score
    what = f"{floor.blocks} flights or groups of them" if floor.are_flights else f"{floor.blocks} blocks"
    errors = "one standard error" if floor.are_flights else "two standard errors (few flights)"
    return f"fewest coefficients within {errors} of the least RMSE on {what} not learned from"


def _known(result: LearnResult) -> list[str]:
    """The 95 % intervals in words."""
    found = result.intervals
    if found is None:
        return []
    poles = []
    for p, (real, imaginary) in zip(found.poles, found.half_widths, strict=True):
        if p.imag >= 0.0:
            turn = f" +- {p.imag:.4g}j (+- {imaginary:.2g})" if p.imag else ""
            poles.append(f"{p.real:.4g} +- {real:.2g}{turn}")
    _, low, high = found.rmse
    gain, lowest, highest = found.dc_gain
    fixed = gain == lowest == highest == 1.0
    at_rest = "F(0) = 1 by construction" if fixed else f"F(0) {lowest:.3g} to {highest:.3g}"
    return [
        f"95 % intervals, from {found.kind}: RMSE {low:.4g} to {high:.4g}; {at_rest}",
        f"  poles in rad/s: {', '.join(poles)}",
    ]


def _flights(logs: Flights, result: LearnResult) -> list[str]:
    """The flights left out one by one."""
    if not result.flights:
        return []
    lines = ["", f"{'flight left out':<24}{'with it':>10}{'left out':>10}{'its own':>10}  (RMSE of the best)"]
    for score in result.flights:
        name = logs.names[score.flight] or f"flight {score.flight}"
        marks = "  <- disagrees" if score.disagrees else ""
        lines.append(
            f"{name[-23:]:<24}{_cell(score.rmse)}{_cell(score.left_out_rmse)}{_cell(score.own_rmse)}{marks}"
        )
    return lines


def form_name(form: Form) -> str:
    """The form as the tables call it."""
    return "low-pass" if form == "lowpass" else form


def worse_than_none(logs: Flights, held_out: Flights, channels: Sequence[str], best: Row) -> str:
    """That the best filter is no better than f_theta alone on what it was not learned from; empty where it is."""
    alone = (held_out if held_out.logs else logs).alone(channels)
    if best.score is None or alone is None or best.score < alone:
        return ""
    return (
        f"no filter is better than none: RMSE {best.score:.4g} with the best, {alone:.4g} with f_theta alone; look at "
        "the units, signs, clocks and frames of x, label, g and inertia"
    )


def table_of(
    logs: Flights,
    held_out: Flights,
    channels: Sequence[str],
    rows: Sequence[Row],
    best: Row,
) -> str:
    """The text: one line a filter, and the best of them described."""
    count, held = len(logs.logs), f", {len(held_out.logs)} held out" if held_out.logs else ""
    lines = [
        f"{count} {'flight' if count == 1 else 'flights'}{held}: {logs.samples} samples of "
        f"{', '.join(channels)}, every {1e3 * best.result.dt:.4g} ms",
        "",
        f"{'RMSE of label - f_hat':<24}{'training':>10}{'blocks':>10}{'held out':>10}  "
        f"{'ratio to Wiener floor':<25}  status",
    ]
    name = "f_theta alone" if any(each.has_f_theta for each in logs.summaries) else "f_theta = 0 alone"
    lines.append(f"{name:<24}{_cell(logs.alone(channels))}{_cell(None)}{_cell(held_out.alone(channels))}")
    for row in rows:
        result, floor = row.result, row.result.wiener
        name = f"order {row.order}, {form_name(row.form)}"
        ratio = (
            "-"
            if floor is None
            else f"{floor.ratio:.3f} ({floor.interval[0]:.3f} to {floor.interval[1]:.3f})"
            + ("" if floor.is_reliable else " ?")
        )
        used = f", order {result.order_used} used" if result.order_used < row.order else ""
        lines.append(
            f"{name:<24}{_cell(result.rmse)}{_cell(None if floor is None else floor.filter_rmse)}"
            f"{_cell(result.held_out_rmse)}  {ratio:<25}  {result.status}{used}{'  <- best' if row is best else ''}"
        )
    chosen = best.result
    if any(row.result.wiener is not None and not row.result.wiener.is_reliable for row in rows):
        lines.append(
            "?: the Wiener filter is no floor here, too little is known of its taps; give longer flights"
        )
    reason = _reason(rows, best)
    lines += [
        "",
        f"best: order {chosen.order_used}, {form_name(best.form)} form{': ' + reason if reason else ''}",
        chosen.filter.describe(),
        *_known(chosen),
        *_flights(logs, chosen),
    ]
    said = [
        row.result.message
        for row in rows
        if (
            row.result.status in (Status.NOT_IDENTIFIED, Status.ORDER_ADDS_NOTHING)
            and (row.result.status is Status.NOT_IDENTIFIED or row.result.orders)
        )
        or (row is best and (chosen.status is not Status.CONVERGED or chosen.loop is not None))
    ]
    lines += [f"note: {text}" for text in (*said, *chosen.notes)]
    return "\n".join(lines)


def _cell(value: float | None) -> str:
    return f"{'-' if value is None else format(value, '.4g'):>10}"


def figures_of(
    logs: Flights,
    held_out: Flights,
    channels: Sequence[str],
    rows: Sequence[Row],
    best: Row,
) -> dict[str, object]:
    """What the JSON holds; infinite ones are words, null is what is not known."""
    return {
        "logs": logs.names,
        "held_out": held_out.names,
        "skipped": {**logs.skipped, **held_out.skipped},
        "samples": logs.samples,
        "channels": list(channels),
        "dt": best.result.dt,
        "method": best.result.method,
        "f_theta": {"rmse": logs.alone(channels), "held_out_rmse": held_out.alone(channels)},
        "filters": [_entry(row) for row in rows],
        "best": rows.index(best),
        "reason": _reason(rows, best),
        "notes": list(best.result.notes),
        "history": [[e.order, e.start, e.iteration, max(e.cost, 0.0)] for e in best.result.history],
    }


def _entry(row: Row) -> dict[str, object]:
    result = row.result
    return {
        "order": row.order,
        "form": row.form,
        "order_used": result.order_used,
        "status": result.status,
        "message": result.message,
        "rmse": result.rmse,
        "loop": None if result.loop is None else {"spare": result.loop.spare, "price": result.loop.price},
        "held_out_rmse": result.held_out_rmse,
        "wiener": None if result.wiener is None else _floor(result.wiener),
        "costs": result.costs,
        "orders": result.orders,
        "flights": result.flights,
        "intervals": result.intervals,
        **plain(result.filter, infinite=True),
    }


def _floor(floor: WienerFloor) -> dict[str, object]:
    return {
        "rmse": floor.rmse,
        "filter_rmse": floor.filter_rmse,
        "ratio": floor.ratio,
        "interval": floor.interval,
        "reliable": floor.is_reliable,
        "taps": len(floor.taps),
    }
