"""The live server's process: its argument is a JSON object (log, address, parent), its standard input the lifeline.

It prints one JSON object, `served` or `refused`, once it listens or cannot. When its standard input ends, the run is
over: viewers get the end, and the process exits. It also exits once the log has ended.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import warnings
from pathlib import Path

from bench.conductor.linux import die_with_parent, give_way, set_name
from bench.errors import BadInput
from bench.live.address import LiveAddress
from bench.live.server import LiveServer
from bench.record.reader import LogDamaged


def main() -> None:
    """Serve a log until it has ended or the parent says so."""
    given = json.loads(sys.argv[1])
    die_with_parent()
    if os.getppid() != given["parent"]:
        return
    # Ctrl-C at a terminal reaches all processes; the parent decides what follows.
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    set_name("live")
    # The page says what is wrong with a log, and here it always lacks its end.
    warnings.simplefilter("ignore", LogDamaged)
    try:
        asyncio.run(_serve(Path(given["log"]), LiveAddress(**given["address"])))
    except BadInput as error:
        sys.exit(str(error))


async def _serve(log: Path, address: LiveAddress) -> None:
    server = LiveServer(log, address)
    try:
        served = await server.start()
    except BadInput as error:
        _report(refused=str(error))
        return
    _report(served=str(served))
    over = asyncio.Event()
    _on_end_of_input(over)
    with give_way():
        await server.follow(over)
    if server.page_wanted:
        try:
            await server.finish()
        except BadInput as error:
            # A run that failed before its first cycle has nothing to show.
            server.say(str(error))
    await server.stop()


def _report(**what: str) -> None:
    sys.stdout.write(f"{json.dumps(what)}\n")
    sys.stdout.flush()


def _on_end_of_input(over: asyncio.Event) -> None:
    loop = asyncio.get_running_loop()

    def read() -> None:
        if not os.read(0, 4096):
            loop.remove_reader(0)
            over.set()

    loop.add_reader(0, read)
