"""Wrong lines to try a suite with: every place of a source at which one small thing can be changed, by kind."""

from __future__ import annotations

import ast
import random
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

OPERATOR, COMPARISON, CONSTANT = "operator", "comparison", "constant"
SIGN, BOUNDARY, DROPPED = "sign", "boundary", "dropped statement"
KINDS = (OPERATOR, COMPARISON, CONSTANT, SIGN, BOUNDARY, DROPPED)

_OPERATORS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"), ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"), ast.Pow: ("**", "*"), ast.MatMult: ("@", "*"), ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"), ast.And: ("and", "or"), ast.Or: ("or", "and"),
}  # fmt: skip
_COMPARISONS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Lt: ("<", ">="), ast.GtE: (">=", "<"), ast.Gt: (">", "<="), ast.LtE: ("<=", ">"), ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="), ast.In: ("in", "not in"), ast.NotIn: ("not in", "in"), ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
}  # fmt: skip
_BOUNDARIES: dict[type[ast.AST], tuple[str, str]] = {
    ast.Lt: ("<", "<="), ast.LtE: ("<=", "<"), ast.Gt: (">", ">="), ast.GtE: (">=", ">"),
}  # fmt: skip
_TEXTS = (ast.JoinedStr, ast.List, ast.Tuple)  # times which a number repeats


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    Attributes
    ----------
    file : str
        From the top of the checkout.
    kind : str
        One of :data:`KINDS`.
    line, statement : int
        Where it is, and where its statement begins; from 1.
    inside : bool
        Whether it is in a function; else it runs when the module is imported.
    before, after : str
        What stands there.
    begin, end : int
        Bytes of the file that are replaced.
    """

    file: str
    kind: str
    line: int
    statement: int
    inside: bool
    before: str
    after: str
    begin: int
    end: int

    def applied(self, source: str) -> str:
        """The source with the change in it."""
        raw = source.encode()
        return (raw[: self.begin] + self.after.encode() + raw[self.end :]).decode()


def mutants(file: str, source: str) -> list[Mutant]:
    """All that there are of a source, in order.

    Examples
    --------
    >>> for each in mutants("a.py", "def f(x):\\n    return 2 if x < 3 else -x\\n"):
    ...     print(each.kind, each.line, each.before, "->", each.after)
    comparison 2 < -> >=
    boundary 2 < -> <=
    constant 2 3 -> 4
    constant 2 2 -> 3
    sign 2 -x -> x
    """
    return _Finder(file, source).found


def drawn(
    candidates: Sequence[Mutant], count: int, seed: int, fits: Callable[[Mutant], bool] = lambda _: True
) -> list[Mutant]:
    """``count`` of those that fit, at random, equally many of each kind as far as there are so many."""
    chance = random.Random(seed)
    piles: Mapping[str, list[Mutant]] = {kind: [c for c in candidates if c.kind == kind] for kind in KINDS}
    for pile in piles.values():
        chance.shuffle(pile)
    chosen: list[Mutant] = []
    while len(chosen) < count and any(piles.values()):
        for pile in piles.values():
            while pile and not fits(pile[-1]):
                pile.pop()
            if pile and len(chosen) < count:
                chosen.append(pile.pop())
    return chosen


def compiles(mutant: Mutant, source: str) -> bool:
    """Whether the source with the change in it is Python."""
    try:
        compile(mutant.applied(source), mutant.file, "exec", dont_inherit=True)
    except (SyntaxError, ValueError):
        return False
    return True


class _Finder(ast.NodeVisitor):
    def __init__(self, file: str, source: str) -> None:
        self._file, self._raw = file, source.encode()
        self._lines = [0]
        for line in self._raw.splitlines(keepends=True):
            self._lines.append(self._lines[-1] + len(line))
        self._statement, self._depth = 1, 0
        self.found: list[Mutant] = []
        self.visit(ast.parse(source))

    # -- places ------------------------------------------------------------------------------------------------

    def _begin(self, node: ast.expr | ast.stmt) -> int:
        return self._lines[node.lineno - 1] + node.col_offset

    def _end(self, node: ast.expr | ast.stmt) -> int:
        return self._lines[(node.end_lineno or 1) - 1] + (node.end_col_offset or 0)

    def _note(self, kind: str, begin: int, end: int, after: str) -> None:
        line = self._raw.count(b"\n", 0, begin) + 1
        before = self._raw[begin:end].decode()
        inside = self._depth > 0
        self.found.append(Mutant(self._file, kind, line, self._statement, inside, before, after, begin, end))

    def _symbol(
        self, kind: str, left: ast.expr, right: ast.expr, change: tuple[str, str] | None, extra: str = ""
    ) -> None:
        """Change of what stands between two operands."""
        if change is None:
            return
        begin, end = self._end(left), self._begin(right)
        between = self._raw[begin:end].decode()
        word = re.escape(change[0] + extra).replace(r"\ ", r"\s+")
        match = re.search(word, between)
        if match and "#" not in between:
            self._note(kind, begin + match.start(), begin + match.end(), change[1] + extra)

    # -- what is passed over, and where a place is -------------------------------------------------------------

    def visit(self, node: ast.AST) -> None:
        if isinstance(node, ast.stmt):
            before, self._statement = self._statement, node.lineno
            super().visit(node)
            self._statement = before
        else:
            super().visit(node)

    def _visit_function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        for default in (*node.args.defaults, *node.args.kw_defaults):
            if default is not None:
                self.visit(default)  # no annotation, no decorator
        self._depth += 1
        self._visit_body(node.body)
        self._depth -= 1

    visit_FunctionDef = visit_AsyncFunctionDef = _visit_function

    def visit_Lambda(self, node: ast.Lambda) -> None:
        self._depth += 1
        self.visit(node.body)
        self._depth -= 1

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self._visit_body(node.body)

    def _visit_body(self, body: Sequence[ast.stmt]) -> None:
        for statement in body:
            self.visit(statement)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Words for people; and their places are not known before Python 3.12."""

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    # -- kinds ---------------------------------------------------------------------------------------------------

    def visit_If(self, node: ast.If) -> None:
        if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return
        if not node.orelse:
            self._drop(node)
        self.generic_visit(node)

    def _drop(self, node: ast.stmt) -> None:
        self._note(DROPPED, self._begin(node), self._end(node), "pass")

    def visit_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Call):
            self._drop(node)
            self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> None:
        self._drop(node)  # its words are for people

    def visit_Assign(self, node: ast.Assign) -> None:
        names = [target for target in node.targets if isinstance(target, ast.Name)]
        if any(name.id == "__all__" for name in names):
            return
        if not names:
            self._drop(node)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._symbol(OPERATOR, node.target, node.value, _OPERATORS.get(type(node.op)), "=")
        self._drop(node)
        self.visit(node.value)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        self._symbol(OPERATOR, node.left, node.right, _OPERATORS.get(type(node.op)))
        sides = node.left, node.right
        words = any(
            isinstance(s, _TEXTS) or (isinstance(s, ast.Constant) and isinstance(s.value, str)) for s in sides
        )
        if isinstance(node.op, ast.Mult | ast.Div) and not words:
            begin, end = self._begin(node.left), self._end(node.left)
            self._note(SIGN, begin, end, f"(-({self._raw[begin:end].decode()}))")
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        for left, right in zip(node.values, node.values[1:], strict=False):
            self._symbol(OPERATOR, left, right, _OPERATORS[type(node.op)])
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        left = node.left
        for op, right in zip(node.ops, node.comparators, strict=True):
            self._symbol(COMPARISON, left, right, _COMPARISONS.get(type(op)))
            self._symbol(BOUNDARY, left, right, _BOUNDARIES.get(type(op)))
            left = right
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.USub):
            begin, operand = self._begin(node), self._begin(node.operand)
            text = self._raw[begin : self._end(node)].decode()
            self._note(SIGN, begin, self._end(node), text[1:] if operand > begin else text)
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        for text in _other(node.value):
            self._note(CONSTANT, self._begin(node), self._end(node), text)


def _other(value: object) -> Iterator[str]:
    if isinstance(value, bool):
        yield str(not value)
    elif isinstance(value, int):
        yield str(value + 1)
    elif isinstance(value, float):
        yield repr(2.0 * value if value else 1.0)
