"""Names of variables in FMI's structured convention."""

from __future__ import annotations

import re
from dataclasses import replace

from ..blocks.functions import Variable
from ..codegen.identifiers import identifier
from ..codegen.model import CModel

__all__ = ["LEGAL", "is_structured", "legal_name", "with_legal_names"]

# FMI 2.0.5 and 3.0.2, "structured": identifiers, quoted or plain, with indices, joined by dots.
_QUOTED = r"'(?:[A-Za-z0-9_!#$%&()*+,\-./:;<>=?@\[\]^{}|~ ]|\\['\"?\\abfnrtv])+'"
_PART = rf"(?:[A-Za-z_][A-Za-z0-9_]*|{_QUOTED})(?:\[[0-9]+(?:,[0-9]+)*\])?"
LEGAL = re.compile(rf"{_PART}(?:\.{_PART})*")
_DERIVATIVE = re.compile(rf"der\({LEGAL.pattern}(?:,[0-9]+)?\)")


def is_structured(name: str) -> bool:
    """Whether the structured convention allows a name.

    Parameters
    ----------
    name : str

    Examples
    --------
    >>> is_structured("der(arm.'joint 1'[2],2)"), is_structured("der(der(x))")
    (True, False)
    """
    return bool(LEGAL.fullmatch(name) or _DERIVATIVE.fullmatch(name))


def with_legal_names(model: CModel) -> CModel:
    """The model with names of variables as FMI allows them, different ones still different.

    A part of a name that the structured convention does not allow stands in single quotes, ``'v 1'``; letters beyond
    ASCII are spelt out. A variable of another name than the model's has the model's in its description.

    Parameters
    ----------
    model : CModel
    """
    vectors = {
        kind: getattr(model, kind) for kind in ("inputs", "outputs", "parameters", "states", "sampled_states")
    }
    names = dict.fromkeys(variable.name for vector in vectors.values() for variable in vector)
    kept = {name for name in names if LEGAL.fullmatch(name)}
    legal: dict[str, str] = {}
    for name in names:
        plain = name if name in kept else legal_name(name)
        number = 1
        while name not in kept and plain in kept:
            number += 1
            plain = legal_name(f"{name}_{number}")
        kept.add(plain)
        legal[name] = plain
    if all(name == plain for name, plain in legal.items()):
        return model
    return replace(
        model, **{kind: tuple(_renamed(v, legal[v.name]) for v in vector) for kind, vector in vectors.items()}
    )


def _renamed(variable: Variable, name: str) -> Variable:
    if name == variable.name:
        return variable
    return replace(variable, name=name, description=f"{variable.name}: {variable.description}".rstrip(": "))


def legal_name(name: str) -> str:
    """Each part of a name that needs it in quotes; letters beyond ASCII spelt out.

    Parameters
    ----------
    name : str
    """
    return ".".join(_legal_part(part) for part in name.split("."))


def _legal_part(part: str) -> str:
    if re.fullmatch(_PART, part) or not part:
        return part
    spelt = "".join(character if character.isascii() else identifier(character) for character in part)
    index = re.search(r"\[\d+(?:,\d+)*\]$", spelt)
    bare, index = (spelt[: index.start()], index[0]) if index else (spelt, "")
    if re.fullmatch(_PART, bare + index):
        return bare + index
    escaped = re.sub(r"(['\"?\\])", r"\\\1", bare)
    return f"'{escaped}'{index}"
