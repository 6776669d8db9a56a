"""Parameters and signals of an FMU for calibration tools: a page at fixed addresses, its A2L and the manifest.

The layered standard FMI-LS-XCP 1.0.0 lets an FMU offer its memory to an XCP service of the importer
(``supportsDirectMemoryAccess``), described in the format of ASAM MCD-2 MC. Addresses count from where the binary is
loaded; for sources they are symbols of the linker.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from math import isfinite
from pathlib import PurePosixPath
from xml.sax.saxutils import quoteattr

import numpy as np

from .description import FmuInterface, InterfaceVariable

__all__ = ["MANIFEST", "calibration_entries", "load_address", "page_glue", "page_source"]

_ROOM = "extra/org.fmi-standard.fmi-ls-xcp"
MANIFEST = f"{_ROOM}/fmi-ls-manifest.xml"
_ABOUT = (
    "Layered standard based on FMI 2.0 and FMI 3.0 for describing and implementing XCP support for FMUs, which can "
    "either provide an XCP service or allow direct memory access via A2L files."
)
_CALIBRATED = ("parameter", "fixed")
_SHOWN = ("time", "input", "output", "local", *_CALIBRATED, "state", "sampled")  # as pf_fmi_xcp.c
_INDEXED = re.compile(r"(.*[^\[\]])\[(\d+(?:,\d+)*)\]")
_MARK = 16  # bytes before the numbers, by which they are found in a binary
_LARGEST = 1.7976931348623157e308


def _shown(interface: FmuInterface) -> tuple[InterfaceVariable, ...]:
    return tuple(variable for variable in interface.variables if variable.kind in _SHOWN)


def _mark(token: str) -> bytes:
    """Of the token, as no text has it; none before there is a token."""
    return bytes.fromhex(token.replace("-", "")) if token else bytes(_MARK)


def page_source(interface: FmuInterface, token: str) -> str:
    """``<name>_xcp.c``: the page of numbers at a fixed address.

    Parameters
    ----------
    interface : FmuInterface
    token : str
    """
    name = interface.model.name
    count = sum(variable.count for variable in _shown(interface))
    starts = ", ".join(
        repr(float(value))
        for variable in _shown(interface)
        for value in variable.start or (0.0,) * variable.count
    )
    return f"""\
/* What calibration tools see of {name}, as its A2L file says. Generated. */
#include "pf_fmi.h"

typedef struct {{
  unsigned char mark[{_MARK}];
  double values[{count}];
}} page_here;

extern page_here {name}_xcp;
extern pf_fmi_page {name}_page;

page_here {name}_xcp = {{
    {{{", ".join(map(str, _mark(token)))}}},
    {{{starts}}}}};

static double seen[{count}], in_force[{count}];

pf_fmi_page {name}_page = {{{name}_xcp.values, seen, in_force, NULL, pf_fmi_page_claim, pf_fmi_page_take,
                            pf_fmi_page_show, pf_fmi_page_leave}};
"""


def page_glue(glue: str, name: str) -> str:
    """The table pf_fmu_here with the page in it.

    Parameters
    ----------
    glue : str
        As of :func:`phyfilter_ctl.fmi.glue.glue_source`.
    name : str
        Of the model.
    """
    table = "const pf_fmu pf_fmu_here = {\n"
    return glue.replace(table, f"extern pf_fmi_page {name}_page;\n\n{table}    .page = &{name}_page,\n")


def calibration_entries(
    interface: FmuInterface, token: str, binaries: Mapping[str, bytes]
) -> dict[str, bytes | str]:
    """What FMI-LS-XCP asks of an archive: the manifest, an A2L file for the sources and for each binary, a word on use.

    Parameters
    ----------
    interface : FmuInterface
    token : str
        That of the sources the binaries were built of.
    binaries : mapping of str to bytes
        ``binaries/<platform>/<file>`` to content.

    Returns
    -------
    dict of str to str
    """
    name = interface.model.name
    entries: dict[str, bytes | str] = {
        MANIFEST: _manifest(name),
        f"{_ROOM}/{name}.a2l": a2l(interface, token, None),
        "documentation/fmi-ls-xcp.txt": _usage(name),
    }
    for path, binary in binaries.items():
        address = load_address(binary, _mark(token))
        entries[f"{_ROOM}/{PurePosixPath(path).parent.name}/{name}.a2l"] = a2l(interface, token, address)
    return entries


def load_address(binary: bytes, mark: bytes) -> int:
    """Where bytes of a shared library lie, counted from where it is loaded.

    Parameters
    ----------
    binary : bytes
        ELF, PE or Mach-O of 64 bits, low byte first.
    mark : bytes
        Which are there once.

    Raises
    ------
    ValueError
        If they are not there, or not once, or the format is another.
    """
    if binary.count(mark) != 1:
        raise ValueError(
            f"mark of the calibration page: expected once in the binary, got {binary.count(mark)}"
        )
    place = binary.index(mark)
    for offset, size, address in _segments(binary):
        if offset <= place and place + len(mark) <= offset + size:
            return address + place - offset
    raise ValueError("mark of the calibration page: in no part of the binary that is loaded")


def _segments(binary: bytes) -> list[tuple[int, int, int]]:
    """What is loaded: offset and size in the file, address from the base."""
    if binary[:6] == b"\x7fELF\x02\x01":
        table, entry, count = (*struct.unpack_from("<Q", binary, 32), *struct.unpack_from("<HH", binary, 54))
        found = [struct.unpack_from("<IIQQQQ", binary, table + i * entry) for i in range(count)]
        return [(offset, size, address) for kind, _, offset, address, _, size in found if kind == 1]
    if binary[:2] == b"MZ":
        (header,) = struct.unpack_from("<I", binary, 60)
        (count,) = struct.unpack_from("<H", binary, header + 6)
        (optional,) = struct.unpack_from("<H", binary, header + 20)
        sections = [
            struct.unpack_from("<IIII", binary, header + 24 + optional + 40 * i + 8) for i in range(count)
        ]
        return [(offset, size, address) for _, address, size, offset in sections]
    if binary[:4] == b"\xcf\xfa\xed\xfe":
        found, at = [], 32
        for _ in range(struct.unpack_from("<I", binary, 16)[0]):
            kind, length = struct.unpack_from("<II", binary, at)
            if kind == 0x19:  # LC_SEGMENT_64
                address, _, offset, size = struct.unpack_from("<QQQQ", binary, at + 24)
                found.append((offset, size, address))
            at += length
        return found
    raise ValueError(f"binary: expected ELF, PE or Mach-O of 64 bits, got {binary[:4]!r}")


def a2l(interface: FmuInterface, token: str, address: int | None) -> str:
    """The page as ASAM MCD-2 MC (ASAP2) 1.7.1 describes it.

    Parameters
    ----------
    interface : FmuInterface
    token : str
    address : int or None
        Of the page in a binary; None: by the symbol of the linker.
    """
    name = interface.model.name
    shown = _shown(interface)
    units = dict.fromkeys(variable.unit for variable in shown)
    conversions = {unit: f"unit_{i}" for i, unit in enumerate(units)}
    blocks, offset, names = [], _MARK, set[str]()
    for variable in shown:
        for k in range(variable.count):
            label = _identifier(variable, k, names)
            blocks.append(_block(variable, label, conversions[variable.unit], address, offset, f"{name}_xcp"))
            offset += 8
    methods = [
        f'/begin COMPU_METHOD {conversion} "" IDENTICAL "%.9g" {_text(unit)}\n/end COMPU_METHOD'
        for unit, conversion in conversions.items()
    ]
    inside = "\n".join([_LAYOUT, *methods, *blocks])
    return f"""\
ASAP2_VERSION 1 71
/begin PROJECT {name} {_text(interface.description)}
/begin HEADER ""
VERSION {_text(token)}
/end HEADER
/begin MODULE {name} {_text(interface.description)}
{inside}
/end MODULE
/end PROJECT
"""


_LAYOUT = """\
/begin MOD_COMMON ""
BYTE_ORDER MSB_LAST
ALIGNMENT_FLOAT64_IEEE 8
/end MOD_COMMON
/begin RECORD_LAYOUT number
FNC_VALUES 1 FLOAT64_IEEE ROW_DIR DIRECT
/end RECORD_LAYOUT"""


def _block(
    variable: InterfaceVariable, label: str, conversion: str, address: int | None, offset: int, symbol: str
) -> str:
    low = variable.minimum if isfinite(variable.minimum) else -_LARGEST
    high = variable.maximum if isfinite(variable.maximum) else _LARGEST
    at = 0 if address is None else address + offset
    link = f'\nSYMBOL_LINK "{symbol}" {offset}' if address is None else ""
    about = _text(f"{variable.name}: {variable.description}" if variable.description else variable.name)
    if variable.kind in _CALIBRATED:
        return f"""\
/begin CHARACTERISTIC {label} {about}
VALUE 0x{at:X} number 0 {conversion} {low!r} {high!r}{link}
/end CHARACTERISTIC"""
    return f"""\
/begin MEASUREMENT {label} {about}
FLOAT64_IEEE {conversion} 0 0 {low!r} {high!r}
ECU_ADDRESS 0x{at:X}{link}
/end MEASUREMENT"""


def _identifier(variable: InterfaceVariable, k: int, taken: set[str]) -> str:
    """Names of A2L: letters, digits and _ of C, parts between dots, whole numbers in brackets."""
    name, of_name = variable.name, []
    if found := _INDEXED.fullmatch(name):
        name, of_name = found[1], found[2].split(",")
    indices = [*of_name, *np.unravel_index(k, variable.shape)]
    parts = [re.sub(r"\W", "_", part, flags=re.ASCII) for part in name.split(".")]
    label = ".".join(part if re.match("[A-Za-z_]", part) else f"_{part}" for part in parts)
    label += "".join(f"[{i}]" for i in indices)
    while label in taken:
        label = f"_{label}"
    taken.add(label)
    return label


def _text(text: str) -> str:
    plain = " ".join(text.encode("ascii", "replace").decode("ascii").split())
    escaped = plain.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _manifest(name: str) -> str:
    return f"""\
<?xml version="1.0" encoding="UTF-8"?>
<fmiLayeredStandardManifest xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
    fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-xcp" fmi-ls:fmi-ls-version="1.0.0"
    fmi-ls:fmi-ls-description={quoteattr(_ABOUT)}>
  <Interface definition="{name}.a2l" description="Parameters and signals of {name}" supportsDirectMemoryAccess="true"/>
</fmiLayeredStandardManifest>
"""


def _usage(name: str) -> str:
    return f"""\
{name} offers its parameters and signals to calibration tools by direct memory access (FMI-LS-XCP 1.0.0). It brings no
XCP service: the importer's reads and writes the memory, and puts its own IF_DATA XCP into the A2L file.

Addresses in extra/org.fmi-standard.fmi-ls-xcp/<platform>/{name}.a2l count from where the binary is loaded; {name}.a2l
above them, for a build of the sources, names the symbol {name}_xcp and offsets.

The page is that of the first instance, until it is freed. Measurements are those of the last communication step or
event. Characteristics come into force at the next communication step or at the end of Event Mode, all that were
written together; where they are refused (a denominator that is not stable, say) those in force stay, the log says so,
and what was written waits for the rest. Those that are fixed in
modelDescription.xml count until Initialization Mode ends.
"""
