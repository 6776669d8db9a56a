"""The FMU of foreign/typed.c: a variable of every type of FMI 3.0, and arrays by a structural parameter."""

import zipfile

import fmpy
from foreign_fmus import FOLDERS, compiled

# Type and value reference / 10; the smallest and largest value.
NUMBERS = {
    "Float32": (1, -3.4e38, 3.4e38),
    "Int8": (2, -(2**7), 2**7 - 1),
    "UInt8": (3, 0, 2**8 - 1),
    "Int16": (4, -(2**15), 2**15 - 1),
    "UInt16": (5, 0, 2**16 - 1),
    "Int32": (6, -(2**31), 2**31 - 1),
    "UInt32": (7, 0, 2**32 - 1),
    "Int64": (8, -(2**63), 2**63 - 1),
    "UInt64": (9, 0, 2**64 - 1),
    "Boolean": (10, 0, 1),
    "Enumeration": (13, -1, 2),
}


def description():
    """modelDescription.xml: of each type a parameter, an input and an output."""
    rows = []
    for kind, (place, _, _) in NUMBERS.items():
        start = {"Boolean": "false", "Enumeration": "-1"}.get(kind, "0")
        more = ' declaredType="Mode"' if kind == "Enumeration" else ""
        for i, causality in enumerate(("parameter", "input", "output")):
            first = f' start="{start}"' if i < 2 else ""
            when = ' variability="tunable"' if i == 0 else ' variability="discrete"'
            name = f"{'puy'[i]}_{kind}"
            rows.append(
                f'<{kind} name="{name}" valueReference="{10 * place + i}" causality="{causality}"{when}{first}{more}/>'
            )
    for kind, place, start in (("String", 11, "as delivered"), ("Binary", 12, "00ff")):
        for i, causality in enumerate(("parameter", "input", "output")):
            when = ' variability="tunable"' if i == 0 else ' variability="discrete"'
            first = f'<Start value="{start if i == 0 and kind == "String" else ""}"/>' if i < 2 else ""
            head = (
                f'{kind} name="{"puy"[i]}_{kind}" valueReference="{10 * place + i}" causality="{causality}"'
            )
            rows.append(f"<{head}{when}>{first}</{kind}>")
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Typed" instantiationToken="typed">
  <ModelExchange modelIdentifier="typed" canGetAndSetFMUState="true"/>
  <CoSimulation modelIdentifier="typed" canGetAndSetFMUState="true" canHandleVariableCommunicationStepSize="true"/>
  <TypeDefinitions><EnumerationType name="Mode"><Item name="low" value="-1"/><Item name="high" value="2"/>
  </EnumerationType></TypeDefinitions>
  <DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <UInt64 name="channels" valueReference="1" causality="structuralParameter" variability="fixed" start="2" min="1"
      max="5"/>
    <Float64 name="a" valueReference="2" causality="input" start="0.5 1.0"><Dimension valueReference="1"/></Float64>
    <Float64 name="x" valueReference="3" causality="output" initial="exact" start="0"><Dimension valueReference="1"/>
    </Float64>
    <Float64 name="der(x)" valueReference="4" derivative="3"><Dimension valueReference="1"/></Float64>
    <Float64 name="sum" valueReference="5" causality="output"/>
    <Float64 name="gain" valueReference="6" causality="parameter" variability="tunable" start="1 2">
      <Dimension valueReference="1"/></Float64>
    {"".join(rows)}
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="3" dependencies=""/><Output valueReference="5" dependencies="3"/>
    {
        "".join(
            f'<Output valueReference="{10 * place + 2}" dependencies="{10 * place + 1}"/>'
            for place, _, _ in NUMBERS.values()
        )
    }
    <Output valueReference="112" dependencies=""/><Output valueReference="122" dependencies=""/>
    <ContinuousStateDerivative valueReference="4" dependencies="2"/>
    <InitialUnknown valueReference="4"/><InitialUnknown valueReference="5"/>
  </ModelStructure>
</fmiModelDescription>
"""


def typed(folder):
    """The FMU file."""
    library = compiled("typed.c", folder / f"typed{fmpy.sharedLibraryExtension}")
    path = folder / "typed.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description())
        archive.write(library, f"binaries/{FOLDERS['3.0']}/typed{fmpy.sharedLibraryExtension}")
    return path
