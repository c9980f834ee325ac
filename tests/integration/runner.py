"""Runs a scenario as `platoon run` does, in a process that the tests may kill: its argument is JSON."""

import json
import resource
import sys
from pathlib import Path

import bench.conductor.run
from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.errors import BenchError
from bench.scenario import load


def main() -> int:
    given = json.loads(sys.argv[1])
    if given["file_limit"]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (given["file_limit"], given["file_limit"]))
    bench.conductor.run.READY_S = given["ready_s"]
    try:
        result = run(
            RunOptions(
                load("formation", given["set"]),
                address=Address.parse(given["can"]),
                out=Path(given["out"]),
                command_line=sys.argv,
                on_progress=lambda t: print(f"at {t:.2f}", flush=True),  # noqa: T201 - the tests wait for it
                ecus=given["ecus"],
                without=given["without"],
                without_wait_s=given["without_wait_s"],
                on_waiting=lambda line: print(line, flush=True),  # noqa: T201 - the tests wait for it,
                silence_s=given["silence_s"],
                realtime=given["realtime"],
            )
        )
    except BenchError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    sys.stdout.write(f"cycles {result.cycles}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
