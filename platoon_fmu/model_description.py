"""The FMI 2.0 modelDescription.xml, from `interface` and the equations' dependencies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET

from platoon_fmu import interface
from platoon_fmu.interface import Variable

#: For each unknown (by name) the names of the knowns it depends on.
Dependencies = Mapping[str, Sequence[str]]

_INDEX = {variable.name: i for i, variable in enumerate(interface.VARIABLES, start=1)}


def _number(value: float) -> str:
    return repr(float(value))


def _units(root: ET.Element) -> None:
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name, unit in interface.UNITS.items():
        element = ET.SubElement(definitions, "Unit", name=name)
        ET.SubElement(element, "BaseUnit", {base: str(e) for base, e in unit.exponents.items()})
        for display, factor in unit.display.items():
            ET.SubElement(element, "DisplayUnit", name=display, factor=_number(factor))


def _variable(parent: ET.Element, reference: int, variable: Variable) -> None:
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "description": variable.description,
        "causality": variable.causality,
        "variability": variable.variability,
    }
    if variable.causality == "parameter":
        attributes["initial"] = "exact"
    elif variable.start is None:
        attributes["initial"] = "calculated"
    element = ET.SubElement(parent, "ScalarVariable", attributes)
    real = {"unit": variable.unit}
    numbers = {
        "min": variable.minimum,
        "max": variable.maximum,
        "nominal": variable.nominal,
        "start": variable.start,
    }
    real.update({key: _number(value) for key, value in numbers.items() if value is not None})
    if variable.derivative_of is not None:
        real["derivative"] = str(_INDEX[variable.derivative_of])
    ET.SubElement(element, "Real", real)


def _unknowns(parent: ET.Element, tag: str, names: Sequence[str], dependencies: Dependencies) -> None:
    element = ET.SubElement(parent, tag)
    for name in sorted(names, key=_INDEX.__getitem__):
        knowns = sorted(_INDEX[known] for known in dependencies[name])
        ET.SubElement(element, "Unknown", index=str(_INDEX[name]), dependencies=" ".join(map(str, knowns)))


def _implementation(root: ET.Element, tag: str, identifier: str, sources: Sequence[str], flags: dict[str, str]) -> None:
    common = {"modelIdentifier": identifier, "canNotUseMemoryManagementFunctions": "true"}
    element = ET.SubElement(root, tag, {**common, **flags})
    files = ET.SubElement(element, "SourceFiles")
    for source in sources:
        ET.SubElement(files, "File", name=source)


def fmi2_xml(
    *,
    token: str,
    identifier: str,
    version: str,
    sources: Sequence[str],
    simulating: Dependencies,
    initial: Dependencies,
) -> bytes:
    """The modelDescription of FMI 2.0, Model Exchange and Co-Simulation, as UTF-8.

    Args:
        token: the guid.
        identifier: the binary's name without suffix.
        version: the model's version.
        sources: the C files of sources/ to compile.
        simulating: dependencies of outputs, states' derivatives on states and inputs.
        initial: dependencies of states, derivatives and outputs on inputs and parameters while initializing.
    """
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName="Vehicle",
        guid=token,
        description="8-DOF vehicle: longitudinal, lateral, yaw, roll and four wheel spins on brush tyres",
        version=version,
        generationTool="platoon",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    exchange = {"completedIntegratorStepNotNeeded": "true"}
    cosimulation = {"canHandleVariableCommunicationStepSize": "true"}
    _implementation(root, "ModelExchange", identifier, sources, exchange)
    _implementation(root, "CoSimulation", identifier, sources, cosimulation)
    _units(root)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="Calls refused, with the reason")
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10", tolerance="1e-6", stepSize="0.01")
    variables = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(interface.VARIABLES):
        _variable(variables, reference, variable)
    structure = ET.SubElement(root, "ModelStructure")
    states = [v.name for v in interface.STATES]
    derivatives = [v.name for v in interface.DERIVATIVES]
    outputs = [*states, *(v.name for v in interface.OUTPUTS)]
    _unknowns(structure, "Outputs", outputs, simulating)
    _unknowns(structure, "Derivatives", derivatives, simulating)
    _unknowns(structure, "InitialUnknowns", [*outputs, *derivatives], initial)
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"
