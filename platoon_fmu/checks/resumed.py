"""Continues from an FMU's serialised state in another process; its arguments are HEADER and SECONDS.

HEADER is JSON with the folder of the unpacked FMU, the kind and the time of the state; SECONDS is the time limit; the
state is read from standard input. The values after each step are written to standard output as JSON.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from platoon_fmu.checks.isolation import end_after
from platoon_fmu.checks.trial import experiment, observed, run
from platoon_fmu.importer import Instance, Kind, OpenFmu


def main() -> None:
    """Continues the run; exits with status 1 and a line on standard error if the FMU refuses."""
    header = json.loads(sys.argv[1])
    end_after(float(sys.argv[2]))
    # Keeps the binary's output out of standard output.
    answer = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    fmu, kind = OpenFmu.unpacked(Path(header["folder"])), Kind(header["kind"])
    try:
        with Instance(fmu, kind) as instance:
            instance.deserialise(sys.stdin.buffer.read(), header["time"])
            snapshots = run(instance, observed(fmu, kind), experiment(fmu).step)
    except Exception as error:  # noqa: BLE001 - the caller reports any error of the FMU
        sys.exit(str(error))
    with answer:
        json.dump(snapshots, answer)
