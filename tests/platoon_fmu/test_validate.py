"""The checks of an FMU: a sound one passes all, and each fault is found by the check that is there for it.

The FMUs are compiled from faulty/: one model, sound or with one fault, for each version of the standard.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest

from platoon_fmu.checks.findings import Check, Outcome
from platoon_fmu.checks.validate import validate
from platoon_fmu.errors import FmuError
from platoon_fmu.importer import Kind

SOURCES = Path(__file__).parent / "faulty"
HEADERS = Path(fmpy.__file__).parent / "c-code"
FOLDERS = {2: "linux64" if sys.platform == "linux" else "darwin64", 3: fmpy.platform_tuple}
ME, CS = Kind.MODEL_EXCHANGE, Kind.CO_SIMULATION
VERSIONS = pytest.mark.parametrize("version", [2, 3])
# Where what is checked does not depend on it.
EITHER_VERSION = pytest.mark.parametrize("version", [pytest.param(2, marks=pytest.mark.nightly), 3])

# For each fault which checks find it, and what they say.
FAULTS = {
    "DERIVATIVE": (
        {(kind, name) for kind in Kind for name in ("directional derivatives", "adjoint derivatives")},
        "d y / d u: the FMU gives 1, differences give 0.5, at its start values",
    ),
    "DAMPING": (
        {(ME, "directional derivatives"), (ME, "adjoint derivatives")},
        "d der_v / d v: the FMU gives 0, differences give -0.006",
    ),
    "ADJOINT": (
        {(ME, "adjoint derivatives"), (CS, "adjoint derivatives")},
        "d y / d u: the FMU gives 1, differences give 0.5",
    ),
    "DEPENDENCY": ({(ME, "declared dependencies")}, "y declares no dependency on v, but changes from 1.25 to"),
    "RESTORE": (
        {(kind, name) for kind in Kind for name in ("state restored", "state in another process")},
        "1 step after the state was restored in another process",
    ),
    "POINTER": (
        {(ME, "state in another process"), (CS, "state in another process")},
        "the process that restored the state crashes with SIGSEGV",
    ),
    "SHARED": ({(ME, "instances in turns"), (CS, "instances in turns")}, "in turns with another instance, but"),
    "RESET": ({(ME, "reset"), (CS, "reset")}, "1 step after a reset and a new start, but"),
    "SOLVER": ({(CS, "as Model Exchange")}, "0.05 of its range in the run"),
    "NAN": ({(ME, "short run"), (CS, "short run")}, "y is nan at t = 0.02 s"),
    "CRASH": ({(CS, "short run")}, "crashes with SIGSEGV"),
}
# What the model can have besides that is no fault.
WITHOUT_FAULT = ("WITH_KINK", "WITH_TIME_EVENTS")

Maker = Callable[..., Path]


@pytest.fixture
def spring(tmp_path) -> Maker:
    """Makes the FMU of faulty/ for a version, with what the compiler is told, and with its XML changed."""

    def make(version: int, *defined: str, replace: tuple[str, str] = ("", ""), platform: str | None = None) -> Path:
        library = tmp_path / f"Spring{fmpy.sharedLibraryExtension}"
        options = ["-shared", "-fPIC", "-O1", f"-I{HEADERS}", *(f"-D{name}" for name in defined)]
        source = SOURCES / f"fmi{version}.c"
        subprocess.run(["cc", *options, str(source), "-o", str(library), "-lm"], check=True)
        xml = (SOURCES / f"fmi{version}.xml").read_text(encoding="utf-8")
        assert replace[0] in xml
        fmu = tmp_path / "Spring.fmu"
        with zipfile.ZipFile(fmu, "w") as archive:
            archive.writestr("modelDescription.xml", xml.replace(*replace))
            archive.write(library, f"binaries/{platform or FOLDERS[version]}/{library.name}")
        return fmu

    return make


def problems(checks: list[Check]) -> list[Check]:
    return [check for check in checks if check.outcome is Outcome.PROBLEM]


def found(checks: list[Check], name: str, kind: str = "") -> Check:
    (check,) = [c for c in checks if c.name == name and (not kind or c.kind == kind)]
    return check


@pytest.mark.parametrize("name", ["fmu_path", "fmu3_path"])
def test_the_vehicle_passes_all_checks(request, name):
    checks = list(validate(request.getfixturevalue(name)))
    assert [c for c in checks if c.outcome is not Outcome.PASSED] == []
    assert len(checks) == (15 if name == "fmu_path" else 17)
    assert "37 unknowns over 15 knowns" in found(checks, "directional derivatives", CS).text


@VERSIONS
def test_a_sound_model_passes_all_checks(spring, version):
    checks = list(validate(spring(version)))
    assert [c for c in checks if c.outcome is not Outcome.PASSED] == []
    assert len(checks) == (15 if version == 2 else 17)
    # At a point besides the start, and with the array that FMI 3.0 has.
    text = found(checks, "directional derivatives", ME).text
    assert text.startswith(f"{4 if version == 2 else 6} unknowns over 3 knowns, at its start values and a tenth of")


# Each fault in one version of the standard, and in make nightly in the other one too; the checks are the same for both.
EVERY_FAULT = [
    pytest.param(fault, version, marks=[] if version == 3 - number % 2 else pytest.mark.nightly)
    for number, fault in enumerate(FAULTS)
    for version in (2, 3)
]


@pytest.mark.parametrize(("fault", "version"), EVERY_FAULT)
def test_a_fault_is_found_by_the_check_that_is_there_for_it_and_by_no_other(spring, version, fault):
    expected, said = FAULTS[fault]
    if version == 2:
        expected = {(kind, name) for kind, name in expected if name != "adjoint derivatives"}
    wrong = problems(list(validate(spring(version, f"FAULT_{fault}"))))
    assert {(check.kind, check.name) for check in wrong} == expected
    assert not expected or any(said in check.text for check in wrong), wrong


@EITHER_VERSION
def test_a_binary_that_hangs_is_one_problem_and_the_checks_go_on(spring, version):
    checks = list(validate(spring(version, "FAULT_HANG"), timeout_s=6.0))
    (hung,) = problems(checks)
    assert (hung.kind, hung.name, hung.text) == (CS, "short run", "does not return within 6 s")
    later = checks[checks.index(hung) + 1 :]
    assert {check.outcome for check in later} == {Outcome.SKIPPED}
    assert {check.text for check in later} == {"the short run did not complete"}
    assert found(checks, "declared dependencies").outcome is Outcome.PASSED


@EITHER_VERSION
def test_a_binary_that_crashes_later_leaves_the_other_checks(spring, version):
    checks = list(validate(spring(version, "FAULT_POINTER")))
    assert found(checks, "reset", CS).outcome is Outcome.PASSED
    assert found(checks, "as Model Exchange").outcome is Outcome.PASSED


@VERSIONS
def test_what_is_not_claimed_is_skipped_and_says_so(spring, version):
    flag = "canGetAndSetFMUstate" if version == 2 else "canGetAndSetFMUState"
    checks = list(validate(spring(version, "FAULT_RESTORE", replace=(f'{flag}="true"', f'{flag}="false"'))))
    assert problems(checks) == []
    for kind in Kind:
        for name in ("state restored", "state in another process"):
            check = found(checks, name, kind)
            assert check.outcome is Outcome.SKIPPED
            assert check.text == f"the FMU does not claim it: {flag} is not set"


@EITHER_VERSION
def test_of_what_can_be_instantiated_once_there_is_one_instance_at_a_time(spring, version):
    once = 'modelIdentifier="Spring" canBeInstantiatedOnlyOncePerProcess="true"'
    checks = list(validate(spring(version, "FAULT_SHARED", replace=('modelIdentifier="Spring"', once))))
    assert problems(checks) == []
    skipped = {(c.kind, c.name) for c in checks if c.outcome is Outcome.SKIPPED}
    assert skipped >= {(ME, "instances in turns"), (CS, "instances in turns"), (CS, "as Model Exchange")}


def test_with_state_events_the_kinds_are_not_compared(spring):
    checks = list(
        validate(spring(2, "FAULT_SOLVER", replace=('numberOfEventIndicators="0"', 'numberOfEventIndicators="1"')))
    )
    assert problems(checks) == []
    assert "state events" in found(checks, "as Model Exchange").text


@EITHER_VERSION
@pytest.mark.parametrize("feature", WITHOUT_FAULT)
def test_what_is_no_fault_is_no_problem(spring, version, feature):
    checks = list(validate(spring(version, feature)))
    assert problems(checks) == []
    assert found(checks, "short run", ME).outcome is Outcome.PASSED
    skipped = [check.text for check in checks if check.outcome is Outcome.SKIPPED]
    events = "the FMU has time events, which are only handled at the end of a step"
    assert skipped == ([events] if feature == "WITH_TIME_EVENTS" else [])


@EITHER_VERSION
def test_an_event_that_does_not_settle_is_a_problem_of_every_model_exchange_check(spring, version):
    checks = list(validate(spring(version, "FAULT_UNSETTLED")))
    text = "the event at t = 0 s does not settle within 1000 iterations"
    assert all(check.text.startswith(text) for check in checks if check.kind == ME)
    assert found(checks, "short run", CS).outcome is Outcome.PASSED


def test_where_nothing_is_declared_no_dependency_is_missing(spring):
    checks = list(validate(spring(2, "FAULT_DEPENDENCY", replace=(' dependencies="1 5"', ""))))
    assert problems(checks) == []


@EITHER_VERSION
def test_what_fmpy_finds_is_told_beside_the_dynamic_checks(spring, version):
    checks = list(validate(spring(version, replace=(' start="4"', ""))))
    (wrong,) = problems(checks)
    assert wrong.name == "static"
    assert 'Variable "k"' in wrong.text
    assert "no start value" in wrong.text
    assert found(checks, "short run", CS).outcome is Outcome.PASSED


@VERSIONS
def test_without_a_binary_for_this_platform_it_ends_after_the_static_checks(spring, version):
    fmu = spring(version, platform="amiga-m68k")
    checks = validate(fmu)
    assert next(checks).outcome is Outcome.PASSED
    with pytest.raises(FmuError, match=r"no binary for this platform, .*; it has binaries for amiga-m68k"):
        next(checks)
    done = subprocess.run(
        [sys.executable, "-m", "bench.cli", "fmu", "validate", str(fmu)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1


def test_the_platform_folder_of_fmi_3_counts_in_fmi_2_too(spring):
    checks = list(validate(spring(2, platform=fmpy.platform_tuple)))
    assert problems(checks) == []
    assert found(checks, "short run", CS).outcome is Outcome.PASSED


@VERSIONS
def test_a_binary_that_lacks_functions_is_a_bad_file(spring, version):
    message = rf"Spring.fmu: its binary for Model Exchange lacks functions of the standard: fmi{version}Reset$"
    with pytest.raises(FmuError, match=message):
        list(validate(spring(version, "FAULT_INCOMPLETE")))


def with_binary(fmu: Path, target: Path, change: Callable[[bytes], bytes]) -> Path:
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(target, "w") as file:
        for name in source.namelist():
            content = source.read(name)
            file.writestr(name, change(content) if name.startswith("binaries/") else content)
    return target


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.6, 0.9])
def test_a_binary_that_is_cut_off_is_a_bad_file_and_no_crash(fmu_path, tmp_path, share):
    path = with_binary(fmu_path, tmp_path / "cut.fmu", lambda content: content[: int(len(content) * share)])
    with pytest.raises(FmuError, match=r"cut.fmu: its binary for Model Exchange cannot be loaded: ") as caught:
        list(validate(path))
    assert "\n" not in str(caught.value)


def test_a_binary_that_is_no_library_is_a_bad_file(fmu_path, tmp_path):
    path = with_binary(fmu_path, tmp_path / "text.fmu", lambda _: b"#!/bin/sh\n" * 100)
    with pytest.raises(FmuError, match=r"cannot be loaded: binaries/.*invalid ELF header"):
        list(validate(path))


def test_a_binary_of_another_name_is_a_bad_file(spring):
    fmu = spring(2, replace=('modelIdentifier="Spring"', 'modelIdentifier="Other"'))
    with pytest.raises(FmuError, match="has no binary for Model Exchange"):
        list(validate(fmu))


def command(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "bench.cli", "fmu", *arguments], capture_output=True, text=True, check=False, cwd=cwd
    )


def test_the_command_tells_each_check_in_a_line_and_ends_with_the_result(spring, tmp_path):
    sound = command("validate", str(spring(3)), cwd=tmp_path)
    assert (sound.returncode, sound.stderr) == (0, "")
    *lines, last = sound.stdout.splitlines()
    assert len(lines) == 17
    assert all(line.startswith("passed   ") and line == line.rstrip() for line in lines)
    assert last.endswith("no problems found (17 checks passed, 0 skipped)")

    faulty = command("validate", str(spring(2, "FAULT_CRASH")), cwd=tmp_path)
    assert (faulty.returncode, faulty.stderr) == (1, "")
    assert "problem  CS  short run                 crashes with SIGSEGV" in faulty.stdout
    assert faulty.stdout.splitlines()[-1].endswith("1 problem found (8 checks passed, 6 skipped)")

    shutil.copy(spring(2, "FAULT_INCOMPLETE"), tmp_path / "bad.fmu")
    bad = command("validate", "bad.fmu", cwd=tmp_path)
    assert (bad.returncode, bad.stdout) == (2, "")
    assert bad.stderr.count("\n") == 1
    assert bad.stderr.startswith("platoon: bad.fmu: its binary")
