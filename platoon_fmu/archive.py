"""An FMU as a zip file: anything that is not an FMU is refused before its content is used.

FMI 2.0.4, section 2.3, and FMI 3.0.1, section 2.5: the layout of the archive.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

from platoon_fmu.errors import FmuError

DESCRIPTION = "modelDescription.xml"
LIBRARY_SUFFIXES = (".so", ".dll", ".dylib")

#: Largest allowed size of an unpacked FMU [byte]: any machine that runs this has so much free disk space.
LARGEST_SIZE = 2 * 1024**3

# What zipfile raises on a member that is damaged, encrypted, or packed by an unknown method.
_UNREADABLE = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, NotImplementedError, ValueError)


def check_archive(fmu: Path) -> None:
    """Refuses a file that is not an FMU, or one of an unsupported version.

    Raises:
        FmuError: it is missing, not a zip file, damaged, too large, would unpack outside its folder, or its
            modelDescription.xml is missing, not XML, not FMI, or of a version other than 2.0 and 3.0.
    """
    with _opened(fmu) as archive:
        _check_description(fmu, archive)


def unpack(fmu: Path, folder: Path) -> None:
    """Unpacks an FMU.

    Raises:
        FmuError: as `check_archive`, or a member is damaged or the disk is full.
    """
    with _opened(fmu) as archive:
        _check_description(fmu, archive)
        for member in archive.infolist():
            try:
                archive.extract(member, folder)
            except _UNREADABLE as error:
                raise FmuError(f"{fmu}: its member {member.filename} is damaged: {error}") from error
            except OSError as error:
                reason = error.strerror or error
                raise FmuError(f"{fmu}: its member {member.filename} cannot be unpacked: {reason}") from error


def read_description(fmu: Path) -> Any:
    """An FMU's modelDescription.xml as parsed by fmpy.

    Raises:
        FmuError: as `check_archive`, or fmpy cannot parse it.
    """
    import fmpy

    check_archive(fmu)
    try:
        return fmpy.read_model_description(str(fmu), validate=False)
    except Exception as error:
        # A file that violates the standard's schema can fail anywhere in fmpy.
        reason = _first_problem(fmu) or one_line(error)
        raise FmuError(f"{fmu} is not a readable FMU: its {DESCRIPTION} is invalid: {reason}") from error


def _first_problem(fmu: Path) -> str:
    from fmpy.validation import validate_fmu

    return next((one_line(problem) for problem in validate_fmu(str(fmu))), "")


def member_names(fmu: Path) -> list[str]:
    """The names of all files in an FMU.

    Raises:
        FmuError: the file is missing or not a zip file.
    """
    with _opened(fmu) as archive:
        return archive.namelist()


def interface_types(content: bytes) -> dict[str, dict[str, str]]:
    """The raw attributes of a modelDescription.xml's interface types, including the capability flags.

    fmpy does not parse all of them under their FMI 3.0 names.

    Args:
        content: of a modelDescription.xml.

    Returns:
        attributes by name, for each element by its name (`ModelExchange`, `CoSimulation`, `ScheduledExecution`).
    """
    root = ElementTree.fromstring(content)
    tags = ("ModelExchange", "CoSimulation", "ScheduledExecution")
    return {tag: dict(element.attrib) for tag in tags for element in root.findall(tag)}


def description_text(fmu: Path) -> bytes:
    """The bytes of an FMU's modelDescription.xml.

    Raises:
        FmuError: as `check_archive`.
    """
    with _opened(fmu) as archive:
        _check_description(fmu, archive)
        return archive.read(DESCRIPTION)


def platforms(names: Iterable[str]) -> tuple[str, ...]:
    """The platforms for which an FMU has a binary, sorted, named as its folders in binaries/.

    Args:
        names: of the files in the FMU.
    """
    paths = [PurePosixPath(name) for name in names]
    libraries = [p for p in paths if p.suffix in LIBRARY_SUFFIXES and len(p.parts) > 2 and p.parts[0] == "binaries"]
    return tuple(sorted({path.parts[1] for path in libraries}))


def one_line(text: object) -> str:
    """A text without its line breaks."""
    return " ".join(str(text).split())


@contextmanager
def _opened(fmu: Path) -> Iterator[zipfile.ZipFile]:
    if fmu.is_dir():
        raise FmuError(f"{fmu} is a directory, not an FMU; name the .fmu file")
    if not fmu.is_file():
        raise FmuError(f"{fmu}: no such file")
    try:
        archive = zipfile.ZipFile(fmu)
    except OSError as error:
        raise FmuError(f"{fmu} cannot be read: {error.strerror or error}") from error
    except _UNREADABLE as error:
        raise FmuError(f"{fmu}: not an FMU: not a zip file, or a truncated one") from error
    with archive:
        _check_members(fmu, archive.infolist())
        yield archive


def _check_members(fmu: Path, members: list[zipfile.ZipInfo]) -> None:
    for member in members:
        # On systems with a different separator, zipfile has already changed `filename`.
        name = member.orig_filename
        if name.startswith("/") or any(part in ("..", "") for part in name.rstrip("/").split("/")):
            raise FmuError(f"{fmu}: its member {name!r} would be unpacked outside its folder")
        if "\\" in name or ":" in name:
            raise FmuError(
                f"{fmu}: the name of its member {name!r} has a character that is not allowed in an FMU's paths"
            )
    size = sum(member.file_size for member in members)
    if size > LARGEST_SIZE:
        largest = f"{LARGEST_SIZE / 1024**3:g} GiB"
        raise FmuError(f"{fmu}: its unpacked size is {size / 1024**3:.1f} GiB; allowed: up to {largest}")


def _check_description(fmu: Path, archive: zipfile.ZipFile) -> None:
    try:
        content = archive.read(DESCRIPTION)
    except KeyError:
        raise FmuError(f"{fmu} is not an FMU: it has no {DESCRIPTION}") from None
    except _UNREADABLE as error:
        raise FmuError(f"{fmu}: its member {DESCRIPTION} is damaged: {error}") from error
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FmuError(f"{fmu} is not an FMU: its {DESCRIPTION} is not XML: {error}") from error
    version = root.get("fmiVersion")
    if root.tag != "fmiModelDescription":
        raise FmuError(f"{fmu} is not an FMU: its {DESCRIPTION} has the root <{root.tag}>, not <fmiModelDescription>")
    if version is None:
        raise FmuError(f"{fmu} is not an FMU: its {DESCRIPTION} has no fmiVersion")
    if version != "2.0" and not version.startswith("3.0"):
        raise FmuError(f"{fmu}: FMI {version} is not supported; allowed: 2.0 and 3.0")
