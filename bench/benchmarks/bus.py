"""The bench's overhead on the bus: coding, the round trip from the plant through an ECU, and recording.

The round trip is measured on the same kind of bus with two processes: a bare echo by python-can, and the bench's node
with an ECU that does nothing. Recording is measured by frame loss during a minute at `RECORDED_PER_S`.
"""

import multiprocessing
import select
import socket
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import can
import numpy as np
from rich.table import Table

from bench.benchmarks.figures import Figure, in_turns, ratio_figure, table_of, time_figure
from bench.bus.codec import Codec, load_codecs
from bench.bus.link.address import Address, settle
from bench.bus.link.base import Link
from bench.bus.link.opening import open_link
from bench.bus.link.udp import GROUP
from bench.bus.node import serve
from bench.bus.states import BenchCommand
from bench.bus.sync import BENCH_SYNC
from bench.bus.wire.timing import BusTimeline
from bench.cycle import CYCLE_MS, CYCLE_S, time_of
from bench.ecu.base import Health, Outgoing, Signals, Topic
from bench.ecu.runtime import EcuNode
from bench.errors import BadInput
from bench.record.reader import Run
from bench.record.writer import RunWriter

CODED = 2_000
"""Messages coded per measurement."""

TRIPS, ROUNDS = 300, 31
"""Round trips per measurement, and number of measurements."""

RECORDED_PER_S, RECORDED_S = 10_000, 60
VEHICLES = 3
SETTLE_S = 0.0005
"""Pause between two round trips (s), so that both ECUs wait in the kernel when the next frame arrives."""

MOTION = Topic("veh1", "VehicleMotion")


class EmptyEcu:
    """Answers its single input with one command, without any computation."""

    name = "veh1.tracker"
    inputs: tuple[Topic, ...] = (MOTION,)

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:  # noqa: ARG002 - the ECU interface
        """Send the steering command, straight ahead."""
        return [Outgoing("veh1", "SteeringCommand", {"SteeringAngle": 0.0, "CommandState": 1})]


def tables() -> Iterator[Table | str]:
    """Yield each table as soon as it is measured."""
    yield table_of("coding a message, mean over both DBC files", coding())
    for can_name in ("udp", "vcan"):
        try:
            yield table_of(f"{can_name}: plant -> ECU -> plant, one frame each way", round_trips(can_name))
        except BadInput as error:
            yield f"{can_name}: not measured, {str(error).partition(chr(10))[0]}"
    yield recording()


def coding(rounds: int = ROUNDS) -> list[Figure]:
    """Return the times of our codec and cantools' per message, over all messages of a vehicle's bus and v2v."""
    codecs = load_codecs(VEHICLES)
    messages = [
        (codec, name, codec.start_values(name)) for codec in (codecs["v2v"], codecs["veh1"]) for name in codec.names
    ]
    frames = [(codec, *codec.encode(name, values)) for codec, name, values in messages]
    whole = [(codec.message(name), {**values, "CRC": 0, "AliveCounter": 0}) for codec, name, values in messages]

    def encode() -> int:
        for codec, name, values in messages:
            codec.encode(name, values, 7)
        return len(messages)

    def decode() -> int:
        for codec, can_id, data in frames:
            codec.decode(can_id, data)
        return len(frames)

    def encode_by_cantools() -> int:
        for message, values in whole:
            message.encode(values, strict=False)
        return len(whole)

    def decode_by_cantools() -> int:
        for (message, _), (_, _, data) in zip(whole, frames, strict=True):
            message.decode(data, decode_choices=False)
        return len(whole)

    ways = {"encode": encode, "decode": decode, "by cantools": encode_by_cantools, "by cantools ": decode_by_cantools}
    samples = in_turns({name: partial(_each, way, CODED // len(messages)) for name, way in ways.items()}, rounds)
    return [
        time_figure("encode, with E2E", "5 µs", samples["encode"]),
        time_figure("  cantools, without E2E", "", samples["by cantools"]),
        time_figure("decode", "5 µs", samples["decode"]),
        time_figure("  cantools", "", samples["by cantools "]),
    ]


def _each(once: Callable[[], int], times: int) -> float:
    """Return the seconds per unit of work of `once`, which returns the number of units."""
    started = time.perf_counter()
    count = sum(once() for _ in range(times))
    return (time.perf_counter() - started) / count


def round_trips(can_name: str, trips: int = TRIPS, rounds: int = ROUNDS) -> list[Figure]:
    """Return the round-trip times of python-can and of the bench, and their ratio.

    Raises:
        BadInput: this machine does not support this bus.
    """
    codec = load_codecs(VEHICLES)["veh1"]
    with ExitStack() as stack:
        address = stack.enter_context(settle(Address.parse(can_name), VEHICLES))
        bare = stack.enter_context(_echo(address))
        ours = stack.enter_context(_through_an_ecu(address, codec))
        measures = {"bare": lambda: _mean(bare, trips), "ours": lambda: _mean(ours, trips)}
        samples = in_turns(measures, rounds)
    return [
        time_figure("python-can on both sides, echo", "", samples["bare"]),
        time_figure("the bench, an empty ECU", "", samples["ours"]),
        ratio_figure("  ratio", "1.2", samples["ours"], samples["bare"]),
    ]


Trip = Callable[[], float]
"""Makes one round trip; returns its duration in seconds."""


def _mean(trip: Trip, trips: int) -> float:
    return float(np.median([trip() for _ in range(trips)]))


def _bare_bus(address: Address) -> can.BusABC:
    """Open python-can's own bus on the v2v channel, which the bench's node does not use."""
    place = address.place_of("v2v")
    if place.interface == "socketcan":
        return can.Bus(interface="socketcan", channel=place.channel)
    return can.Bus(interface="udp_multicast", channel=GROUP, port=place.port, hop_limit=0, fd=False)


@contextmanager
def _echo(address: Address) -> Iterator[Trip]:
    """Yield the round trip through python-can's `recv` and `send` in two processes."""
    with _process(_serve_echo, address), _bare_bus(address) as bus:
        there = can.Message(arbitration_id=0x102, data=bytes(8), is_extended_id=False)

        def trip() -> float:
            time.sleep(SETTLE_S)
            started = time.perf_counter()
            bus.send(there)
            while True:
                back = bus.recv(timeout=10.0)
                if back is None:
                    raise TimeoutError("no echo from python-can within 10 s")
                if back.arbitration_id == 0x300:
                    return time.perf_counter() - started

        yield trip


def _serve_echo(address: Address, ready: socket.socket) -> None:
    with _bare_bus(address) as bus:
        back = can.Message(arbitration_id=0x300, data=bytes(8), is_extended_id=False)
        ready.send(b"r")
        while True:
            message = bus.recv(timeout=60.0)
            if message is not None and message.arbitration_id == 0x102:
                bus.send(back)


@contextmanager
def _through_an_ecu(address: Address, codec: Codec) -> Iterator[Trip]:
    """Yield the round trip of a sensor frame to an ECU's node and of its command, decoded as in the plant."""
    with open_link("veh1", address) as link, _process(_serve_ecu, address):
        poll = select.poll()
        poll.register(link.fileno(), select.POLLIN)
        command, cycle = codec.can_id("SteeringCommand"), 0

        def trip() -> float:
            nonlocal cycle
            sync = {"Command": BenchCommand.RUN, "Cycle": cycle, "Time": time_of(cycle)}
            link.send(*codec.encode(BENCH_SYNC, sync, cycle))
            time.sleep(SETTLE_S)
            link.receive()
            started = time.perf_counter()
            link.send(*codec.encode("VehicleMotion", {"VelocityX": 20.0, "VelocityY": 0.0, "YawRate": 0.0}, cycle))
            while True:
                if not poll.poll(10_000):
                    raise TimeoutError("no answer from the ECU within 10 s")
                for can_id, data in link.receive():
                    if can_id == command:
                        codec.decode(can_id, data)
                        cycle += 1
                        return time.perf_counter() - started

        yield trip
        link.send(
            *codec.encode(BENCH_SYNC, {"Command": BenchCommand.STOP, "Cycle": cycle, "Time": time_of(cycle)}, cycle)
        )


def _serve_ecu(address: Address, ready: socket.socket) -> None:
    with open_link("veh1", address) as link:
        node = EcuNode("veh1.tracker", EmptyEcu(), {"veh1": link}, load_codecs(VEHICLES))
        ready.send(b"r")
        serve([node])


@contextmanager
def _process(target: Callable[[Address, socket.socket], None], address: Address) -> Iterator[None]:
    """Run `target` in a separate process, from when it reports ready until the context ends."""
    near, far = socket.socketpair()
    process = multiprocessing.get_context("fork").Process(target=target, args=(address, far), daemon=True)
    process.start()
    try:
        near.settimeout(60.0)
        near.recv(1)
        yield
    finally:
        process.join(0.5)
        process.kill()
        process.join()
        near.close()
        far.close()


def recording(seconds: int = RECORDED_S, per_s: int = RECORDED_PER_S) -> Table:
    """Record frames that another process sends over udp; return their losses as a table."""
    codecs = load_codecs(VEHICLES)
    with ExitStack() as stack:
        address = stack.enter_context(settle(Address.parse("udp"), VEHICLES))
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="platoon-bench-"))
        links = {bus: stack.enter_context(open_link(bus, address)) for bus in codecs}
        sender = multiprocessing.get_context("fork").Process(target=_send, args=(address, seconds, per_s), daemon=True)
        used = time.process_time()
        log = Path(folder) / "log.mcap"
        sender.start()
        received = _record(log, links, codecs, seconds * per_s)
        used = time.process_time() - used
        sender.join()
        lost = sum(link.frames_lost() for link in links.values())
        logged = sum(len(Run(log).frame_table(bus)) for bus in codecs)
    table = Table(title=f"recording {per_s} frames/s for {seconds} s over udp", title_justify="left")
    for heading in ("sent", "received", "in the log", "lost by the kernel", "recorder's share of a core"):
        table.add_column(heading, justify="right")
    sent = seconds * per_s
    table.add_row(str(sent), str(received), str(logged), str(lost), f"{100 * used / seconds:.1f} %")
    return table


def _record(log: Path, links: Mapping[str, Link], codecs: Mapping[str, Codec], count: int) -> int:
    """Record until `count` frames have arrived, or none for 5 s; return the number of frames received."""
    poll = select.poll()
    for link in links.values():
        poll.register(link.fileno(), select.POLLIN)
    by_file = {link.fileno(): (bus, link) for bus, link in links.items()}
    received = 0
    timeline = BusTimeline(codecs, {}, realtime=True)
    with RunWriter(
        log, codecs=codecs, truth_names=(), vehicles=VEHICLES, metadata={}, attachments={}, timeline=timeline
    ) as writer:
        while received < count and (ready := poll.poll(5_000)):
            now = time.time_ns()
            cycle_ns = now - now % (CYCLE_MS * 1_000_000)
            for descriptor, _ in ready:
                bus, link = by_file[descriptor]
                for can_id, data in link.receive():
                    writer.frame(bus, cycle_ns, can_id, data, now)
                    received += 1
    return received


def _send(address: Address, seconds: int, per_s: int) -> None:
    """Send valid frames of all buses in bursts every 10 ms, at absolute times."""
    codecs = load_codecs(VEHICLES)
    with ExitStack() as stack:
        links = {bus: stack.enter_context(open_link(bus, address)) for bus in codecs}
        frames = [
            (links[bus], *codec.encode(name, codec.start_values(name)))
            for bus, codec in codecs.items()
            for name in codec.names
        ]
        per_cycle = per_s * CYCLE_MS // 1000
        started = time.monotonic()
        for cycle in range(seconds * 1000 // CYCLE_MS):
            for number in range(per_cycle):
                link, can_id, data = frames[(cycle * per_cycle + number) % len(frames)]
                link.send(can_id, data)
            time.sleep(max(0.0, started + (cycle + 1) * CYCLE_S - time.monotonic()))
