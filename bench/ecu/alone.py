"""A stand-alone ECU before the start of a run: it sends a sign of life."""

import selectors
import time
from collections.abc import Mapping

from bench.bus.codec import Codec
from bench.bus.link.base import Link
from bench.bus.network import EcuSlot
from bench.bus.states import EcuState
from bench.ecu.runtime import EcuNode
from bench.names import vehicle_bus

SIGN_PERIOD_S = 0.1
"""Wall-clock time in s between two signs of life, as in the DBC."""


def await_bench(node: EcuNode, slot: EcuSlot, links: Mapping[str, Link], codecs: Mapping[str, Codec]) -> None:
    """Wait for the first BenchSync without a time limit, sending the status with State Wait until then.

    No ECU has a status as an input, so this does not affect the others.

    Raises:
        RunFailed: a bus went down.
    """
    bus, status = vehicle_bus(slot.vehicle), slot.message("Status")
    values = codecs[bus].start_values(status) | {"State": EcuState.WAIT}
    can_id, data = codecs[bus].encode(status, values)
    next_sign = time.monotonic()
    with selectors.DefaultSelector() as selector:
        for link in links.values():
            selector.register(link.fileno(), selectors.EVENT_READ)
        while not node.begun:
            now = time.monotonic()
            if now >= next_sign:
                links[bus].send(can_id, data)
                next_sign = now + SIGN_PERIOD_S
            if selector.select(next_sign - now):
                node.poll()
