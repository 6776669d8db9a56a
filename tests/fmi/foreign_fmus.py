"""FMUs written by hand in C, built for the tests: peers that share no code with the library."""

import shutil
import subprocess
import zipfile
from pathlib import Path

import fmpy
import pytest

HERE = Path(__file__).parent / "foreign"
HEADERS = Path(fmpy.__file__).parent / "c-code"
FOLDERS = {"2.0": fmpy.platform, "3.0": fmpy.platform_tuple}
FLAGS: tuple[str, ...] = ()  # of the compiler, for all of them
UNITS = """
  <UnitDefinitions>
    <Unit name="m"><BaseUnit m="1"/><DisplayUnit name="mm" factor="1000"/></Unit>
    <Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit>
    <Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit>
    <Unit name="N/m"><BaseUnit kg="1" s="-2"/></Unit>
    <Unit name="kg"><BaseUnit kg="1"/></Unit>
    <Unit name="thou"><BaseUnit m="1" factor="2.54e-5" offset="-0.5"/></Unit>
  </UnitDefinitions>"""

# Inputs of other types than floating point, FMI 3.0.
TYPES = """
  <TypeDefinitions><EnumerationType name="Mode"><Item name="low" value="-1"/><Item name="high" value="2"/>
  </EnumerationType></TypeDefinitions>"""
NUMBERS = """
    <Int8 name="tiny" valueReference="13" causality="input" start="0"/>
    <UInt8 name="positive" valueReference="14" causality="input" start="0"/>
    <Boolean name="flag" valueReference="16" causality="input" start="false"/>
    <Int32 name="started" valueReference="12" causality="parameter" variability="fixed" start="0"/>"""
MODES = """
    <Enumeration name="mode" valueReference="15" causality="input" declaredType="Mode" start="-1"/>"""

FMI2 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Oscillator" guid="{guid}" generationTool="by hand"
    description="Mass between two springs" numberOfEventIndicators="{indicators}">
  {kinds}{units}
  <DefaultExperiment startTime="0.0" stopTime="2.0" tolerance="1e-6" stepSize="0.01"/>
  <ModelVariables>
    <ScalarVariable name="time" valueReference="0" causality="independent" variability="continuous">
      <Real/></ScalarVariable>
    <ScalarVariable name="place" valueReference="1" causality="input" variability="continuous"
      description="Where the coupling spring ends"><Real start="0.0" unit="{unit}"/></ScalarVariable>
    <ScalarVariable name="x" valueReference="2" causality="output" variability="continuous" initial="exact">
      <Real start="1.0" unit="m"/></ScalarVariable>
    <ScalarVariable name="v" valueReference="3" causality="output" variability="continuous" initial="exact">
      <Real start="0.0" unit="m/s"/></ScalarVariable>
    <ScalarVariable name="der(x)" valueReference="4" causality="local" variability="continuous">
      <Real derivative="3"/></ScalarVariable>
    <ScalarVariable name="der(v)" valueReference="5" causality="local" variability="continuous">
      <Real derivative="4"/></ScalarVariable>
    <ScalarVariable name="force" valueReference="6" causality="output" variability="continuous">
      <Real unit="N"/></ScalarVariable>
    <ScalarVariable name="m" valueReference="7" causality="parameter" variability="fixed">
      <Real start="2.0" unit="kg"/></ScalarVariable>
    <ScalarVariable name="k" valueReference="8" causality="parameter" variability="tunable">
      <Real start="8.0" unit="N/m"/></ScalarVariable>
    <ScalarVariable name="d" valueReference="9" causality="parameter" variability="tunable">
      <Real start="0.4"/></ScalarVariable>
    <ScalarVariable name="c" valueReference="10" causality="parameter" variability="tunable">
      <Real start="3.0" unit="N/m"/></ScalarVariable>
    <ScalarVariable name="steps" valueReference="12" causality="local" variability="discrete">
      <Integer/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="3" dependencies=""/><Unknown index="4" dependencies=""/>{force}</Outputs>
    <Derivatives><Unknown index="5"/><Unknown index="6"/></Derivatives>
    <InitialUnknowns><Unknown index="5"/><Unknown index="6"/><Unknown index="7"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""

FMI3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Oscillators" instantiationToken="{guid}" generationTool="by hand">
  {kinds}{units}
  <DefaultExperiment startTime="0.0" stopTime="2.0" stepSize="0.01"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="place" valueReference="1" causality="input" start="0.0" unit="m"><Dimension start="2"/></Float64>
    <Float64 name="x" valueReference="2" causality="output" initial="exact" start="1.0 2.0" unit="m">
      <Dimension start="2"/></Float64>
    <Float64 name="v" valueReference="3" causality="output" initial="exact" start="0.0 0.0" unit="m/s">
      <Dimension start="2"/></Float64>
    <Float64 name="der(x)" valueReference="4" causality="local" derivative="2"><Dimension start="2"/></Float64>
    <Float64 name="der(v)" valueReference="5" causality="local" derivative="3"><Dimension start="2"/></Float64>
    <Float64 name="force" valueReference="6" causality="output" unit="N"><Dimension start="2"/></Float64>
    <Float64 name="m" valueReference="7" causality="parameter" variability="fixed" start="2.0" unit="kg"/>
    <Float64 name="k" valueReference="8" causality="parameter" variability="tunable" start="8.0"/>
    <Float64 name="d" valueReference="9" causality="parameter" variability="tunable" start="0.4"/>
    <Float64 name="c" valueReference="10" causality="parameter" variability="tunable" start="3.0"/>
    <Int32 name="steps" valueReference="12" causality="local" variability="discrete"/>{numbers}
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="2" dependencies=""/>
    <Output valueReference="3" dependencies=""/>
    <Output valueReference="6" dependencies="1 2"/>
    <ContinuousStateDerivative valueReference="4" dependencies="3" dependenciesKind="constant"/>
    <ContinuousStateDerivative valueReference="5" dependencies="1 2 3"/>
    <InitialUnknown valueReference="4"/>
    <InitialUnknown valueReference="5"/>
    <InitialUnknown valueReference="6"/>
  </ModelStructure>
</fmiModelDescription>
"""


def description(
    fmi="2.0",
    *,
    state=True,
    variable_step=True,
    kinds="me cs",
    indicators=0,
    guid="oscillator",
    unit="m",
    declared=True,
    numbers=False,
    modes=False,
    derivatives=False,
    adjoint=False,
    interpolates=False,
):
    """modelDescription.xml of the oscillator; `declared` None says nothing of what force depends on, False a lie."""
    name, keep = ("oscillator2", "FMUstate") if fmi == "2.0" else ("oscillator3", "FMUState")
    yes = {True: "true", False: "false"}
    tags = {
        "me": f'<ModelExchange modelIdentifier="{name}" canGetAndSet{keep}="{yes[state]}"/>',
        "cs": f'<CoSimulation modelIdentifier="{name}" canGetAndSet{keep}="{yes[state]}" '
        f'canHandleVariableCommunicationStepSize="{yes[variable_step]}" '
        + 'canInterpolateInputs="true" ' * interpolates
        + f'providesDirectionalDerivative{"" if fmi == "2.0" else "s"}="{yes[derivatives]}"'
        + ' providesAdjointDerivatives="true"' * adjoint
        + "/>",
    }
    said = {True: ' dependencies="2 3"', False: ' dependencies="3"', None: ""}
    force = f'<Unknown index="7"{said[declared]}/>'
    return (FMI2 if fmi == "2.0" else FMI3).format(
        kinds="".join(tags[kind] for kind in kinds.split()),
        units=UNITS + TYPES * modes,
        numbers=NUMBERS * numbers + MODES * modes,
        indicators=indicators,
        guid=guid,
        unit=unit,
        force=force,
    )


def compiled(source, target, *flags):
    """Shared library of a C file of this folder."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed: foreign FMUs cannot be built")
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC", f"-I{HEADERS}"]
    subprocess.run(["gcc", *strict, *FLAGS, *flags, str(HERE / source), "-o", str(target)], check=True)
    return target


def binary(folder, fmi="2.0", defines=()):
    """Shared library of the oscillator."""
    target = folder / f"oscillator{fmi[0]}-{'-'.join(defines)}{fmpy.sharedLibraryExtension}"
    size = ["-DN=2"] if fmi == "3.0" else []
    flags = [*size, *(f"-D{define}" for define in defines)]
    return target if target.exists() else compiled(f"oscillator{fmi[0]}.c", target, *flags)


def oscillator(folder, fmi="2.0", *, defines=(), name="oscillator", platform=None, **options):
    """An FMU file; `defines` are the peculiarities in oscillator.h, `options` those of its description."""
    path = folder / f"{name}.fmu"
    inside = f"binaries/{platform or FOLDERS[fmi]}/oscillator{fmi[0]}{fmpy.sharedLibraryExtension}"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description(fmi, **options))
        archive.write(binary(folder, fmi, defines), inside)
    return path
