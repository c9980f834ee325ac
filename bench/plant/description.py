"""The part of an FMU's modelDescription.xml that the bench needs, read without loading it (FMI 2.0.4, section 2.2)."""

import zipfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from bench.errors import BadInput


@dataclass(frozen=True)
class FmuDescription:
    """An FMU's identity and its real variables.

    Attributes:
        guid: identifies the model; the binary checks it.
        model_identifier: name of the binary for co-simulation.
        references: value reference of each variable by name.
        units: unit of each variable that has one.
        outputs: names of the outputs, in the file's order.
        inputs: names of the inputs, in the file's order.
        xml: the file itself.
    """

    guid: str
    model_identifier: str
    references: dict[str, int]
    units: dict[str, str]
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    xml: bytes

    @property
    def truth_names(self) -> tuple[str, ...]:
        """Names of the values of a truth row: all outputs, then all inputs."""
        return self.outputs + self.inputs

    @property
    def truth_units(self) -> dict[str, str]:
        """Units of the values of a truth row that have one."""
        return {name: self.units[name] for name in self.truth_names if name in self.units}


def read_description(fmu: Path) -> FmuDescription:
    """Read the modelDescription of the FMU file `fmu`.

    Raises:
        BadInput: it cannot be read, or is not an FMI 2.0 FMU for co-simulation.
    """
    try:
        with zipfile.ZipFile(fmu) as archive:
            xml = archive.read("modelDescription.xml")
        root = ElementTree.fromstring(xml)
    except (OSError, KeyError, zipfile.BadZipFile, ElementTree.ParseError) as error:
        raise BadInput(f"{fmu} cannot be read as an FMU: {error}; rebuild it: platoon fmu build") from error
    simulation = root.find("CoSimulation")
    if root.get("fmiVersion") != "2.0" or simulation is None:
        raise BadInput(f"{fmu} is not an FMI 2.0 FMU for co-simulation; rebuild it: platoon fmu build")
    references: dict[str, int] = {}
    units: dict[str, str] = {}
    names: dict[str, list[str]] = {"output": [], "input": []}
    for variable in root.iterfind("ModelVariables/ScalarVariable"):
        real = variable.find("Real")
        name = variable.get("name", "")
        if real is None:
            continue
        references[name] = int(variable.get("valueReference", "0"))
        if unit := real.get("unit"):
            units[name] = unit
        names.get(variable.get("causality", "local"), []).append(name)
    return FmuDescription(
        guid=root.get("guid", ""),
        model_identifier=simulation.get("modelIdentifier", ""),
        references=references,
        units=units,
        outputs=tuple(names["output"]),
        inputs=tuple(names["input"]),
        xml=xml,
    )
