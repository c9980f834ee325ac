"""What `platoon fmu info` tells of an FMU, ours and others, for people and as JSON."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys
import zipfile
from contextlib import suppress
from pathlib import Path

import pytest

from platoon_fmu import interface
from platoon_fmu.info import VariableInfo, info

# Arrays and types that the vehicle has none of.
RICH = """<?xml version="1.0"?>
<fmiModelDescription fmiVersion="3.0" modelName="Rich" instantiationToken="t" generationTool="hand">
  <ScheduledExecution modelIdentifier="Rich" canGetAndSetFMUState="true"/>
  <UnitDefinitions><Unit name="K"><BaseUnit K="1"/><DisplayUnit name="degC" offset="-273.15"/></Unit></UnitDefinitions>
  <TypeDefinitions>
    <Float64Type name="Temperature" unit="K" displayUnit="degC" min="0" nominal="300"/>
    <EnumerationType name="Mode"><Item name="off" value="1"/><Item name="on" value="2"/></EnumerationType>
  </TypeDefinitions>
  <ModelVariables>
    <UInt64 name="n" valueReference="1" causality="structuralParameter" variability="fixed" start="3"/>
    <Float64 name="T" valueReference="2" causality="input" declaredType="Temperature" start="293.15"/>
    <Float64 name="A" valueReference="3" causality="parameter" start="1 2.5 3"><Dimension valueReference="1"/></Float64>
    <Int32 name="i" valueReference="4" causality="parameter" start="-7" min="-9" max="9"/>
    <Boolean name="b" valueReference="5" causality="parameter" start="true"/>
    <String name="s" valueReference="6" causality="parameter"><Start value="some text"/></String>
    <Enumeration name="m" valueReference="7" causality="parameter" declaredType="Mode" start="2"/>
    <Float32 name="y" valueReference="8" causality="output" description="[bold]a line[/bold]"/>
    <Clock name="c" valueReference="9" causality="input" intervalVariability="triggered"/>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
  </ModelVariables>
  <ModelStructure><Output valueReference="8"/></ModelStructure>
</fmiModelDescription>
"""


@pytest.fixture
def rich_fmu(tmp_path) -> Path:
    path = tmp_path / "Rich.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", RICH)
        archive.writestr("binaries/x86_64-windows/Rich.dll", b"")
    return path


@pytest.fixture(params=["fmu_path", "fmu3_path"])
def vehicle(request) -> Path:
    found: Path = request.getfixturevalue(request.param)
    return found


def by_name(fmu: Path) -> dict[str, VariableInfo]:
    return {variable.name: variable for variable in info(fmu).variables}


def command(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "bench.cli", "fmu", "info", *arguments], capture_output=True, text=True, check=True
    )
    return done.stdout


def on_terminal(*arguments: str, columns: int) -> str:
    """What the command shows on a terminal of some columns, without colours."""
    ours, its = pty.openpty()
    environment = {**os.environ, "COLUMNS": str(columns), "TERM": "xterm"}
    command_line = [sys.executable, "-m", "bench.cli", "fmu", "info", *arguments]
    shown = b""
    with subprocess.Popen(command_line, stdout=its, env=environment):
        os.close(its)
        # Where the other end is closed, a pseudo terminal's end is an error.
        with suppress(OSError):
            while piece := os.read(ours, 4096):
                shown += piece
        os.close(ours)
    return re.sub(r"\x1b\[[0-9;]*m", "", shown.decode())


def test_the_vehicle_is_its_interface(vehicle):
    found = info(vehicle)
    assert len(found.variables) == len(interface.VARIABLES)
    for variable, ours in zip(found.variables, interface.VARIABLES, strict=True):
        assert (variable.name, variable.causality, variable.variability) == (
            ours.name,
            ours.causality,
            ours.variability,
        )
        assert (variable.minimum, variable.maximum, variable.nominal) == (
            (None, None, None) if ours.items else (ours.minimum, ours.maximum, ours.nominal)
        )
        assert (variable.start, variable.unit or "") == (ours.start, ours.unit)
        assert variable.display_unit == ours.display_unit
    assert found.variables[-1].items == {str(i): name for i, (name, _) in enumerate(interface.SOLVER.items, start=1)}


def test_the_head_of_the_vehicle(vehicle):
    found = info(vehicle)
    assert (found.model_name, found.generation_tool) == ("Vehicle", "platoon")
    assert list(found.interface_types) == ["Model Exchange", "Co-Simulation"]
    two = found.fmi_version == "2.0"
    flag = "providesDirectionalDerivative" if two else "providesDirectionalDerivatives"
    assert all(flags[flag] is True for flags in found.interface_types.values())
    assert found.interface_types["Co-Simulation"]["maxOutputDerivativeOrder"] == 1
    assert found.platforms
    assert found.has_sources
    assert found.default_experiment == {"startTime": 0.0, "stopTime": 10.0, "stepSize": 0.01, "tolerance": 1e-6}


def test_the_table_is_whole_where_there_is_no_terminal(vehicle):
    lines = command(str(vehicle)).splitlines()
    assert lines[0].startswith("Vehicle, FMI ")
    assert lines[0].endswith(", Model Exchange and Co-Simulation")
    assert all(line == line.rstrip() and "\x1b" not in line for line in lines)
    for variable in interface.VARIABLES:
        (line,) = [line for line in lines if line.split(maxsplit=1)[:1] == [variable.name]]
        assert line.endswith(variable.description)
    (steering,) = [line for line in lines if line.startswith("steering_angle ")]
    assert steering.split()[:5] == ["steering_angle", "rad", "(deg)", "0", "0.1"]
    assert "15 inputs, continuous" in lines
    (solver,) = [line for line in lines if line.startswith("solver ")]
    assert "Enumeration" in solver
    assert "1 (runge_kutta_4)" in solver


@pytest.mark.parametrize("columns", [40, 80, 200])
def test_no_name_and_no_value_is_cut_on_a_terminal(fmu_path, columns):
    shown = on_terminal(str(fmu_path), columns=columns)
    words = set(shown.split())
    assert {v.name for v in interface.VARIABLES} <= words
    assert {"-1.570796", "52700", "(runge_kutta_4)", "(kN.m/rad)"} <= words
    assert "\u2026" not in shown


def test_json_is_the_same(vehicle):
    found = json.loads(command("--json", str(vehicle)))
    expected = info(vehicle)
    assert found["model_name"] == "Vehicle"
    assert found["platforms"] == list(expected.platforms)
    assert [v["name"] for v in found["variables"]] == [v.name for v in expected.variables]
    assert [v["start"] for v in found["variables"]] == [v.start for v in expected.variables]


def test_any_type_has_its_values(rich_fmu):
    variables = by_name(rich_fmu)
    T = variables["T"]
    assert (T.unit, T.display_unit, T.minimum, T.nominal, T.start) == ("K", "degC", 0.0, 300.0, 293.15)
    assert (variables["A"].shape, variables["A"].start) == ((3,), [1.0, 2.5, 3.0])
    assert (variables["i"].start, variables["i"].minimum, variables["i"].maximum) == (-7, -9, 9)
    assert variables["b"].start is True
    assert variables["s"].start == "some text"
    assert (variables["m"].start, variables["m"].items) == (2, {"1": "off", "2": "on"})
    assert variables["c"].start is None
    assert info(rich_fmu).platforms == ("x86_64-windows",)
    assert not info(rich_fmu).has_sources


def test_any_type_is_in_the_table(rich_fmu):
    lines = {line.split()[0]: line.split() for line in command(str(rich_fmu)).splitlines() if line}
    assert lines["Rich,"] == ["Rich,", "FMI", "3.0,", "Scheduled", "Execution"]
    assert lines["A"][1:5] == ["Float64[3]", "1", "2.5", "3"]
    assert lines["T"][1:5] == ["K", "(degC)", "293.15", "0"]
    assert lines["s"][1:4] == ["String", "some", "text"]
    assert lines["b"][1:3] == ["Boolean", "true"]
    assert lines["m"][1:4] == ["Enumeration", "2", "(on)"]
    assert lines["y"] == ["y", "Float32", "[bold]a", "line[/bold]"]
    assert lines["c"][1] == "Clock"
