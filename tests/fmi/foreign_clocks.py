"""The FMU of foreign/clocks.c: clocks of every kind, in model exchange, co-simulation and scheduled execution."""

import zipfile

import fmpy
from foreign_fmus import FOLDERS, compiled

KINDS = {
    "me": '<ModelExchange modelIdentifier="clocks" canGetAndSetFMUState="true" needsCompletedIntegratorStep="false"/>',
    "cs": '<CoSimulation modelIdentifier="clocks" canGetAndSetFMUState="true" hasEventMode="true" '
    'canHandleVariableCommunicationStepSize="{variable_step}" providesIntermediateUpdate="true" '
    'canReturnEarlyAfterIntermediateUpdate="true"/>',
    "se": '<ScheduledExecution modelIdentifier="clocks" canGetAndSetFMUState="true"/>',
}
DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Clocks" instantiationToken="clocks">
  {kinds}
  <DefaultExperiment startTime="0.0" stopTime="1.0"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="x" valueReference="1" causality="output" variability="continuous" initial="exact" start="0"/>
    <Float64 name="der(x)" valueReference="2" causality="local" variability="continuous" derivative="1"/>
    <Float64 name="u" valueReference="3" causality="input" variability="continuous" start="0"/>
    <Float64 name="sample" valueReference="4" causality="input" variability="discrete" clocks="20" start="0"/>
    <Int32 name="level" valueReference="5" causality="input" variability="discrete" start="0"/>
    <Float64 name="held" valueReference="6" causality="output" variability="discrete"/>
    <Int32 name="seen" valueReference="7" causality="output" variability="discrete"/>
    <Float64 name="jump_at" valueReference="8" causality="parameter" variability="fixed" start="1e300"/>
    <Int32 name="ticks" valueReference="9" causality="output" variability="discrete"><Dimension start="6"/></Int32>
    <Clock name="fast" valueReference="20" causality="input" intervalVariability="constant" intervalDecimal="0.1"
      priority="1"/>
    <Clock name="slow" valueReference="21" causality="input" intervalVariability="changing" shiftDecimal="0.2"
      priority="2"/>
    <Clock name="soon" valueReference="22" causality="input" intervalVariability="countdown" priority="3"/>
    <Clock name="hand" valueReference="23" causality="input" intervalVariability="triggered" priority="4"/>
    {own}<Clock name="rings" valueReference="25" causality="output" intervalVariability="triggered"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="1" dependencies=""/><Output valueReference="6" dependencies=""/>
    <Output valueReference="7" dependencies=""/><Output valueReference="9" dependencies=""/>
    <ContinuousStateDerivative valueReference="2" dependencies="3"/>
    <InitialUnknown valueReference="6"/><InitialUnknown valueReference="7"/><InitialUnknown valueReference="9"/>
  </ModelStructure>
</fmiModelDescription>
"""
OWN = (
    '<Clock name="own" valueReference="24" causality="input" intervalVariability="fixed" priority="5"/>\n    '
)


def clocks_fmu(folder, kinds="me cs se", *, own=False, variable_step=True):
    """The FMU file; `own` has the clock whose interval the importer must set."""
    library = folder / f"clocks{fmpy.sharedLibraryExtension}"
    if not library.exists():
        compiled("clocks.c", library)
    path = folder / f"{kinds.replace(' ', '-')}{own:d}{variable_step:d}.fmu"
    tags = "".join(KINDS[kind] for kind in kinds.split())
    tags = tags.replace("{variable_step}", str(variable_step).lower())
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION.format(kinds=tags, own=OWN * own))
        archive.write(library, f"binaries/{FOLDERS['3.0']}/clocks{fmpy.sharedLibraryExtension}")
    return path
