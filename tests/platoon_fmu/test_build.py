"""Building: the same bytes twice, nothing done twice, clear words where it cannot be done."""

from __future__ import annotations

import importlib.metadata
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest
from fmpy.build import build_platform_binary
from fmpy.validation import validate_fmu
from lxml import etree

from platoon_fmu import build as builder
from platoon_fmu import interface
from platoon_fmu.build import Step
from platoon_fmu.compilers import this_platform
from platoon_fmu.errors import FmuError, UnknownPlatform
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.versions import FMI2, FMI3, Version

SCHEMAS = Path(fmpy.__file__).parent / "schema" / "fmi3"
VERSIONS = [pytest.param(version, id=f"fmi{version.name}") for version in (FMI2, FMI3)]
CORE = ("checks.c", "derivatives.c", "exchange.c", "instance.c", "solver.c", "states.c", "steps.c", "values.c")
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror")


@pytest.fixture(scope="module", params=VERSIONS)
def built(request, tmp_path_factory) -> tuple[Version, Path]:
    """An FMU of each version, natively built, with its version."""
    return request.param, builder.build(tmp_path_factory.mktemp("built"), version=request.param)


def members(fmu: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_two_builds_give_the_same_bytes(built, tmp_path):
    version, fmu = built
    assert builder.build(tmp_path / "deep" / "er", version=version).read_bytes() == fmu.read_bytes()


def test_builds_once_and_again_when_the_fmu_was_touched(tmp_path):
    steps: list[Step] = []

    def build() -> Path:
        return builder.build(tmp_path, on_step=steps.append)

    fmu = build()
    first = steps.copy()
    bytes_before = fmu.read_bytes()
    build()
    assert steps == first
    fmu.write_bytes(bytes_before[:-100])
    build()
    assert steps == first * 2
    assert fmu.read_bytes() == bytes_before
    (tmp_path / "Vehicle.fmu.json").write_text("{")
    build()
    assert steps == first * 3
    assert sorted(p.name for p in tmp_path.iterdir()) == ["Vehicle.fmu", "Vehicle.fmu.json"]


def test_the_steps_count_up_and_name_the_platform(tmp_path):
    steps: list[Step] = []
    builder.build(tmp_path, on_step=steps.append)
    assert [(step.done, step.total) for step in steps] == [(0, 2), (1, 2)]
    assert steps[1].text == f"Vehicle.fmu: compiling for {this_platform().name}"


def test_the_versions_lie_beside_each_other_and_share_what_is_generated(tmp_path):
    fmi2, fmi3 = (members(builder.build(tmp_path, version=version)) for version in (FMI2, FMI3))
    assert {p.name for p in tmp_path.glob("*.fmu")} == {"Vehicle.fmu", "Vehicle_FMI3.fmu"}
    for name in ("sources/equations.c", "documentation/index.html"):
        assert fmi2[name] == fmi3[name]
    assert "sources/fmi3.c" not in fmi2
    assert "sources/fmi2.c" not in fmi3


def test_finding_the_fmu_current_imports_nothing_heavy(fmu_path):
    code = (
        "import sys; from pathlib import Path; from platoon_fmu.build import build;"
        "build(Path(sys.argv[1]), on_step=lambda step: sys.exit(step.text));"
        "print([m for m in ('casadi', 'numpy', 'fmpy', 'ziglang') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(fmu_path.parent)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_the_fingerprint_covers_all_modules_that_build(tmp_path):
    code = (
        "import sys; from pathlib import Path; from platoon_fmu.build import build, _MODULES; build(Path(sys.argv[1]));"
        "print({m for m in sys.modules if m.startswith('platoon_fmu.')} ^ {f'platoon_fmu.{m}' for m in _MODULES})"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip() == "set()"


def test_a_changed_source_is_a_reason_to_build(tmp_path):
    package = tmp_path / "platoon_fmu"
    shutil.copytree(Path(builder.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from pathlib import Path; import platoon_fmu.build as builder;"
        "assert Path(builder.__file__).is_relative_to(sys.argv[1]);"
        "builder.build(Path(sys.argv[1]) / 'out', on_step=lambda step: sys.exit(7))"
    )

    def builds() -> bool:
        """Whether a build would start; it is stopped before it does anything."""
        command = [sys.executable, "-P", "-c", code, str(tmp_path)]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode in (0, 7), done.stderr
        return done.returncode == 7

    builder.build(tmp_path / "out")
    assert not builds()
    for touched in ("vehicle.py", "documentation.html", "icon.png", "fmi/values.c", "fmi/core.h", "fmi/fmi2.c"):
        content = (package / touched).read_bytes()
        (package / touched).write_bytes(content + b"\n")
        assert builds(), touched
        (package / touched).write_bytes(content)
    (package / "fmi/fmi3.c").write_bytes(b"")
    assert not builds()


def test_no_compiler_is_a_clear_error(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FmuError, match="no C compiler"):
        builder.build(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_missing_zig_is_a_clear_error(tmp_path):
    # An interpreter that finds all installed packages but ziglang, which it has to go without.
    code = (
        "import sys; sys.modules['ziglang'] = None\n"
        "from pathlib import Path; from platoon_fmu.build import build; from platoon_fmu.errors import FmuError\n"
        "try: build(Path(sys.argv[1]), platforms=['aarch64-linux'])\n"
        "except FmuError as error: print(error)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "out")]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "aarch64-linux" in said
    assert "pip install ziglang" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("platforms", "said"), [(["vax"], "'vax'.*allowed: native, x86_64-linux"), ([], "allowed")])
def test_unknown_platforms_are_refused(tmp_path, platforms, said):
    with pytest.raises(UnknownPlatform, match=said):
        builder.build(tmp_path / "out", platforms=platforms)
    assert not (tmp_path / "out").exists()


def test_a_failing_compiler_is_a_clear_error_and_leaves_nothing(tmp_path, monkeypatch):
    compiler = tmp_path / "cc"
    compiler.write_text('#!/bin/sh\n[ "$1" = --version ] && exit 0\necho "broken pipe dream" >&2\nexit 3\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    with pytest.raises(FmuError, match="status 3:\nbroken pipe dream"):
        builder.build(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_checkout_without_its_fmu_says_how_to_build_it(tmp_path, monkeypatch):
    (tmp_path / "pyproject.toml").touch()
    monkeypatch.setattr(builder, "_PROJECT", tmp_path)
    with pytest.raises(FmuError, match="platoon fmu build"):
        builder.default_fmu()
    fmu = builder.build(builder.default_directory())
    assert builder.default_fmu() == fmu == tmp_path / "build" / "Vehicle.fmu"


def test_an_installed_package_builds_its_fmu_once_in_the_users_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(builder, "_PROJECT", tmp_path / "site-packages")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    steps = []
    fmu = builder.default_fmu(steps.append)
    assert [step.text for step in steps]
    assert fmu.is_relative_to(tmp_path / "cache" / "platoon")
    assert fmu.parent.name.startswith(f"{importlib.metadata.version('platoon')}-")
    assert validate_fmu(str(fmu)) == []
    steps.clear()
    assert builder.default_fmu(steps.append) == fmu
    assert steps == []


def test_other_sources_have_another_place_in_the_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(builder, "_PROJECT", tmp_path / "site-packages")
    package = tmp_path / "platoon_fmu"
    shutil.copytree(builder._PACKAGE, package)
    monkeypatch.setattr(builder, "_PACKAGE", package)
    before = builder.default_directory()
    with (package / "fmi" / "values.c").open("a") as source:
        source.write("/* changed */")
    assert builder.default_directory() != before


def test_an_installed_package_tells_what_its_fmu_lacks_to_be_built(tmp_path, monkeypatch):
    monkeypatch.setattr(builder, "_PROJECT", tmp_path / "site-packages")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with monkeypatch.context() as patched:
        patched.setenv("PATH", str(tmp_path))
        with pytest.raises(FmuError, match="no C compiler found"):
            builder.default_fmu()
    (tmp_path / "cache").write_text("a file where the cache should be")
    with pytest.raises(FmuError, match=r"cache.*XDG_CACHE_HOME"):
        builder.default_fmu()


def test_the_fmu_is_valid_and_for_this_platform(built):
    version, fmu = built
    assert validate_fmu(str(fmu)) == []
    assert fmpy.platform in fmpy.supported_platforms(str(fmu))
    (folder,) = version.folders_of(this_platform().name)
    assert f"binaries/{folder}/Vehicle{this_platform().suffix}" in members(fmu)


def test_the_fmu_holds_the_sources_it_names(built):
    version, fmu = built
    description = fmpy.read_model_description(str(fmu))
    names = members(fmu)
    (configuration,) = description.buildConfigurations
    (sources,) = configuration.sourceFileSets
    assert configuration.modelIdentifier == "Vehicle"
    assert set(sources.sourceFiles) == {*CORE, "equations.c", "vehicle.c", version.face}
    assert {f"sources/{name}" for name in sources.sourceFiles} <= set(names)
    assert {f"sources/{name}" for name in version.headers} <= set(names)
    build_description = ET.fromstring(names["sources/buildDescription.xml"])
    assert [file.get("name") for file in build_description.iter("SourceFile")] == sources.sourceFiles
    assert next(build_description.iter("SourceFileSet")).get("language") == "C99"


@pytest.mark.parametrize(
    ("member", "schema"),
    [
        ("sources/buildDescription.xml", "fmi3BuildDescription.xsd"),
        ("terminalsAndIcons/terminalsAndIcons.xml", "fmi3TerminalsAndIcons.xsd"),
    ],
)
def test_descriptions_follow_their_schema(built, member, schema):
    _, fmu = built
    validator = etree.XMLSchema(file=str(SCHEMAS / schema))
    validator.assertValid(etree.fromstring(members(fmu)[member]))


def test_the_fmu_has_an_icon(built):
    version, fmu = built
    files = members(fmu)
    png = files["terminalsAndIcons/icon.png"]
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    assert (int.from_bytes(png[16:20], "big"), int.from_bytes(png[20:24], "big")) == (128, 128)
    assert ET.fromstring(files["terminalsAndIcons/icon.svg"]).get("viewBox") == "0 0 128 128"
    assert (files.get("model.png") == png) == (version is FMI2)


def simulate(folder: Path) -> np.ndarray:
    """The car driven by a changing steering angle and torque from an unzipped FMU; all outputs over time."""
    time = np.arange(0, 3, 0.01)
    signals = {"steering_angle": 0.05 * np.sin(3 * time), "wheel_torque_rl": 200 * np.cos(time)}
    columns = [("time", np.double), *((name, np.double) for name in signals)]
    result = fmpy.simulate_fmu(
        str(folder),
        start_values={"v_x_start": 20.0},
        input=np.array(list(zip(time, *signals.values(), strict=True)), dtype=columns),
        output=[v.name for v in (*interface.STATES, *interface.OUTPUTS)],
        fmi_type="CoSimulation",
        stop_time=3.0,
        output_interval=0.01,
    )
    return np.array(result.tolist())


def test_fmpys_own_build_of_the_sources_gives_the_same_values(built, tmp_path, monkeypatch):
    version, fmu = built
    # cmake, which fmpy calls by its name, is a package of its own and lies beside the interpreter.
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=":")
    fmpy.extract(str(fmu), unzipdir=str(tmp_path))
    shipped = simulate(tmp_path)
    library = tmp_path / "binaries" / version.folders_of(this_platform().name)[0] / f"Vehicle{this_platform().suffix}"
    library.unlink()
    build_platform_binary(tmp_path)
    assert library.is_file()
    own = simulate(tmp_path)
    assert np.ptp(own[:, 1]) > 50
    np.testing.assert_array_equal(own, shipped)


def test_the_hand_written_code_compiles_without_warnings(built, tmp_path):
    version, fmu = built
    for name, content in members(fmu).items():
        if name.startswith("sources/"):
            (tmp_path / Path(name).name).write_bytes(content)
    for name in (*CORE, "vehicle.c", version.face):
        command = ["cc", "-std=c99", *WARNINGS, "-fsyntax-only", name]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")


def test_the_variables_are_the_interface(fmu_path):
    description = fmpy.read_model_description(str(fmu_path))
    found = [(v.name, v.causality, v.variability, v.unit or "") for v in description.modelVariables]
    assert found == [(v.name, v.causality, v.variability, v.unit) for v in interface.VARIABLES]
    assert [v.valueReference for v in description.modelVariables] == list(range(len(found)))
    starts = {v.name: float(v.start) for v in description.modelVariables if v.start is not None}
    assert starts["M"] == VehicleParameters().M
    assert starts["mu"] == VehicleParameters().mu_a
