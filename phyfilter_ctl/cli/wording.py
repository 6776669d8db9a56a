"""What the library says of its arguments, in the options of a command."""

from __future__ import annotations

import re
from collections.abc import Collection

__all__ = ["in_options"]

# Options that are called otherwise than the argument they give.
_OTHERWISE = {
    "actuator": "--lag",
    "delay": "--loop-delay",
    "deviation": "--noise",
    "kinds": "--kind",
    "modulus_margin": "--margin",
    "omega": "--at",
    "orders": "--order",
    "outputs": "--record",
    "platforms": "--platform",
    "ratios": "--inertia-ratio",
    "residual": "--slope",
}
# `name=` with the value that may follow; `name` in backquotes; the name that a message begins with.
_VALUE = r"\{[^}]*\}|\([^)]*\)|\[[^\]]*\]|'[^']*'|\"[^\"]*\"|\.\.\.|[\w.+-]*\w|"
_ARGUMENT = re.compile(rf"(?<![\w.'-])([a-z]\w*)=({_VALUE})(?!=)|`([a-z]\w*)`")
_FIRST = re.compile(r"([a-z]\w*)(?:\[\w+\])?(?=: | needs | belongs )")
# Times that count something else than seconds have a factor in Python, and a unit on the command line.
_TICKS = re.compile(r"a factor, scale=.*?the factor 1\.0")


def in_options(text: str, options: Collection[str]) -> str:
    """A message with options of a command in place of arguments of the library, where the command has them.

    Parameters
    ----------
    text : str
    options : collection of str
        Of the command, such as "--time-unit".

    Examples
    --------
    >>> in_options("inertia_error: give its bound too, rate=...", {"--inertia-error", "--rate"})
    '--inertia-error: give its bound too, --rate'
    >>> in_options("clocks=True needs a sampled block (of a filter: rate='fixed')", {"--clocks", "--rate"})
    '--clocks needs a sampled block (of a filter: --rate fixed)'
    >>> in_options("margin.csv: line 2 has k=3", {"--margin"})
    'margin.csv: line 2 has k=3'
    """

    def option(name: str) -> str:
        named = (f"--{name.replace('_', '-')}", _OTHERWISE.get(name, ""))
        return next((each for each in named if each in options), "")

    def replaced(found: re.Match[str]) -> str:
        name, value, quoted = found.groups()
        if not (word := option(name or quoted)):
            return found[0]
        return f"{word} {_in_words(value or '')}".rstrip()

    if "--time-unit" in options:
        text = _TICKS.sub("their unit, --time-unit ms, us, ns or s", text)
    text = _ARGUMENT.sub(replaced, text)
    first = _FIRST.match(text)
    return text if first is None else (option(first[1]) or first[0]) + text[first.end() :]


def _in_words(value: str) -> str:
    """A value as a command line takes it: a list in a row, a dictionary as pairs; none after what is a switch."""
    if value in ("True", "..."):
        return ""
    if value.startswith("{"):
        return " ".join(f"{k}={v}" for k, v in re.findall(r"'?(\w+)'?: ([^,}]+)", value))
    return " ".join(re.findall(r"[^\s,'\"()\[\]]+", value.replace("None", "none")))
