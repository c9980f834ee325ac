"""The content of Vehicle.fmu besides binaries: sources, descriptions, icons, documentation.

The model's C code and the documentation page are generated once for all versions of the standard.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as ET

from platoon_fmu import codegen, documentation, model_description
from platoon_fmu.versions import Version

_PACKAGE = Path(__file__).resolve().parent
# The model's version, not the package's: it changes with equations and variables.
_VERSION = "1.0"
# The icon is a square of this side length; the millimetres tell a tool how large to draw it.
_ICON_UNITS, _ICON_MM = 128, 20 / 128


@dataclass(frozen=True)
class Sources:
    """The C code of an FMU.

    Attributes:
        files: content by name: C files and headers.
        inputs: the C files among them, in compile order.
        description: the modelDescription that belongs to them.
    """

    files: Mapping[str, bytes]
    inputs: tuple[str, ...]
    description: bytes


@dataclass(frozen=True)
class _Generated:
    """The code that CasADi generates from the equations."""

    model: codegen.SymbolicModel
    equations: bytes
    simulating: model_description.Dependencies
    initial: model_description.Dependencies


@cache
def _generated() -> _Generated:
    model = codegen.symbolic_model()
    simulating, initial = codegen.dependencies(model)
    return _Generated(model, codegen.equations_c(model).encode(), simulating, initial)


@cache
def _page() -> bytes:
    return documentation.page(_generated().model)


def sources(version: Version, identifier: str, files: Sequence[Path], headers: Sequence[Path]) -> Sources:
    """The C code of an FMU and its modelDescription, which carry the same token.

    Args:
        version: of the standard.
        identifier: the binary's name without suffix.
        files: the hand-written C files and headers.
        headers: the standard's headers.
    """
    generated = _generated()
    content = {path.name: path.read_bytes() for path in (*files, *headers)}
    content["equations.c"] = generated.equations
    inputs = tuple(sorted({*(name for name in content if name.endswith(".c")), "vehicle.c"}))
    write: Callable[..., bytes] = getattr(model_description, version.xml)

    def description(token: str) -> bytes:
        return write(
            token=token,
            identifier=identifier,
            version=_VERSION,
            sources=inputs,
            simulating=generated.simulating,
            initial=generated.initial,
        )

    # The token is a hash of everything else, so that a binary refuses a modelDescription of another build.
    digest = hashlib.sha256(description("") + codegen.table_c(generated.model, "").encode())
    for name in sorted(content):
        digest.update(content[name])
    token = f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"
    content["vehicle.c"] = codegen.table_c(generated.model, token).encode()
    return Sources(content, inputs, description(token))


def members(version: Version, identifier: str, code: Sources) -> dict[str, bytes]:
    """All files of an FMU except its binaries and their compilers' licenses, by path."""
    icon = (_PACKAGE / "icon.png").read_bytes()
    found = {
        "modelDescription.xml": code.description,
        **{f"sources/{name}": content for name, content in code.files.items()},
        "sources/buildDescription.xml": _build_description(identifier, code.inputs),
        "terminalsAndIcons/terminalsAndIcons.xml": _terminals_and_icons(),
        "terminalsAndIcons/icon.png": icon,
        "terminalsAndIcons/icon.svg": (_PACKAGE / "icon.svg").read_bytes(),
        "documentation/index.html": _page(),
        "documentation/licenses/license.txt": (_PACKAGE / "license.txt").read_bytes(),
    }
    if version.image is not None:
        found[version.image] = icon
    return found


def _xml(root: ET.Element) -> bytes:
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _build_description(identifier: str, inputs: Sequence[str]) -> bytes:
    """sources/buildDescription.xml of FMI 3.0, section 2.5.1.3, adopted by FMI 2.0.4."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for name in inputs:
        ET.SubElement(files, "SourceFile", name=name)
    return _xml(root)


def _terminals_and_icons() -> bytes:
    """terminalsAndIcons.xml of FMI 3.0, section 2.4.9, adopted by FMI 2.0.4: the icon fills its square."""
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    graphics = ET.SubElement(root, "GraphicalRepresentation")
    corners = {"x1": "0", "y1": "0", "x2": str(_ICON_UNITS), "y2": str(_ICON_UNITS)}
    ET.SubElement(graphics, "CoordinateSystem", corners, suggestedScalingFactorTo_mm=str(_ICON_MM))
    ET.SubElement(graphics, "Icon", corners)
    return _xml(root)
