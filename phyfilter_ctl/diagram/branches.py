"""Both sides of every ``if`` of a Python function, as one CasADi expression.

The function is run once for each way through it. A way is the list of the answers given where it asked for a truth
value; the answers that were not given yet are what is run next.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path as FilePath

import casadi as ca

__all__ = [
    "Decision",
    "DefaultsError",
    "Path",
    "UntraceableError",
    "Way",
    "current",
    "key_of",
    "merged",
    "place_of",
    "ways",
]

# Ways through one function, and conditions on one; entries of a table that a signal picks.
MOST_WAYS, MOST_CONDITIONS = 256, 80
MOST_ENTRIES = 64
# Depth to which expressions of two ways are compared.
_ALIKE = 100
_HERE = FilePath(__file__).parent


class UntraceableError(Exception):
    """Something in a function has no CasADi expression."""


class DefaultsError(ValueError):
    """The functions of a block read one parameter with different defaults."""


@dataclass(frozen=True, eq=False)
class Decision:
    """A truth value that a function asked for, and the answer on this way.

    Parameters
    ----------
    condition : casadi.SX
    margin : casadi.SX
        Changes its sign, or leaves 0, where the condition changes.
    key : str
        The same for equal conditions.
    taken : bool
    picks : bool
        Whether an index is compared with an entry of its table; no signal may ever pick some of them.
    """

    condition: ca.SX
    margin: ca.SX
    key: str
    taken: bool
    picks: bool


@dataclass(eq=False)
class Path:
    """One run of the function: the answers it starts with, and all that were given."""

    prefix: Sequence[bool]
    signals: ca.SX
    ended: dict[tuple[tuple[bool, ...], int], int]
    decisions: list[Decision] = field(default_factory=list)
    _picked: tuple[tuple[tuple[bool, ...], int], int] | None = None

    def decide(self, condition: ca.SX, margin: ca.SX | None = None) -> bool:
        """The answer to a condition on this way; the one given before where it is asked again."""
        if condition.is_constant():
            return bool(float(condition) != 0)
        self._picked = None
        return self._answer(key_of(condition), condition, condition if margin is None else margin, False)

    def _answer(self, key: str, condition: ca.SX, margin: ca.SX, picks: bool) -> bool:
        for decision in self.decisions:
            if decision.key == key:
                return decision.taken
        place = len(self.decisions)
        if place >= MOST_CONDITIONS:
            raise UntraceableError("a loop runs until a signal says so")
        taken = self.prefix[place] if place < len(self.prefix) else True
        self.decisions.append(Decision(condition, margin, key, taken, picks))
        return taken

    def index(self, expression: ca.SX) -> int:
        """An integer that a signal picks, from 0 up, then from -1 down, until the table ends."""
        if expression.is_constant():
            return int(float(expression))
        if not ca.depends_on(expression, self.signals):
            raise UntraceableError("a parameter counts or picks")
        self._picked = None
        taken, key = tuple(decision.taken for decision in self.decisions), key_of(expression)
        for sign in (1, -1):
            # The entry that ended the table is asked for each time, so that equal answers mean equal questions.
            end = self.ended.get((taken, sign), MOST_ENTRIES + 1)
            for number in count(0 if sign > 0 else 1):
                if number > end:
                    break
                if number >= MOST_ENTRIES:
                    raise UntraceableError("a signal picks a number of which there are too many")
                entry = sign * number
                if self._answer(f"{key} is {entry}", expression == entry, expression - entry, True):
                    self._picked = (taken, sign), number
                    return entry
        raise IndexError("beyond both ends of the table")

    def ends(self) -> None:
        """The table does not have the entry that was picked last."""
        if self._picked is not None:
            key, number = self._picked
            self.ended[key] = min(self.ended.get(key, number), number)


def key_of(expression: ca.SX) -> str:
    """The same for equal expressions of the same symbols; printed, numbers would lose digits and symbols be names."""
    text = ca.StringSerializer()
    text.pack(expression)
    return f"{text.encode()}{[symbol.element_hash() for symbol in ca.symvar(expression)]}"


_current: ContextVar[Path] = ContextVar("path")


def current() -> Path:
    """The run that is under way."""
    try:
        return _current.get()
    except LookupError:
        raise UntraceableError("a traced number has left its function") from None


@dataclass(frozen=True, eq=False)
class Way:
    """One way through a function.

    Parameters
    ----------
    decisions : list of Decision
    value : casadi.SX or None
        Column of results; None where the function raises.
    error : Exception or None
    """

    decisions: Sequence[Decision]
    value: ca.SX | None
    error: Exception | None

    @property
    def off_table(self) -> bool:
        """Whether it is an index beyond the end of a list or array that ends it."""
        return isinstance(self.error, IndexError)


def ways(body: Callable[[], ca.SX], signals: ca.SX) -> list[Way]:
    """All ways through a function of signals.

    Raises
    ------
    UntraceableError
        Where one of them cannot be traced, or there are too many.
    """
    pending: list[tuple[bool, ...]] = [()]
    ended: dict[tuple[tuple[bool, ...], int], int] = {}
    found: list[Way] = []
    while pending:
        path = Path(pending.pop(), signals, ended)
        token = _current.set(path)
        try:
            found.append(Way(path.decisions, body(), None))
        except (UntraceableError, DefaultsError, RecursionError):
            raise
        except Exception as error:
            if isinstance(error, IndexError):
                path.ends()
            found.append(Way(path.decisions, None, error))
        finally:
            _current.reset(token)
        taken = [decision.taken for decision in path.decisions]
        pending += [(*taken[:i], not taken[i]) for i in range(len(path.prefix), len(taken))]
        if len(found) > MOST_WAYS:
            raise UntraceableError(f"it has more than {MOST_WAYS} ways through its branches")
    return found


def merged(found: Sequence[Way], size: int, depth: int = 0) -> ca.SX:
    """One expression; not-a-number where the function raises."""
    first = found[0]
    if len(found) == 1 and len(first.decisions) <= depth:
        return ca.SX.nan(size) if first.value is None else first.value
    sides = [[way for way in found if way.decisions[depth].taken is side] for side in (True, False)]
    if not all(sides):
        return merged(sides[0] or sides[1], size, depth + 1)
    yes, no = (ca.densify(merged(side, size, depth + 1)) for side in sides)
    condition = first.decisions[depth].condition
    # Entry by entry: one that is the same on both sides does not switch.
    entries = [
        yes[i] if ca.is_equal(yes[i], no[i], _ALIKE) else ca.if_else(condition, yes[i], no[i])
        for i in range(size)
    ]
    return ca.vertcat(*entries) if entries else ca.SX(0, 1)


def place_of(error: BaseException) -> str:
    """Line of the user's file at which an error arose, with its text."""
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if FilePath(frame.filename).parent != _HERE
        and not {"numpy", "casadi"} & set(FilePath(frame.filename).parts)
    ]
    if not frames:
        return ""
    # What can be changed, rather than the line inside a library that it calls.
    own = [frame for frame in frames if "site-packages" not in frame.filename] or frames
    text = f": {own[-1].line}" if own[-1].line else ""
    return f"{FilePath(own[-1].filename).name}, line {own[-1].lineno}, in {own[-1].name}{text}"
