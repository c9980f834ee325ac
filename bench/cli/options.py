"""Options and defaults that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

LOGS = Path("logs")
"""Where runs land if not told otherwise, in the working directory."""

EXIT_CODES = (
    "Exit codes: 0 done, 1 the run failed, formed no platoon, had vehicles nearer than 4 m or commands that are not "
    "numbers, 2 bad input."
)

Log = Annotated[Path, typer.Argument(metavar="RUN.mcap", help="The log of a run.")]
ScenarioName = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="A shipped scenario, random:SEED, random-fault:SEED, or a TOML file.")
]
Buses = Annotated[
    list[str] | None,
    typer.Option(
        "--can",
        metavar="[BUS=]udp|vcan|direct|IFACE:CHANNEL",
        help="Where the CAN buses are, or with BUS= one of them: udp (multicast on this host; udp:PORT for "
        "fixed ports; udp:PORT@DEVICE to reach other hosts), vcan (SocketCAN vcan0, vcan1 ...), direct (all in one "
        "process), or any python-can interface. udp if not given.",
        show_default=False,
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a key of the scenario: --set vehicles.0.x_m=5.0"),
]
Seed = Annotated[int | None, typer.Option(help="Override the scenario's seed.")]
LiveOrigins = Annotated[
    list[str] | None,
    typer.Option(
        "--live-origin",
        metavar="URL",
        help="Another web page that may connect as Foxglove does, such as a Lichtblick of your own: "
        "http://localhost:8080; may be repeated. Foxglove's and the desktop applications may.",
        show_default=False,
    ),
]


def report_path(log: Path) -> Path:
    """Return where the report of a log is written unless told otherwise."""
    return log.with_suffix(".html")
