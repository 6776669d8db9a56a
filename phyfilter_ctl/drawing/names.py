"""Names and numbers as a control engineer writes them, and how wide they are."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

__all__ = ["LEAST", "Run", "caption", "cut", "number", "polynomial", "runs", "text_width", "unit_text"]

_GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "zeta": "ζ", "eta": "η", "theta": "θ",
    "iota": "ι", "kappa": "κ", "lambda": "λ", "mu": "μ", "nu": "ν", "xi": "ξ", "pi": "π", "rho": "ρ", "sigma": "σ",
    "tau": "τ", "upsilon": "υ", "phi": "φ", "chi": "χ", "psi": "ψ", "omega": "ω", "Gamma": "Γ", "Delta": "Δ",
    "Theta": "Θ", "Lambda": "Λ", "Xi": "Ξ", "Sigma": "Σ", "Phi": "Φ", "Psi": "Ψ", "Omega": "Ω",
}  # fmt: skip
_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_SMALL, _LOWERED = 0.78, 3.0  # an index: its size beside its letter's, and how many px it stands below
_HAT = "\u0302"
LEAST = 9.0  # px: of the smallest text
_LONGEST = 28  # characters of a name; beyond it is cut

# Advance widths in thousandths of the size, of DejaVu Sans: Helvetica and its twins are narrower throughout.
_WIDTHS = {
    letter: width
    for width, letters in {
        0: _HAT, 300: "'ijlIJι", 325: ",. \u00a0·", 350: "/:;\\|", 400: "-ft()[]", 425: "r!⁰¹²³⁴⁵⁶⁷⁸⁹", 500: '"*_`ˆ°',
        525: "sz∫∂", 550: "c?εζ⁻⁺", 575: "LΓνξ", 600: "kvxyFγκλςυχ", 625: "aeoPTYΥδθοπτ", 700: "ABCRVXZΑΒΔΖΛΧφψKΚα",
        750: "NUΝ", 775: "DGHΗΠΩ", 800: "OQ&ΘΟΦΨ", 850: "w#+<=>^~−∞×≤≥≈±ω", 875: "MΜ", 1000: "mW@%…",
    }.items()
    for letter in letters
}  # fmt: skip
_OTHER, _FOREIGN = 650, 1000  # digits and most small letters; letters of other scripts may be as wide as high


class Run(NamedTuple):
    """A piece of a name: its text, its size in px, and how many px it stands below the line."""

    text: str
    size: float
    lower: float = 0.0


def runs(name: str, size: float) -> tuple[Run, ...]:
    """A signal's name with hat, index and Greek letters.

    Parameters
    ----------
    name : str
    size : float
        Of the font in px.

    Returns
    -------
    tuple of Run

    Examples
    --------
    >>> [run.text for run in runs("omega_ref", 12.0)]
    ['ω', 'ref']
    >>> [run.text for run in runs("f_hat[2]", 12.0)]
    ['f̂', '[2]']
    """
    stem, bracket, index = cut(name).partition("[")
    head, *rest = stem.split("_") if stem.strip("_") and not stem.startswith("_") else [stem]
    head = _GREEK.get(head, head)
    if "hat" in rest and len(head) == 1:
        rest.remove("hat")
        head += _HAT
    low = ",".join(_GREEK.get(part, part) for part in rest if part)
    parts = [Run(head, size), Run(low, max(size * _SMALL, LEAST), _LOWERED), Run(bracket + index, size)]
    return tuple(run for run in parts if run.text)


def caption(name: str, size: float) -> tuple[Run, ...]:
    """A block's name: K_p has an index, force_filter is two words."""
    head = name.split("_")[0]
    if len(head) == 1 or head in _GREEK:
        return runs(name, size)
    return (Run(cut(name).replace("_", " "), size),)


def cut(name: str, longest: int = _LONGEST) -> str:
    """A name of at most so many characters, what a font cannot show left out."""
    shown = "".join(letter if letter.isprintable() else " " for letter in name)
    return shown if len(shown) <= longest else shown[: longest - 1] + "…"


def text_width(text: str | Sequence[Run], size: float = 0.0) -> float:
    """Width in px of a plain text of one size, or of runs side by side."""
    if not isinstance(text, str):
        return sum(text_width(run.text, run.size) for run in text)
    wide = sum(_WIDTHS.get(letter, _OTHER if ord(letter) < 0x400 else _FOREIGN) for letter in text)
    return wide * size / 1000.0


def number(value: float, digits: int = 3) -> str:
    """A number in few digits, as it stands in a formula.

    Examples
    --------
    >>> number(-0.142857), number(2.5e-7), number(31400.0)
    ('−0.143', '2.5·10⁻⁷', '31400')
    """
    text = f"{value:.0f}" if 1000 <= abs(value) < 1e5 and value == round(value) else f"{value:.{digits}g}"
    if "e" in text and 1000 <= abs(value) < 1e5:
        text = f"{value:.0f}"
    mantissa, e, power = text.partition("e")
    mantissa = mantissa.replace("-", "−").replace("inf", "∞")
    return f"{mantissa}·10{str(int(power)).translate(_RAISED)}" if e else mantissa


def unit_text(unit: str) -> str:
    """A unit as it stands on a wire; "" of none.

    Examples
    --------
    >>> unit_text("kg m/s^2"), unit_text("s^-1")
    ('[kg·m/s²]', '[s⁻¹]')
    """
    raised = re.sub(r"\^(-?[0-9]+)", lambda found: found[1].translate(_RAISED), unit)
    return f"[{cut(raised.replace(' ', '·'))}]" if unit else ""


def polynomial(coefficients: Sequence[float], variable: str) -> str:
    """A polynomial by its descending coefficients.

    Examples
    --------
    >>> polynomial([1.0, -0.2, 40.0], "s")
    's² − 0.2s + 40'
    """
    text = ""
    for power, value in zip(range(len(coefficients) - 1, -1, -1), coefficients, strict=True):
        if value == 0.0:
            continue
        unknown = "" if power == 0 else variable if power == 1 else variable + str(power).translate(_RAISED)
        size = number(abs(value))
        term = unknown if size == "1" and power else size + unknown
        sign = (" − " if value < 0 else " + ") if text else "−" if value < 0 else ""
        text += sign + term
    return text or "0"


def base_and_index(label: str) -> tuple[str, str | None]:
    """``thrust[2]`` as thrust and 2; a label without an index as itself and None."""
    match = re.fullmatch(r"(.*?)\[([^\[\]]*)\]", label, flags=re.DOTALL)
    return (match[1], match[2]) if match else (label, None)


def vector_starts(labels: Sequence[str]) -> set[int]:
    """Where the vectors begin among labels in a row.

    Examples
    --------
    >>> sorted(vector_starts(["u[0]", "u[1]", "r", "v[0]"]))
    [0, 2, 3]
    """
    pairs = [base_and_index(label) for label in labels]
    inside = {
        k + 1
        for k, (a, b) in enumerate(pairwise(pairs))
        if a[1] is not None and b[1] is not None and a[0] == b[0]
    }
    return set(range(len(labels))) - inside
