"""Serves a log without running a bench."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable
from pathlib import Path

from bench.live.address import LiveAddress
from bench.live.server import LiveServer


def serve_alone(log: Path, address: LiveAddress, say: Callable[[str], None]) -> None:
    """Serve a log, whole or still being written, until SIGINT or SIGTERM; `say` gets the addresses.

    Raises:
        BadInput: the address cannot be listened on, or the log has nothing to show.
    """
    asyncio.run(_serve(LiveServer(log, address), say))


async def _serve(server: LiveServer, say: Callable[[str], None]) -> None:
    over = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, over.set)
    say(str(await server.start()))
    await server.follow(over)
    if not over.is_set():
        await server.finish()
        await over.wait()
    await server.stop()
