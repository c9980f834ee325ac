"""What an ECU process has loaded, as its memory map shows: nothing of the vehicle, the recorder or build tools."""

from pathlib import Path

import pytest

from bench.ecu.loading import DEFAULT_ECUS
from tests.integration.conftest import SIMPLE

# cantools is seen by the library of its bitstruct.
OTHERS = ("casadi", "cvxpy", "Vehicle", "polars", "zstandard", "bitstruct")
SOLVERS = ("scipy", "clarabel")


@pytest.mark.parametrize("ecus", [SIMPLE, dict(DEFAULT_ECUS)], ids=["own", "ours"])
def test_an_ecu_process_maps_only_what_it_needs(start, ecus: dict[str, str]) -> None:
    run = start(ecus=ecus, set=["duration_s=60"])
    run.await_time(0.1)
    processes = run.processes()
    ecu_pids = [pid for name, pid in processes.items() if name.endswith((".planner", ".tracker"))]
    assert len(ecu_pids) == 6
    maps = {pid: Path(f"/proc/{pid}/maps").read_text() for pid in (*ecu_pids, processes["plant"])}
    assert "Vehicle" in maps[processes["plant"]]
    for pid in ecu_pids:
        libraries = {line.split()[-1] for line in maps[pid].splitlines() if ".so" in line}
        assert any("numpy" in library for library in libraries)
        assert not [library for library in libraries for name in (*OTHERS, *SOLVERS) if f"/{name}" in library]
