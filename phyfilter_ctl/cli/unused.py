"""Options that were given and that nothing asked for would use."""

from __future__ import annotations

import argparse
from collections.abc import Mapping

__all__ = ["refuse_units", "refuse_unused"]


def refuse_unused(options: argparse.Namespace, needs: Mapping[str, tuple[object, str]]) -> None:
    """Refuse what would be passed over without a word.

    Parameters
    ----------
    options : argparse.Namespace
        An option that was not given is None, False or an empty list.
    needs : mapping of str to (object, str)
        By the option's name: whether something uses it, and what would, in words.

    Raises
    ------
    ValueError
        If one was given for nothing.

    Examples
    --------
    >>> given = argparse.Namespace(max_channels=3)
    >>> refuse_unused(given, {"max_channels": ("filter.fmu", "--fmu")})
    >>> refuse_unused(given, {"max_channels": (None, "--fmu")})
    Traceback (most recent call last):
    ...
    ValueError: --max-channels: nothing here would use it: it needs --fmu
    """
    for name, (used, what) in needs.items():
        value = getattr(options, name)
        if value is not None and value is not False and value != [] and not used:
            raise ValueError(f"--{name.replace('_', '-')}: nothing here would use it: it needs {what}")


def refuse_units(options: argparse.Namespace) -> None:
    """Refuse the units of a picture where there is none.

    Parameters
    ----------
    options : argparse.Namespace
        Of a command with ``--picture``.

    Raises
    ------
    ValueError
        As for :func:`refuse_unused`.
    """
    drawn = options.picture not in (None, "none")
    refuse_unused(options, {name: (drawn, "--picture") for name in ("hz", "db") if hasattr(options, name)})
