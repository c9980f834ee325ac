"""Compiles the controllers' hot loops into numba's cache, so that no ECU compiles in its first cycles.

`make setup` calls it; an installed package does so before its first run. It runs two tenths of a second of the paper's
formation, which compiles everything a run needs.
"""

import hashlib
import json
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from importlib import metadata
from pathlib import Path

from platoon_fmu.interpreter import python

_CONTROL = Path(__file__).parents[1] / "control"


def main() -> None:
    """Run the first cycles of a formation in this process and discard the log."""
    from bench.bus.link.address import Address
    from bench.conductor.options import RunOptions
    from bench.conductor.run import run
    from bench.scenario import load

    with tempfile.TemporaryDirectory(prefix="platoon-") as folder:
        run(
            RunOptions(
                load("formation", ["duration_s=0.2"]),
                address=Address.parse("direct"),
                out=Path(folder) / "warm-up.mcap",
                command_line=["bench.cli.warm_up"],
            )
        )


def warm_up_once(folder: Path, say: Callable[[str], None]) -> None:
    """Compile the hot loops in a separate process, unless a marker in `folder` shows that this has been done.

    If that fails, or the marker cannot be written, the following run compiles, or fails with the reason.

    Args:
        folder: where the marker is.
        say: called with what is being done.
    """
    mark = folder / f"compiled-{_key()}"
    if mark.exists():
        return
    say("compiling the controllers (about half a minute)")
    with python("bench.cli.warm_up", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        code = process.wait()
    if code == 0:
        with suppress(OSError):
            mark.touch()


def _key() -> str:
    """A hash of what numba keeps compiled code by: its version, the processor, each file's place, size and time."""
    files = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in sorted(_CONTROL.glob("*.py"))]
    facts = (metadata.version("numba"), sys.version, platform.machine(), platform.node(), files)
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:16]


if __name__ == "__main__":
    main()
