"""The modelDescription.xml of FMI 2.0 and 3.0, from `interface` and the equations' dependencies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from xml.etree import ElementTree as ET

from platoon_fmu import interface
from platoon_fmu.interface import Variable

#: For each unknown (by name), the names of the knowns on which it depends.
Dependencies = Mapping[str, Sequence[str]]

_MODEL = {
    "modelName": "Vehicle",
    "description": "8-DOF vehicle: longitudinal, lateral, yaw, roll and four wheel spins on brush tyres",
    "generationTool": "platoon",
    "variableNamingConvention": "structured",
}
_EXPERIMENT = {"startTime": "0", "stopTime": "10", "tolerance": "1e-6", "stepSize": "0.01"}
_LOG_CATEGORIES = {
    "logStatusError": "Refused calls and failed steps, with the reason",
    "logEvents": "The phases of an instance's life",
    "logAll": "All of these",
}
_ENUMERATION = "Solver"
_REFERENCE = {variable.name: i for i, variable in enumerate(interface.VARIABLES)}
_STATES = [v.name for v in interface.STATES]
_DERIVATIVES = [v.name for v in interface.DERIVATIVES]
_OUTPUTS = [*_STATES, *(v.name for v in interface.OUTPUTS)]


def _number(value: float) -> str:
    return repr(float(value))


def _text(root: ET.Element) -> bytes:
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _head(root: ET.Element, enumeration: ET.Element) -> None:
    """The elements common to both versions between the interface types and the variables."""
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name, unit in interface.UNITS.items():
        element = ET.SubElement(definitions, "Unit", name=name)
        ET.SubElement(element, "BaseUnit", {base: str(e) for base, e in unit.exponents.items()})
        for display, factor in unit.display.items():
            ET.SubElement(element, "DisplayUnit", name=display, factor=_number(factor))
    ET.SubElement(root, "TypeDefinitions").append(enumeration)
    categories = ET.SubElement(root, "LogCategories")
    for name, description in _LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=description)
    ET.SubElement(root, "DefaultExperiment", _EXPERIMENT)


def _items(parent: ET.Element) -> None:
    for value, (name, description) in enumerate(interface.SOLVER.items, start=1):
        ET.SubElement(parent, "Item", name=name, value=str(value), description=description)


def _identity(variable: Variable) -> dict[str, str]:
    """The attributes common to all types of variables."""
    attributes = {
        "name": variable.name,
        "valueReference": str(_REFERENCE[variable.name]),
        "description": variable.description,
        "causality": variable.causality,
        "variability": variable.variability,
    }
    if variable.causality == "parameter":
        attributes["initial"] = "exact"
    elif variable.causality in ("output", "local"):
        attributes["initial"] = "calculated"
    return attributes


def _quantity(variable: Variable) -> dict[str, str]:
    """The attributes of a variable's type, except the one that makes it a derivative."""
    if variable.items:
        return {"declaredType": _ENUMERATION, "start": str(int(variable.start or 1))}
    quantity = {"unit": variable.unit}
    if variable.display_unit is not None:
        quantity["displayUnit"] = variable.display_unit
    numbers = {
        "min": variable.minimum,
        "max": variable.maximum,
        "nominal": variable.nominal,
        "start": variable.start,
    }
    return quantity | {key: _number(value) for key, value in numbers.items() if value is not None}


def _in_order(names: Iterable[str]) -> list[str]:
    return sorted(names, key=_REFERENCE.__getitem__)


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
        {"fmiVersion": "2.0", "guid": token, "version": version, "numberOfEventIndicators": "0", **_MODEL},
    )
    common = {
        "modelIdentifier": identifier,
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
    }
    own = {
        "ModelExchange": {"completedIntegratorStepNotNeeded": "true"},
        "CoSimulation": {"canHandleVariableCommunicationStepSize": "true", "maxOutputDerivativeOrder": "1"},
    }
    for tag, flags in own.items():
        files = ET.SubElement(ET.SubElement(root, tag, common | flags), "SourceFiles")
        for source in sources:
            ET.SubElement(files, "File", name=source)
    simple_type = ET.Element("SimpleType", name=_ENUMERATION)
    _items(ET.SubElement(simple_type, "Enumeration"))
    _head(root, simple_type)
    # FMI 2.0 uses variable indices from 1 where FMI 3.0 uses value references.
    index = {name: str(reference + 1) for name, reference in _REFERENCE.items()}
    variables = ET.SubElement(root, "ModelVariables")
    for variable in interface.VARIABLES:
        element = ET.SubElement(variables, "ScalarVariable", _identity(variable))
        quantity = _quantity(variable)
        if variable.derivative_of is not None:
            quantity["derivative"] = index[variable.derivative_of]
        ET.SubElement(element, "Enumeration" if variable.items else "Real", quantity)
    structure = ET.SubElement(root, "ModelStructure")
    for tag, names, dependencies in (
        ("Outputs", _OUTPUTS, simulating),
        ("Derivatives", _DERIVATIVES, simulating),
        ("InitialUnknowns", [*_OUTPUTS, *_DERIVATIVES], initial),
    ):
        parent = ET.SubElement(structure, tag)
        for name in _in_order(names):
            knowns = " ".join(index[known] for known in _in_order(dependencies[name]))
            ET.SubElement(parent, "Unknown", index=index[name], dependencies=knowns)
    return _text(root)


def fmi3_xml(
    *,
    token: str,
    identifier: str,
    version: str,
    sources: Sequence[str],  # noqa: ARG001 - in FMI 3.0 they are in sources/buildDescription.xml
    simulating: Dependencies,
    initial: Dependencies,
) -> bytes:
    """The modelDescription of FMI 3.0, Model Exchange and Co-Simulation, as UTF-8.

    Args:
        token: the instantiation token.
        identifier: the binary's name without suffix.
        version: the model's version.
        sources: not used.
        simulating: dependencies of outputs, states' derivatives on states and inputs.
        initial: dependencies of states, derivatives and outputs on inputs and parameters while initializing.
    """
    root = ET.Element(
        "fmiModelDescription", {"fmiVersion": "3.0", "instantiationToken": token, "version": version, **_MODEL}
    )
    common = {
        "modelIdentifier": identifier,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true",
        "providesAdjointDerivatives": "true",
    }
    ET.SubElement(root, "ModelExchange", {**common, "needsCompletedIntegratorStep": "false"})
    simulation = {
        "canHandleVariableCommunicationStepSize": "true",
        "maxOutputDerivativeOrder": "1",
        "providesIntermediateUpdate": "true",
        "canReturnEarlyAfterIntermediateUpdate": "true",
        "mightReturnEarlyFromDoStep": "false",
        "hasEventMode": "false",
    }
    ET.SubElement(root, "CoSimulation", common | simulation)
    enumeration = ET.Element("EnumerationType", name=_ENUMERATION)
    _items(enumeration)
    _head(root, enumeration)
    variables = ET.SubElement(root, "ModelVariables")
    for variable in interface.VARIABLES:
        attributes = _identity(variable) | _quantity(variable)
        if variable.derivative_of is not None:
            attributes["derivative"] = str(_REFERENCE[variable.derivative_of])
        if variable.causality == "output":
            attributes["intermediateUpdate"] = "true"
        ET.SubElement(variables, "Enumeration" if variable.items else "Float64", attributes)
    structure = ET.SubElement(root, "ModelStructure")
    for tag, names, dependencies in (
        ("Output", _OUTPUTS, simulating),
        ("ContinuousStateDerivative", _DERIVATIVES, simulating),
        ("InitialUnknown", [*_OUTPUTS, *_DERIVATIVES], initial),
    ):
        for name in _in_order(names):
            knowns = " ".join(str(_REFERENCE[known]) for known in _in_order(dependencies[name]))
            ET.SubElement(structure, tag, valueReference=str(_REFERENCE[name]), dependencies=knowns)
    return _text(root)
