"""Prints the tables of all parts or of one: `python -m bench.benchmarks [loop|bus|campaign|fmu|live|record|rmpc ...]`.

`against REV` compares this checkout with another revision; `comfort` runs hundreds of random scenarios.
"""

import argparse
import sys
from collections.abc import Callable, Iterator

from rich.console import Console  # noqa: TID251 - prints figures of our own
from rich.table import Table

from bench.benchmarks import bus, campaign, fmu, live, loop, record
from bench.benchmarks.against import command as against
from bench.benchmarks.comfort import command as comfort
from bench.benchmarks.rmpc import command as rmpc
from bench.benchmarks.rmpc import worst
from bench.errors import BenchError

PARTS: dict[str, Callable[[], Iterator[Table | str]]] = {
    "loop": loop.tables,
    "bus": bus.tables,
    "campaign": campaign.tables,
    "fmu": fmu.tables,
    "live": live.tables,
    "record": record.tables,
    "rmpc": rmpc.tables,
    "worst": worst.tables,
}


def main() -> None:
    """Run the requested part, or all."""
    parser = argparse.ArgumentParser(prog="python -m bench.benchmarks", description=__doc__)
    parts = parser.add_subparsers(
        dest="part", metavar="PART", help=f"the only part to run: {', '.join(PARTS)}, against, comfort"
    )
    described = {name: parts.add_parser(name) for name in PARTS}
    rmpc.add_arguments(described["rmpc"])
    described["worst"].add_argument("--runs", type=int, default=worst.RUNS, metavar="N", help="default %(default)s")
    campaign.add_arguments(described["campaign"])
    against.add_arguments(parts.add_parser("against", help="compare this checkout with another revision"))
    comfort.add_arguments(
        parts.add_parser("comfort", help="random scenarios, and the price of comfort; takes half an hour")
    )
    options = parser.parse_args()
    console = Console(width=120)
    try:
        for table in _tables(options):
            console.print(table)
    except BenchError as error:
        sys.exit(_told(error))
    except KeyboardInterrupt:
        sys.exit(130)


def _tables(options: argparse.Namespace) -> Iterator[Table | str]:
    if options.part == "against":
        yield from against.compare(options)
        return
    if options.part == "comfort":
        yield from comfort.measured(options)
        return
    if options.part == "rmpc":
        yield from rmpc.measured(options)
        return
    if options.part == "campaign":
        yield from campaign.measured(options)
        return
    if options.part == "worst":
        yield worst.worst_sheet(options.runs).table()
        return
    for name, tables in PARTS.items():
        if options.part in (None, name):
            yield from tables()


def _told(error: BenchError) -> int:
    sys.stderr.write(f"bench.benchmarks: {error}\n")
    return error.exit_code


if __name__ == "__main__":
    main()
