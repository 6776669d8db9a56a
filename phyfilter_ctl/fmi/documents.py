"""Model descriptions as documents: their schemas, and FMPy's reading of them."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import fmpy
import lxml.etree as etree
from fmpy.model_description import ModelDescription, ValidationError, read_model_description

__all__ = ["complete_initial", "fmi_version", "read_description", "schema_problems", "validate_description"]

# Causalities that FMI gives a default of "initial" for.
_FREE = ("local", "input", "output")
_SET = ("parameter", "calculatedParameter", "structuralParameter", "local")
_WITH_DEFAULT = {
    "constant": ("output", "local"),
    "fixed": _SET,
    "tunable": _SET,
    "discrete": _FREE,
    "continuous": (*_FREE, "independent"),
}


@cache
def _schema(name: str) -> etree.XMLSchema:
    """FMI's schema, as fmpy ships it."""
    return etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "schema" / name[:4] / f"{name}.xsd"))


def schema_problems(root: etree._Element, name: str) -> list[str]:
    """What a schema of FMI does not allow in a document, line by line.

    Parameters
    ----------
    root : lxml element
    name : str
        As ``fmi3ModelDescription``.
    """
    schema = _schema(name)
    schema.validate(root)
    return [f"line {entry.line}: {entry.message}" for entry in schema.error_log]


def validate_description(path: Path, root: etree._Element) -> None:
    """Refuse a model description that its schema does not allow.

    Parameters
    ----------
    path : Path
        Of the FMU, for messages.
    root : lxml element

    Raises
    ------
    ValueError
        With the lines concerned; if it is none, or of another version than 2.0 or 3.0.
    """
    problems = schema_problems(root, f"fmi{fmi_version(path, root)[0]}ModelDescription")
    if problems:
        raise ValueError("\n  ".join([f"{path}: modelDescription.xml is not valid:", *problems]))


def complete_initial(root: etree._Element) -> bool:
    """Say "initial" of variables whose causality and variability FMI forbids together; whether there are any.

    FMPy knows no default for them and would not read the FMU; others run it, and `check` reports it.

    Parameters
    ----------
    root : lxml element
        Changed in place.
    """
    usual = "continuous" if root.get("fmiVersion") == "2.0" else None
    found = False
    for entry in root.iterfind("ModelVariables/*[@name]"):
        variability, causality = entry.get("variability", usual), entry.get("causality", "local")
        if variability and entry.get("initial") is None and causality not in _WITH_DEFAULT[variability]:
            entry.set("initial", "exact")
            found = True
    return found


def read_description(folder: Path, name: str) -> ModelDescription:
    """fmpy's description of an unpacked FMU; its errors as ValueError.

    Beyond the schema nothing is validated here: FMUs with undefined units or odd names are many, and run. `check`
    reports them.

    Parameters
    ----------
    folder : Path
    name : str
        For messages.

    Raises
    ------
    ValueError
        If it cannot be read.
    """
    try:
        return read_model_description(str(folder), validate=False)
    except ValidationError as error:
        raise ValueError(f"{name}: modelDescription.xml is not valid: {'; '.join(error.problems)}") from error
    except (
        Exception
    ) as error:  # fmpy raises what its parser stumbles over: KeyError, IndexError, bare Exception
        raise ValueError(f"{name}: modelDescription.xml cannot be read: {error!r}") from error


def fmi_version(path: Path, root: etree._Element) -> str:
    """FMI version of a model description, "2.0" or "3.0".

    Parameters
    ----------
    path : Path
        Of the FMU, for messages.
    root : lxml element

    Raises
    ------
    ValueError
        If it is of another version, or no model description.
    """
    if root.tag != "fmiModelDescription":
        raise ValueError(
            f"{path}: modelDescription.xml starts with <{root.tag}>, expected <fmiModelDescription>"
        )
    found = root.get("fmiVersion") or "none"
    # FMI 3.0 minor and beta versions read as 3.0; FMI 1.0 has another interface altogether.
    if found != "2.0" and not re.fullmatch(r"3\.0(\.\d+|-.*)?", found):
        raise ValueError(f"{path}: FMI version {found!r}; expected 2.0 or 3.0")
    return found[:3]
