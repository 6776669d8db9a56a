"""A node with its operands, as the rules of the operators see it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from ._tensors import Tensor
from .graph import OnnxNode, RefusedError


@dataclass(frozen=True, eq=False)
class Call:
    """A node with its operands.

    Attributes
    ----------
    node : OnnxNode
    operands : tuple of Tensor or None
        None where one is left out.
    opset : int
        Version of the operators.
    trained : dict of str to bool
        Constants that enter as weights, in the order of their first use, and whether a training may move them; the
        rules add theirs.
    """

    node: OnnxNode
    operands: tuple[Tensor | None, ...]
    opset: int
    trained: dict[str, bool] = field(default_factory=dict)

    def __getitem__(self, place: int) -> Tensor:
        tensor = self.get(place)
        if tensor is None:
            raise RefusedError("an operand is missing")
        return tensor

    def get(self, place: int) -> Tensor | None:
        """An operand that may be left out."""
        return self.operands[place] if place < len(self.operands) else None

    def weight(self, place: int) -> Tensor:
        """An operand that a training moves if it is a constant of more than a single number."""
        tensor = self[place]
        if tensor.source and tensor.shape and not tensor.whole:
            self.trained.setdefault(tensor.source, True)
        return tensor

    def statistic(self, place: int) -> Tensor:
        """An operand that no training moves, though exporters store it once with a weight of the same numbers."""
        tensor = self[place]
        self.trained[tensor.source] = False
        return tensor

    def integer(self, name: str, default: int) -> int:
        """An attribute."""
        value = self.node.attributes.get(name, default)
        if not isinstance(value, int):
            raise RefusedError(f"expected a whole number as {name}, got {value!r}")
        return value

    def real(self, name: str, default: float) -> float:
        """An attribute."""
        value = self.node.attributes.get(name, default)
        if not isinstance(value, int | float) or not math.isfinite(value):
            raise RefusedError(f"expected a finite {name}, got {value!r}")
        return float(value)

    def text(self, name: str, default: str) -> str:
        """An attribute."""
        return str(self.node.attributes.get(name, default))

    def listed(self, name: str, place: int | None = None) -> list[int] | None:
        """Whole numbers from an attribute, or in later versions from an operand; None if there are none."""
        value = self.node.attributes.get(name)
        if value is None:
            tensor = None if place is None else self.get(place)
            return None if tensor is None else tensor.whole_numbers(name)
        if not isinstance(value, tuple):
            raise RefusedError(f"expected a list of whole numbers as {name}, got {value!r}")
        return [int(n) for n in value]


Rule = Callable[[Call], Tensor | list[Tensor]]
