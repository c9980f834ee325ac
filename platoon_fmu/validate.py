"""Checks of an FMU: fmpy's static ones, and a short run of every kind the FMU says it has."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

from platoon_fmu.errors import FmuError

_RUN_S = 0.1


def check_archive(fmu: Path) -> None:
    """Refuses a file that is no FMU at all.

    Raises:
        FmuError: it is missing, no zip file, damaged, or has no modelDescription.xml.
    """
    if not fmu.is_file():
        raise FmuError(f"{fmu}: no such file")
    try:
        with zipfile.ZipFile(fmu) as archive:
            names = archive.namelist()
            broken = archive.testzip()
    except (zipfile.BadZipFile, OSError, EOFError) as error:
        raise FmuError(f"{fmu}: not a zip file, so not an FMU ({error})") from error
    if broken is not None:
        raise FmuError(f"{fmu}: the member {broken} is damaged")
    if "modelDescription.xml" not in names:
        raise FmuError(f"{fmu}: has no modelDescription.xml, so it is not an FMU")


def _run(fmu: Path, description: Any, kind: str) -> list[str]:
    """The problems of a short run of one kind; what the FMU logs about it comes along."""
    import fmpy

    said: list[str] = []

    def logger(_environment: Any, _instance: Any, status: int, _category: Any, message: bytes) -> None:
        said.append(f"status {status}: {message.decode(errors='replace')}")

    try:
        fmpy.simulate_fmu(
            str(fmu), model_description=description, fmi_type=kind, stop_time=_RUN_S, logger=logger, debug_logging=True
        )
    except Exception as error:  # noqa: BLE001 - whatever a foreign FMU does wrong is what is asked for
        return [f"{kind}: a run of {_RUN_S} s failed: {error}", *said]
    return [f"{kind}: {line}" for line in said]


def validate(fmu: Path) -> list[str]:
    """The problems found in an FMU, one line each; empty where there is none.

    Raises:
        FmuError: the file is missing, damaged or no FMU.
    """
    check_archive(fmu)
    # fmpy changes the working directory while it runs an FMU, and stays there where that fails.
    fmu = fmu.resolve()
    import fmpy
    from fmpy.validation import validate_fmu

    problems = [str(problem) for problem in validate_fmu(str(fmu))]
    if problems:
        return problems
    description = fmpy.read_model_description(str(fmu))
    kinds = {"ModelExchange": description.modelExchange, "CoSimulation": description.coSimulation}
    if fmpy.platform not in fmpy.supported_platforms(str(fmu)):
        return [f"there is no binary for this platform ({fmpy.platform}), so it was not run"]
    return [line for kind, there in kinds.items() if there is not None for line in _run(fmu, description, kind)]
