"""The ball of foreign/ball.c as an FMU: model exchange with every kind of event."""

import zipfile

import fmpy
from foreign_fmus import FOLDERS, compiled

# name, value reference, kind of number, causality, variability, start, derivative of (place in the list from 1)
VARIABLES = [
    ("h", 1, "Real", "output", "continuous", "1.0", None),
    ("v", 2, "Real", "output", "continuous", "0.0", None),
    ("der(h)", 3, "Real", "local", "continuous", None, 1),
    ("der(v)", 4, "Real", "local", "continuous", None, 2),
    ("push", 5, "Real", "input", "continuous", "0.0", None),
    ("g", 6, "Real", "parameter", "fixed", "9.81", None),
    ("e", 7, "Real", "parameter", "fixed", "0.7", None),
    ("tick", 8, "Real", "parameter", "fixed", "0.25", None),
    ("from", 9, "Real", "parameter", "fixed", "0.1", None),
    ("last", 10, "Integer", "parameter", "fixed", "1000", None),
    ("ticks", 11, "Integer", "output", "discrete", None, None),
    ("noticed", 12, "Integer", "output", "discrete", None, None),
    ("energy", 13, "Real", "local", "continuous", None, None),
]
OUTPUTS = ["h", "v", "ticks", "noticed"]


def description(fmi):
    """modelDescription.xml of the ball."""
    return _second() if fmi == "2.0" else _third()


def _second():
    rows = []
    for name, reference, kind, causality, variability, start, state in VARIABLES:
        attributes = (f' start="{start}"' if start else "") + (f' derivative="{state}"' if state else "")
        initial = ' initial="exact"' if start and causality == "output" else ""
        rows.append(
            f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
            f'variability="{variability}"{initial}><{kind}{attributes}/></ScalarVariable>'
        )
    place = {row[0]: i for i, row in enumerate(VARIABLES, 1)}
    outputs = "".join(f'<Unknown index="{place[name]}" dependencies=""/>' for name in OUTPUTS)
    rates = "".join(f'<Unknown index="{place[name]}"/>' for name in ("der(h)", "der(v)"))
    unknowns = "".join(f'<Unknown index="{place[n]}"/>' for n in ("der(h)", "der(v)", "ticks", "noticed"))
    return (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="Ball" guid="ball" '
        'numberOfEventIndicators="1"><ModelExchange modelIdentifier="ball"/>'
        '<DefaultExperiment startTime="0.0" stopTime="2.0"/>'
        f"<ModelVariables>{''.join(rows)}</ModelVariables><ModelStructure><Outputs>{outputs}</Outputs>"
        f"<Derivatives>{rates}</Derivatives><InitialUnknowns>{unknowns}</InitialUnknowns></ModelStructure>"
        "</fmiModelDescription>"
    )


def _third():
    reference = {row[0]: row[1] for row in VARIABLES}
    rows = ['<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>']
    for name, number, kind, causality, variability, start, state in VARIABLES:
        word = {"Real": "Float64", "Integer": "Int32"}[kind]
        attributes = (f' start="{start}"' if start else "") + (f' derivative="{state}"' if state else "")
        initial = ' initial="exact"' if start and causality == "output" else ""
        rows.append(
            f'<{word} name="{name}" valueReference="{number}" causality="{causality}" '
            f'variability="{variability}"{initial}{attributes}/>'
        )
    outputs = "".join(f'<Output valueReference="{reference[name]}" dependencies=""/>' for name in OUTPUTS)
    rates = '<ContinuousStateDerivative valueReference="3"/><ContinuousStateDerivative valueReference="4"/>'
    unknowns = "".join(f'<InitialUnknown valueReference="{number}"/>' for number in (3, 4, 11, 12))
    return (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" modelName="Ball" '
        'instantiationToken="ball"><ModelExchange modelIdentifier="ball"/>'
        '<DefaultExperiment startTime="0.0" stopTime="2.0"/>'
        f"<ModelVariables>{''.join(rows)}</ModelVariables>"
        f'<ModelStructure>{outputs}{rates}{unknowns}<EventIndicator valueReference="1"/></ModelStructure>'
        "</fmiModelDescription>"
    )


def ball(folder, fmi="2.0", *, state=False):
    """The FMU file; with `state` it says that it can put its state back."""
    library = folder / f"ball{fmi[0]}{fmpy.sharedLibraryExtension}"
    compiled("ball.c", library, f"-DFMI={fmi[0]}")
    path = folder / f"ball{fmi[0]}{state:d}.fmu"
    keeps = f' canGetAndSetFMU{"state" if fmi == "2.0" else "State"}="true"' * state
    text = description(fmi).replace(
        '<ModelExchange modelIdentifier="ball"', f'<ModelExchange modelIdentifier="ball"{keeps}'
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", text)
        archive.write(library, f"binaries/{FOLDERS[fmi]}/ball{fmpy.sharedLibraryExtension}")
    return path
