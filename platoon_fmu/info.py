"""The content of an FMU's modelDescription.xml and archive, in one form for FMI 2.0 and 3.0."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from platoon_fmu import archive

Value = float | int | bool | str

#: The causalities in display order.
CAUSALITIES = (
    "input",
    "output",
    "parameter",
    "calculatedParameter",
    "structuralParameter",
    "local",
    "independent",
)

#: The variabilities in display order.
VARIABILITIES = ("continuous", "discrete", "tunable", "fixed", "constant")

_FLOATS = ("Real", "Float32", "Float64")
_TEXTS = ("String", "Binary")


@dataclass(frozen=True)
class VariableInfo:
    """One variable; None for what is not given.

    Attributes:
        name: its name.
        type: FMI's name for its type.
        shape: an array's dimensions at the start; empty for a scalar.
        causality: as in FMI.
        variability: as in FMI.
        unit: of all values below.
        display_unit: the preferred unit for display.
        start: start value, or a list of them for an array.
        minimum: least value.
        maximum: greatest value.
        nominal: usual magnitude.
        items: names of an enumeration's values, by value.
        description: one line.
    """

    name: str
    type: str
    shape: tuple[int, ...]
    causality: str
    variability: str
    unit: str | None
    display_unit: str | None
    start: Value | list[Value] | None
    minimum: Value | None
    maximum: Value | None
    nominal: Value | None
    items: Mapping[str, str]
    description: str | None


@dataclass(frozen=True)
class FmuInfo:
    """An FMU.

    Attributes:
        model_name: the model's name.
        fmi_version: as written in the FMU.
        description: one line, or None.
        model_version: the model's version, or None.
        generation_tool: the tool that created it, or None.
        generation_time: when it was created, or None.
        interface_types: attributes by kind (`Model Exchange`, ...): the capability flags that are given.
        platforms: those with a binary, named as the folders in binaries/.
        has_sources: whether it contains C code.
        default_experiment: start time, stop time, step size [s] and tolerance, those that are given.
        variables: all variables in the order of modelDescription.xml.
    """

    model_name: str
    fmi_version: str
    description: str | None
    model_version: str | None
    generation_tool: str | None
    generation_time: str | None
    interface_types: Mapping[str, Mapping[str, Value]]
    platforms: tuple[str, ...]
    has_sources: bool
    default_experiment: Mapping[str, Value]
    variables: tuple[VariableInfo, ...]


def info(fmu: Path) -> FmuInfo:
    """Everything that can be read from an FMU without running it.

    Raises:
        FmuError: it is missing, damaged, not an FMU, or of a version other than FMI 2.0 and 3.0.
    """
    description = archive.read_description(fmu)
    files = archive.member_names(fmu)
    experiment = description.defaultExperiment
    times = {name: getattr(experiment, name, None) for name in ("startTime", "stopTime", "stepSize", "tolerance")}
    return FmuInfo(
        model_name=description.modelName or "",
        fmi_version=description.fmiVersion,
        description=description.description,
        model_version=description.version,
        generation_tool=description.generationTool,
        generation_time=description.generationDateAndTime,
        interface_types=_interface_types(archive.description_text(fmu)),
        platforms=archive.platforms(files),
        has_sources=any(name.startswith("sources/") and not name.endswith("/") for name in files),
        default_experiment={name: _as("Real", text) for name, text in times.items() if text is not None},
        variables=tuple(_variable(variable) for variable in description.modelVariables),
    )


def _interface_types(content: bytes) -> dict[str, dict[str, Value]]:
    names = {
        "ModelExchange": "Model Exchange",
        "CoSimulation": "Co-Simulation",
        "ScheduledExecution": "Scheduled Execution",
    }
    found = archive.interface_types(content)
    return {names[tag]: {flag: _flag(text) for flag, text in flags.items()} for tag, flags in found.items()}


def _flag(text: str) -> Value:
    return int(text) if text.isdigit() else {"true": True, "false": False}.get(text, text)


def _variable(variable: Any) -> VariableInfo:
    def of_type(name: str) -> Any:
        own = getattr(variable, name)
        return getattr(variable.declaredType, name) if own is None and variable.declaredType is not None else own

    def value(name: str) -> Value | None:
        text = of_type(name)
        return None if text is None else _as(variable.type, text)

    items = variable.declaredType.items if variable.type == "Enumeration" and variable.declaredType else ()
    return VariableInfo(
        name=variable.name,
        type=variable.type,
        shape=tuple(variable.shape or ()),
        causality=variable.causality,
        variability=variable.variability,
        unit=of_type("unit"),
        display_unit=of_type("displayUnit"),
        start=_start(variable),
        minimum=value("min"),
        maximum=value("max"),
        nominal=value("nominal"),
        items={item.value: item.name for item in items},
        description=of_type("description"),
    )


def _start(variable: Any) -> Value | list[Value] | None:
    if variable.start is None:
        return None
    if variable.type in _TEXTS:
        return str(variable.start)
    values = [_as(variable.type, text) for text in variable.start.split()]
    return values if len(values) != 1 else values[0]


def _as(type_name: str, text: str) -> Value:
    """A value converted to its type; the text itself if that fails."""
    if type_name == "Boolean":
        return {"true": True, "1": True, "false": False, "0": False}.get(text, text)
    try:
        return float(text) if type_name in _FLOATS or type_name == "Clock" else int(text)
    except ValueError:
        return text
