"""The systems of the paper, one folder each, loaded by name.

The folders stand at the top of the checkout (``models/``) so that they read as examples; the wheel
carries them here. In a checkout this package therefore looks beside itself as well.
"""

from __future__ import annotations

import ast
import importlib
import pkgutil
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

if TYPE_CHECKING:
    import control as ct

__all__ = ["Model", "available", "load"]

_CHECKOUT = Path(__file__).resolve().parents[2]
if (_CHECKOUT / "pyproject.toml").is_file() and (_CHECKOUT / "models").is_dir():
    __path__.append(str(_CHECKOUT / "models"))


class Model(Protocol):
    """What every model folder offers."""

    def build(self) -> ct.InputOutputSystem:
        """Return the model as a python-control diagram."""
        ...

    def add_arguments(self, parser: ArgumentParser) -> None:
        """Add the options of ``phyfilter-ctl run NAME``."""
        ...

    def main(self, options: Namespace) -> int:
        """Run the model's job and return the exit status."""
        ...


def available() -> tuple[str, ...]:
    """Names of the models that :func:`load` accepts.

    Examples
    --------
    >>> "acceleration" in available()
    True
    """
    return tuple(sorted({module.name for module in pkgutil.iter_modules(__path__) if module.ispkg}))


def summary(name: str) -> str:
    """The first line of what a model folder says of itself; nothing is imported.

    Parameters
    ----------
    name : str
        One of :func:`available`.

    Raises
    ------
    ValueError
        If there is no such model.

    Examples
    --------
    >>> summary("drone")
    'The drone: a circle at 2 m/s with an unknown mass, in a wind that no model was trained on.'
    """
    folders = (Path(folder, _known(name)) for folder in __path__)
    source = next(file for folder in folders if (file := folder / "__init__.py").is_file())
    said = ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""
    return said.split("\n", 1)[0]


def _known(name: str) -> str:
    if name not in available():
        raise ValueError(f"no model named {name!r}; expected one of {', '.join(available())}")
    return name


def load(name: str) -> Model:
    """Import one model folder.

    Parameters
    ----------
    name : str
        One of :func:`available`.

    Raises
    ------
    ValueError
        If there is no such model.

    Examples
    --------
    >>> load("acceleration").build().name
    'acceleration'
    """
    return cast(Model, importlib.import_module(f"{__name__}.{_known(name)}"))
