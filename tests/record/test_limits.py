"""Too much of everything in a log: one message with the limit, and work that grows in proportion up to it."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.writer import Writer

from bench.bus.codec import Codec
from bench.bus.dbc import MOST_DBC_BYTES
from bench.errors import BadInput
from bench.mcap import limits
from bench.record import can_frame, event, reader
from bench.record.can_frame import MOST_BUSES, Frame
from bench.record.exchange.importing import import_logs
from bench.record.foxglove_layout import layout
from bench.record.overview import overview
from bench.record.reader import Run
from tests.reference.raw_log import _payload

PAYLOAD = _payload(Frame(0, "veh1", 0x123, bytes(8), 0, 0, 0))


def log(path: Path, fill: Callable[[Writer], None], vehicles: str = "1") -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("platoon", "platoon")
        writer.add_metadata("run", {"vehicles": vehicles})
        fill(writer)
        writer.finish()
    return path


def channels(pattern: str, count: int) -> Callable[[Writer], None]:
    def fill(writer: Writer) -> None:
        schema = writer.register_schema(can_frame.NAME, "protobuf", can_frame.SCHEMA)
        for number in range(count):
            writer.add_message(writer.register_channel(pattern.format(number), "protobuf", schema), 0, PAYLOAD, 0)

    return fill


def schemas(count: int) -> Callable[[Writer], None]:
    def fill(writer: Writer) -> None:
        for number in range(count):
            schema = writer.register_schema(f"S{number}", "protobuf", b"")
            writer.add_message(writer.register_channel("/one", "protobuf", schema), 0, b"", 0)

    return fill


def attachments(count: int, size: int = 1) -> Callable[[Writer], None]:
    def fill(writer: Writer) -> None:
        for number in range(count):
            writer.add_attachment(0, 0, f"a{number}", "text/plain", bytes(size))

    return fill


def metadata(values: dict[str, str]) -> Callable[[Writer], None]:
    return lambda writer: writer.add_metadata("more", values)


@pytest.mark.parametrize(
    ("fill", "message"),
    [
        (channels("/can/b{}", 60_000), "60000 channels; allowed: at most 10000"),
        (schemas(10_001), "10001 channels|10001 schemas; allowed: at most 10000"),
        (attachments(1_001), "1001 attachments; allowed: at most 1000"),
        (attachments(2, 33 << 20), "69206016 bytes of attachments; allowed: at most 67108864"),
        (metadata({str(number): "" for number in range(10_000)}), "10001 pairs of metadata; allowed: at most 10000"),
        (metadata({"a": "x" * (5 << 20)}), "characters of metadata; allowed: at most 4194304"),
        (metadata({"x" * 1_001: ""}), "1001 characters in a name; allowed: at most 1000"),
        (channels("/" + "x" * 2_000_000 + "{}", 1), "2000002 characters in a name; allowed: at most 1000"),
    ],
)
def test_a_log_with_too_much_is_refused(tmp_path, fill, message):
    path = log(tmp_path / "much.mcap", fill)
    with pytest.raises(BadInput, match=f"much.mcap cannot be read: it has .*({message})"):
        Run(path)


def test_buses_are_limited(tmp_path):
    path = log(tmp_path / "buses.mcap", channels("/can/b{}", MOST_BUSES + 1))
    with pytest.raises(BadInput, match="has 101 CAN buses; allowed: at most 100"):
        overview(Run(path))
    (tmp_path / "a.log").write_text("".join(f"({n}.0) b{n} 123#00\n" for n in range(MOST_BUSES + 1)))
    with pytest.raises(BadInput, match="have 101 channels; a log may have at most 100 CAN buses"):
        import_logs([tmp_path / "a.log"], tmp_path / "a.mcap")
    assert not (tmp_path / "a.mcap").exists()


def test_events_are_limited(tmp_path, monkeypatch):
    monkeypatch.setattr(reader, "MOST_EVENTS", 10)

    def fill(writer: Writer) -> None:
        schema = writer.register_schema(event.NAME, "protobuf", event.SCHEMA)
        channel = writer.register_channel(event.TOPIC, "protobuf", schema)
        for number in range(11):
            writer.add_message(channel, number * 1_000_000_000, b"", 0)

    with pytest.raises(BadInput, match="has more than 10 events in this time"):
        _ = Run(log(tmp_path / "events.mcap", fill)).events


@pytest.mark.parametrize("vehicles", ["1001", "-1", "1" + "0" * 1000])
def test_the_number_of_vehicles_is_limited(tmp_path, vehicles):
    path = log(tmp_path / "vehicles.mcap", lambda _: None, vehicles)
    with pytest.raises(BadInput, match="vehicles in its metadata; allowed: 0 to 1000"):
        layout(Run(path).vehicles)


def test_an_overview_of_twice_as_many_topics_takes_twice_the_work(tmp_path):
    """Lines of Python executed, which no other process on the machine affects."""

    def work(count: int) -> int:
        run, lines = Run(log(tmp_path / f"{count}.mcap", channels("/signals/veh1/M{}", count))), 0

        def trace(_frame, what, _argument):
            nonlocal lines
            lines += what == "line"
            return trace

        before = sys.gettrace()
        sys.settrace(trace)
        try:
            overview(run)
        finally:
            sys.settrace(before)
        return lines

    work(10)
    few, many = work(500), work(2_000)
    assert many < 6 * few


def test_a_log_at_its_limits_is_read(tmp_path):
    found = overview(Run(log(tmp_path / "most.mcap", channels("/signals/veh1/M{}", limits.MOST_CHANNELS))))
    assert len(found.topics) == limits.MOST_CHANNELS


@pytest.mark.parametrize("name", ["a.log", "a.asc"])
def test_a_line_of_another_tools_log_is_limited(tmp_path, name):
    line = "(0.0) can0 123#" if name == "a.log" else "0.0 1 123 Rx d 8 "
    (tmp_path / name).write_text(line + "00" * 5_000_000 + "\n")
    with pytest.raises(BadInput, match="line 1: it has more than 10000 characters") as refused:
        import_logs([tmp_path / name], tmp_path / "a.mcap")
    assert len(str(refused.value)) < 1_000


def test_a_dbc_file_is_limited(tmp_path):
    (tmp_path / "a.dbc").write_bytes(b'VERSION ""\nCM_ "' + b"c" * MOST_DBC_BYTES + b'";\n')
    with pytest.raises(BadInput, match=r"a.dbc: the DBC file has .* bytes; allowed: at most 2097152"):
        Codec(tmp_path / "a.dbc")
