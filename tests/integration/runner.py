"""Runs a scenario as `platoon run` does, in a process that the tests may kill: its argument is JSON."""

import json
import resource
import sys
from pathlib import Path

from bench.bus.link.address import Address
from bench.conductor.fork_server_process import fork_server
from bench.errors import BenchError
from bench.scenario import load


def main() -> int:
    given = json.loads(sys.argv[1])
    if given["file_limit"]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (given["file_limit"], given["file_limit"]))
    try:
        scenario, address = load("formation", given["set"]), Address.parse(given["can"])
        server = None if address.hub is not None else fork_server(())
        # As the command does: what the plant needs is imported after that.
        from bench.conductor import run
        from bench.conductor.options import RunOptions

        run.READY_S = given["ready_s"]
        result = run.run(
            RunOptions(
                scenario,
                address=address,
                out=Path(given["out"]),
                command_line=sys.argv,
                on_progress=lambda t: print(f"at {t:.2f}", flush=True),  # noqa: T201 - the tests wait for it
                ecus=given["ecus"],
                without=given["without"],
                without_wait_s=given["without_wait_s"],
                on_waiting=lambda line: print(line, flush=True),  # noqa: T201 - the tests wait for it,
                silence_s=given["silence_s"],
                realtime=given["realtime"],
                fork_server=server,
            )
        )
    except BenchError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    sys.stdout.write(f"cycles {result.cycles}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
