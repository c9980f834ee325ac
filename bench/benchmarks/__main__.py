"""Prints the tables: `python -m bench.benchmarks [loop | bus | fmu | live | record]`, all if none is named."""

import argparse
from collections.abc import Callable, Iterator

from rich.console import Console  # noqa: TID251 - prints figures of our own
from rich.table import Table

from bench.benchmarks import bus, fmu, live, loop, record

PARTS: dict[str, Callable[[], Iterator[Table | str]]] = {
    "loop": loop.tables,
    "bus": bus.tables,
    "fmu": fmu.tables,
    "live": live.tables,
    "record": record.tables,
}


def main() -> None:
    """Run the requested part, or all."""
    parser = argparse.ArgumentParser(prog="python -m bench.benchmarks", description=__doc__)
    parser.add_argument("part", nargs="?", choices=tuple(PARTS), help="the only part to run")
    chosen = parser.parse_args().part
    console = Console(width=120)
    for name, tables in PARTS.items():
        if chosen in (None, name):
            for table in tables():
                console.print(table)


if __name__ == "__main__":
    main()
