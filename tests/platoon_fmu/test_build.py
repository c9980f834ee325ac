"""Building: the same bytes twice, nothing done twice, clear words where it cannot be done."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import pytest

from platoon_fmu import build as builder
from platoon_fmu import interface
from platoon_fmu.errors import FmuError
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.validate import validate


def test_two_builds_give_the_same_bytes(fmu_path, tmp_path):
    assert builder.build(tmp_path / "deep" / "er").read_bytes() == fmu_path.read_bytes()


def test_builds_once_and_again_when_the_fmu_was_touched(tmp_path):
    started: list[bool] = []

    def build() -> Path:
        return builder.build(tmp_path, on_start=lambda: started.append(True))

    fmu = build()
    bytes_before = fmu.read_bytes()
    build()
    assert len(started) == 1
    fmu.write_bytes(bytes_before[:-100])
    build()
    assert len(started) == 2
    assert fmu.read_bytes() == bytes_before
    (tmp_path / "Vehicle.fmu.json").write_text("{")
    build()
    assert len(started) == 3
    assert sorted(p.name for p in tmp_path.iterdir()) == ["Vehicle.fmu", "Vehicle.fmu.json"]


def test_finding_the_fmu_current_imports_nothing_heavy(fmu_path):
    code = (
        "import sys; from pathlib import Path; from platoon_fmu.build import build;"
        "build(Path(sys.argv[1]), on_start=lambda: sys.exit('built'));"
        "print([m for m in ('casadi', 'numpy', 'fmpy') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(fmu_path.parent)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_no_compiler_is_a_clear_error(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FmuError, match="no C compiler"):
        builder.build(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_failing_compiler_is_a_clear_error_and_leaves_nothing(tmp_path, monkeypatch):
    compiler = tmp_path / "cc"
    compiler.write_text('#!/bin/sh\n[ "$1" = --version ] && exit 0\necho "broken pipe dream" >&2\nexit 3\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    with pytest.raises(FmuError, match="status 3:\nbroken pipe dream"):
        builder.build(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_default_fmu_says_how_to_build_it(tmp_path, monkeypatch):
    monkeypatch.setattr(builder, "_PROJECT", tmp_path)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FmuError, match="platoon fmu build"):
        builder.default_fmu()
    fmu = builder.build(builder.default_directory())
    assert builder.default_fmu() == fmu == tmp_path / "build" / "Vehicle.fmu"


def test_the_fmu_holds_the_sources_it_names(fmu_path):
    description = fmpy.read_model_description(str(fmu_path))
    names = zipfile.ZipFile(fmu_path).namelist()
    (configuration,) = description.buildConfigurations
    (sources,) = configuration.sourceFileSets
    assert set(sources.sourceFiles) >= {"core.c", "equations.c"}
    assert {f"sources/{name}" for name in sources.sourceFiles} <= set(names)
    assert "sources/fmi2Functions.h" in names


def test_the_variables_are_the_interface(fmu_path):
    description = fmpy.read_model_description(str(fmu_path))
    found = [(v.name, v.causality, v.variability, v.unit) for v in description.modelVariables]
    assert found == [(v.name, v.causality, v.variability, v.unit) for v in interface.VARIABLES]
    assert [v.valueReference for v in description.modelVariables] == list(range(len(found)))
    starts = {v.name: float(v.start) for v in description.modelVariables if v.start is not None}
    assert starts["M"] == VehicleParameters().M
    assert starts["mu"] == VehicleParameters().mu_a


@pytest.mark.parametrize(
    ("content", "said"),
    [(None, "no such file"), (b"no zip", "not a zip"), (b"PK\x03\x04" + bytes(40), "not a zip")],
)
def test_files_that_are_no_fmu_are_refused(tmp_path, content, said):
    path = tmp_path / "a.fmu"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FmuError, match=said):
        validate(path)


def test_a_zip_without_a_model_description_is_refused(tmp_path):
    path = tmp_path / "a.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme", "nothing here")
    with pytest.raises(FmuError, match="no modelDescription"):
        validate(path)


def test_a_broken_binary_is_a_problem_not_a_crash(fmu_path, tmp_path):
    path = tmp_path / "a.fmu"
    with zipfile.ZipFile(fmu_path) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            target.writestr(name, content[:500] if name.startswith("binaries/") else content)
    assert any("failed" in problem for problem in validate(path))
