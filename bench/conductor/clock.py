"""The wall clock of a real-time run, a separate process: BenchSync on all buses every 10 ms, whatever the others do.

Every cycle has an absolute deadline, the start of the run plus its number times 10 ms, so a late BenchSync delays no
other and nothing drifts.
"""

import select
import time
from collections.abc import Mapping
from contextlib import ExitStack

from bench.bus.codec import Codec, load_codecs
from bench.bus.control_channel import ControlChannel
from bench.bus.frame import CanFrame
from bench.bus.link.address import Address
from bench.bus.link.base import Link
from bench.bus.link.opening import open_link
from bench.bus.states import BenchCommand
from bench.bus.sync import BENCH_SYNC, read_sync
from bench.conductor.linux import set_real_time, wait_until
from bench.cycle import CYCLE_NS, time_of
from bench.faults.plan import FaultPlan
from bench.names import V2V

CLOCK = "clock"
"""Name of the process."""


START_NS = 50_000_000
"""Time from being ready to the first cycle, in which the conductor sets the priorities of the others."""

PRIORITY = 80
"""SCHED_FIFO priority of this process, above all others of the bench."""


def serve_clock(channel: ControlChannel, vehicles: int, cycles: int, address: Address) -> None:
    """Send BenchSync of `cycles` cycles, then wait until the conductor stops the run or ends.

    Raises:
        BadInput: a bus cannot be opened.
        RunFailed: a bus went down.
    """
    codecs = load_codecs(vehicles)
    plan = FaultPlan(board=channel.fault_board())
    with ExitStack() as stack:
        links = {bus: stack.enter_context(open_link(bus, address)) for bus in codecs}
        # The conductor sends STOP on all buses.
        sync_id = codecs[V2V].can_id(BENCH_SYNC)
        for link in links.values():
            link.select([sync_id] if link is links[V2V] else [])
        set_real_time(0, PRIORITY)
        channel.ready(CLOCK, ())
        start = time.monotonic_ns() + START_NS
        for cycle in range(cycles):
            frames = _frames(codecs, cycle)
            wait_until(start + cycle * CYCLE_NS)
            plan.open_cycle(cycle, realtime=True)
            for bus, (can_id, data) in frames.items():
                links[bus].send(can_id, data)
            if _told_to_stop(channel.lifeline, links[V2V], codecs[V2V], plan, cycle, 0.0):
                return
        while not _told_to_stop(channel.lifeline, links[V2V], codecs[V2V], plan, cycles - 1, None):
            pass


def _frames(codecs: Mapping[str, Codec], cycle: int) -> dict[str, CanFrame]:
    """Return the BenchSync of a cycle for every bus."""
    values = {"Command": BenchCommand.RUN_REALTIME, "Cycle": cycle, "Time": time_of(cycle)}
    return {bus: codec.encode(BENCH_SYNC, values, cycle) for bus, codec in codecs.items()}


def _told_to_stop(
    lifeline: int, link: Link, codec: Codec, plan: FaultPlan, newest: int, timeout_s: float | None
) -> bool:
    """Whether the conductor has sent STOP after the cycle `newest`, or has ended; any other frame is ignored."""
    sync_id = codec.can_id(BENCH_SYNC)
    readable, _, _ = select.select([lifeline, link.fileno()], [], [], timeout_s)
    syncs = (read_sync(codec.layout(BENCH_SYNC), data) for can_id, data in link.receive() if can_id == sync_id)
    told = any(sync is not None and sync.stops_after(newest, realtime=True) for sync in syncs)
    return lifeline in readable or (told and plan.has_stopped)
