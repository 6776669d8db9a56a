"""Numbers in system structure packages: parameter sets, units, transformations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import lxml.etree as etree
from fmpy.ssp.ssd import validate_tree

from .inspect import Scalar
from .units import AS_IS, FmuUnit, Linear, conversion, understood_unit

__all__ = ["NAMESPACES", "SspValue", "parameter_values", "transformation", "unit_definitions", "validate"]

NAMESPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "ssm": "http://ssp-standard.org/SSP1/SystemStructureParameterMapping",
}
_EXPONENTS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class SspValue:
    """A value of a parameter set.

    Parameters
    ----------
    value : number or text
    unit : FmuUnit or None
        None: that of the parameter.
    then : Linear
        What a parameter mapping does to the value in the target's unit.
    """

    value: Scalar
    unit: FmuUnit | None = None
    then: Linear = AS_IS

    def of(self, target: FmuUnit | None, where: str) -> Scalar:
        """The value in the unit of what it is for.

        Parameters
        ----------
        target : FmuUnit or None
        where : str
            For messages.

        Raises
        ------
        ValueError
            If the units measure different things.
        """
        convert = conversion(self.unit, target)
        if convert is None:
            raise ValueError(
                f"{where}: the unit of the value and that of the parameter measure different things"
            )
        change = self.then.after(convert)
        return self.value if change == AS_IS or isinstance(self.value, str) else change(float(self.value))


def transformation(element: etree._Element, where: str) -> Linear:
    """The transformation of a connection or mapping entry, made in the target's unit.

    Parameters
    ----------
    element : lxml element
    where : str
        For messages.

    Raises
    ------
    ValueError
        If it is not linear.
    """
    for child in element:
        if not isinstance(child.tag, str):
            continue
        tag = etree.QName(child).localname
        if tag == "LinearTransformation":
            return Linear(float(child.get("factor", "1")), float(child.get("offset", "0")))
        if tag.endswith("Transformation"):
            raise ValueError(f"{where}: a {tag} is not supported; expected a LinearTransformation")
    return AS_IS


def unit_definitions(root: etree._Element) -> dict[str, FmuUnit]:
    """Units that a document defines, by name.

    Parameters
    ----------
    root : lxml element
    """
    found = {}
    for unit in root.iterfind("*/ssc:Unit", NAMESPACES):
        base = unit.find("ssc:BaseUnit", NAMESPACES)
        if base is not None:
            powers = {key: int(base.get(key, "0")) for key in _EXPONENTS}
            found[str(unit.get("name"))] = FmuUnit(
                {key: power for key, power in powers.items() if power},
                float(base.get("factor", "1")),
                float(base.get("offset", "0")),
            )
    return found


def parameter_values(root: etree._Element, units: Mapping[str, FmuUnit]) -> dict[str, SspValue]:
    """Values of a parameter set; arrays by element, ``a[0]``.

    Parameters
    ----------
    root : lxml element
        ``ssv:ParameterSet``.
    units : dict
        Definitions beside those of the set.

    Raises
    ------
    ValueError
        If a value is none, or there are not as many as the dimensions say.
    """
    known = {**units, **unit_definitions(root)}
    found: dict[str, SspValue] = {}
    for parameter in root.iterfind("ssv:Parameters/ssv:Parameter", NAMESPACES):
        label = str(parameter.get("name"))
        entry = next((child for child in parameter if isinstance(child.tag, str)), None)
        if entry is None:
            continue
        texts = [str(value.get("value")) for value in entry.iterfind("ssv:Value", NAMESPACES)]
        sizes = [int(size.get("size", "0")) for size in parameter.iterfind("ssc:Dimension", NAMESPACES)]
        labels = [label]
        if math.prod(sizes) != len(texts or labels):  # before so many names are made
            raise ValueError(f"parameter {label!r}: {len(texts)} values for dimensions {sizes}")
        if sizes:
            labels = [f"{label}[{','.join(map(str, at))}]" for at in product(*map(range, sizes))]
        name = entry.get("unit", "")
        unit = known.get(name) or understood_unit(name)
        for label, text in zip(labels, texts or [entry.get("value", "")], strict=True):
            found[label] = SspValue(_scalar(etree.QName(entry).localname, text), unit)
    return found


def _scalar(kind: str, text: str) -> Scalar:
    if kind == "Boolean":
        return text.strip() in ("true", "1")
    if kind in ("Real", "Float64", "Float32"):
        return float(text)
    return int(text) if "Int" in kind else text


def validate(path: Path, root: etree._Element) -> None:
    """By the standard's schema for 1.0; a document of 2.0 is checked as it is read, as FMPy has no schema for it.

    Parameters
    ----------
    path : Path
        Of the package, for messages.
    root : lxml element

    Raises
    ------
    ValueError
        If the document is not valid, or of another version.
    """
    version = root.get("version", "")
    if version.startswith("2."):
        return
    if not version.startswith("1."):
        raise ValueError(f"{path}: SystemStructure.ssd of version {version!r}; expected 1.0 or 2.0")
    try:
        validate_tree(root, "SystemStructureDescription.xsd")
    except Exception as error:  # fmpy raises a bare exception with the schema's messages
        raise ValueError(f"{path}: SystemStructure.ssd is not valid: {error}") from error
