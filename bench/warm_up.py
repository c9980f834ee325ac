"""Compiles the controllers' hot loops into numba's cache, so that no ECU compiles in its first cycles.

`make setup` calls it. What is compiled is found by running it: two tenths of a second of the paper's formation.
"""

import tempfile
from pathlib import Path

from bench.bus.address import Address
from bench.conductor.run import run
from bench.scenario import load


def main() -> None:
    """Run the first cycles of a formation in this process and throw the log away."""
    with tempfile.TemporaryDirectory(prefix="platoon-") as folder:
        run(
            load("formation", ["duration_s=0.2"]),
            address=Address.parse("direct"),
            out=Path(folder) / "warm-up.mcap",
            command_line=["bench.warm_up"],
        )


if __name__ == "__main__":
    main()
