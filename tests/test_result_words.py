"""Values in words, at the lengths and sizes where the words change."""

import numpy as np
import pytest

from phyfilter_ctl import results
from phyfilter_ctl.results import summary

TEXT, WIDTH, LISTED = results._TEXT, results._WIDTH, results._LISTED


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("x" * TEXT, repr("x" * TEXT)),
        ("x" * (TEXT + 1), repr("x" * (TEXT - 3) + "...")),
        (("x" * (TEXT - 5),), f"('{'x' * (TEXT - 5)}',)"),
        (("x" * (TEXT - 4),), f"('{'x' * (TEXT - 5)}..."),
        ((1,), "(1,)"),
        ((1, 2), "(1, 2)"),
        ([1], "[1]"),
        ([0] * LISTED, "[" + ", ".join(["0"] * LISTED) + "]"),
        ([0] * (LISTED + 1), f"{LISTED + 1} entries of type int"),
        (dict.fromkeys(range(LISTED + 1), 0.0), f"{LISTED + 1} entries of type float"),
        (["a" * WIDTH, 1, 2.0, None], "4 entries of type NoneType or float or int"),
        (np.array([1.0, np.nan, 3.0] * LISTED), f"array of shape ({3 * LISTED},), 1 to 3, not all finite"),
        (np.full(2 * LISTED, np.nan), f"array of shape ({2 * LISTED},), none finite"),
        (np.ones(2 * LISTED), f"array of shape ({2 * LISTED},), 1 to 1"),
    ],
    ids=str,
)
def test_values_are_short(value: object, words: str) -> None:
    assert summary(value) == words


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("x" * TEXT, "x" * TEXT),
        ("x" * (TEXT + 1), "x" * (TEXT - 3) + "..."),
        (("a", "b"), "a; b"),
        (None, ""),
        ([], ""),
        (np.zeros(0), ""),
        (np.array([1.0, 2.5]), "1, 2.5"),
        (np.zeros(LISTED), ", ".join(["0"] * LISTED)),
        (np.zeros((1, 2)), summary(np.zeros((1, 2)))),
        (1.25, "1.25"),
    ],
    ids=str,
)
def test_values_for_people(value: object, words: str) -> None:
    assert results._in_words(value) == words
